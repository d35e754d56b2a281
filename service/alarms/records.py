"""The record of one alarm: how it begins and changes, where an event leads, its journal lines."""

import math
from collections.abc import Sequence
from dataclasses import replace
from uuid import uuid4

from service.alarms.states import AlarmEvent, AlarmState, next_state
from service.domain.alarm_condition import AlarmCondition, EventKind
from service.domain.alarm_kind import CLOCK_AHEAD, SENSOR_FAULT
from service.domain.causes import STALE_DATA, is_shared
from service.store import Alarm, AlarmTransition

AlarmKey = tuple[str, str, str, str]
"""Asset (empty where it is one for many), kind, channel and level: which alarm it is."""

#: States in the order of the list.
_LISTED = ("UNACK", "ACKED", "RTNUN", "LATCH", "SHLVD", "DSUPR", "OOSRV", "NORM")

_ACTIONS = {
    AlarmEvent.ACKNOWLEDGE: "acknowledge it",
    AlarmEvent.RESET: "reset it",
    AlarmEvent.SHELVE: "shelve it",
    AlarmEvent.UNSHELVE: "unshelve it",
    AlarmEvent.TAKE_OUT: "take it out of service",
    AlarmEvent.PUT_BACK: "return it to service",
}


def following(alarm: Alarm, event: AlarmEvent) -> AlarmState | None:
    """Where an event would lead an alarm; None where it means nothing."""
    latched = alarm.latched and alarm.raised_at_us > 0
    return next_state(AlarmState(alarm.state), event, present=alarm.present, latched=latched)


def news_of(alarm: Alarm) -> tuple[object, ...]:
    """What of an alarm that stays in its state is worth a message."""
    return alarm.message, alarm.priority, alarm.assets, alarm.asset


def shortened(names: Sequence[str], most: int = 5) -> str:
    """List some names, and say how many there are besides."""
    others = len(names) - most
    return ", ".join(names[:most]) + (f" and {others} more" if others > 0 else "")


def as_it_is(alarm: Alarm, condition: AlarmCondition | None, now_us: int) -> Alarm:
    """Give an alarm that was set aside as its condition is now: no off-delay keeps it there."""
    if alarm.present and condition is not None and condition.holds is False:
        return replace(alarm, present=False, returned_at_us=now_us)
    return alarm


def refusal(alarm: Alarm, event: AlarmEvent) -> str:
    """Say why an alarm's state does not allow an event."""
    by = f" (acknowledged by {alarm.acknowledged_by})" if alarm.acknowledged_by else ""
    return f"alarm {alarm.id} is {alarm.state}{by}: cannot {_ACTIONS[event]}"


def key_of(alarm: Alarm) -> AlarmKey:
    """Which condition an alarm belongs to."""
    asset = "" if is_shared(alarm.kind, alarm.channel) else alarm.asset
    return asset, alarm.kind, alarm.channel, alarm.level


def assets_of(alarm: Alarm) -> tuple[str, ...]:
    """Give the assets that an alarm is about."""
    return alarm.assets or (alarm.asset,)


def urgency(alarm: Alarm) -> tuple[int, int, int, int, int, str]:
    """Sort key of alarms, the most urgent first: the order in which the page shows them.

    What has to be answered comes first, then what is acknowledged, then what has returned; what is
    shelved, suppressed or out of service comes last. Each goes by priority, whatever the kind; of
    one priority, what is measured over a limit comes before what has no data, and both before what
    is only predicted; then what is over its limit by most whole units, then the newest.
    """
    certainty = (
        2 if alarm.predicted else 1 if alarm.kind in (STALE_DATA, SENSOR_FAULT, CLOCK_AHEAD) else 0
    )
    return (
        _LISTED.index(alarm.state),
        alarm.priority,
        certainty,
        -_excess(alarm),
        -(alarm.raised_at_us or alarm.since_us),
        alarm.id,
    )


def _excess(alarm: Alarm) -> int:
    """By how many whole units the value is over the limit; of no value 0."""
    if alarm.value is None or alarm.limit_value is None:
        return 0
    return math.floor(max(alarm.value - alarm.limit_value, 0.0))


def journal_line(
    alarm: Alarm, before: str, event: str, now_us: int, who: str, comment: str
) -> AlarmTransition:
    """Make the line of the journal for the way of an alarm into its present state."""
    return AlarmTransition(
        alarm_id=alarm.id,
        asset=alarm.asset,
        kind=alarm.kind,
        channel=alarm.channel,
        level=alarm.level,
        time_us=now_us,
        from_state=before,
        to_state=alarm.state,
        who=who,
        comment=comment or alarm.suppressed_reason or "",
        value=alarm.value,
        message=alarm.message,
        event=event,
        priority=alarm.priority,
        until_us=alarm.shelved_until_us,
        peak_value=alarm.peak_value,
        peak_at_us=alarm.peak_at_us,
        duration_s=duration_s(alarm),
        assets=alarm.assets,
    )


def event_line(
    asset: str, kind: EventKind, message: str, now_us: int, who: str, comment: str = ""
) -> AlarmTransition:
    """Make the line of the journal for an event: worth knowing, but no alarm."""
    return AlarmTransition(
        alarm_id=None,
        asset=asset,
        kind=kind,
        channel="",
        level="",
        time_us=now_us,
        from_state="",
        to_state="",
        who=who,
        comment=comment,
        value=None,
        message=message,
    )


def duration_s(alarm: Alarm) -> float | None:
    """Process seconds from the raise to the return; None before it has returned.

    None as well where the clock was set back in between.
    """
    if not alarm.raised_at_us or alarm.returned_at_us is None:
        return None
    seconds = (alarm.returned_at_us - alarm.raised_at_us) / 1e6
    return seconds if seconds >= 0 else None


def with_peak(alarm: Alarm, value: float | None, at_us: int) -> Alarm:
    """Note a value of an alarm whose condition is there, if it is its highest so far."""
    peak = alarm.peak_value
    if not alarm.present or value is None or (peak is not None and value <= peak):
        return alarm
    return replace(alarm, peak_value=value, peak_at_us=at_us)


def moved(alarm: Alarm, by_us: int) -> Alarm:
    """Give an alarm that is not over its times by a clock that was set by so much.

    What the journal says of it stays as it was written.
    """

    def later(time_us: int | None) -> int | None:
        return time_us and time_us + by_us

    return replace(
        alarm,
        since_us=alarm.since_us + by_us,
        raised_at_us=later(alarm.raised_at_us) or 0,
        returned_at_us=later(alarm.returned_at_us),
        acknowledged_at_us=later(alarm.acknowledged_at_us),
        shelved_until_us=later(alarm.shelved_until_us),
        peak_at_us=later(alarm.peak_at_us),
    )


def normal_alarm(condition: AlarmCondition, now_us: int) -> Alarm:
    """Begin a record: a condition that is watched and not there."""
    alarm = Alarm(
        id=uuid4().hex,
        asset=condition.asset,
        kind=condition.kind,
        channel=condition.channel,
        level=condition.level,
        state=AlarmState.NORM.value,
        priority=condition.priority,
        message=condition.message,
        predicted=condition.predicted,
        raised_at_us=0,
        since_us=now_us,
        returned_at_us=None,
        acknowledged_at_us=None,
        acknowledged_by=None,
        value=None,
        limit_value=None,
        unit=None,
        lead_time_s=None,
        probability=None,
        present=False,
        latched=condition.latched,
        shelved_until_us=None,
        shelved_by=None,
        suppressed_reason=None,
        comment=None,
    )
    return updated(alarm, condition)


def updated(alarm: Alarm, condition: AlarmCondition) -> Alarm:
    """Give an alarm the present figures and words of its condition."""
    return replace(
        alarm,
        asset=condition.asset,
        assets=condition.assets,
        priority=condition.priority,
        message=condition.message,
        predicted=condition.predicted,
        value=condition.value,
        limit_value=condition.limit_value,
        unit=condition.unit,
        lead_time_s=condition.lead_time_s,
        probability=condition.probability,
        latched=condition.latched,
    )
