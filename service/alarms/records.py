"""The record of one alarm: how it begins and changes, where an event leads, its journal lines."""

from dataclasses import replace
from uuid import uuid4

from service.alarms.states import AlarmEvent, AlarmState, next_state
from service.domain.alarm_condition import AlarmCondition, EventKind
from service.domain.alarm_kind import SENSOR_FAULT, STALE_DATA
from service.store import Alarm, AlarmTransition

AlarmKey = tuple[str, str, str, str]
"""Asset, kind, channel and level: what tells one alarm from another."""

#: States in the order of the list.
_LISTED = ("UNACK", "ACKED", "RTNUN", "LATCH", "SHLVD", "DSUPR", "OOSRV", "NORM")


def following(alarm: Alarm, event: AlarmEvent) -> AlarmState | None:
    """Where an event would lead an alarm; None where it means nothing."""
    latched = alarm.latched and alarm.raised_at_us > 0
    return next_state(AlarmState(alarm.state), event, present=alarm.present, latched=latched)


def key_of(alarm: Alarm) -> AlarmKey:
    """Which condition an alarm belongs to."""
    return alarm.asset, alarm.kind, alarm.channel, alarm.level


def urgency(alarm: Alarm) -> tuple[int, int, int, int, str]:
    """Sort key of alarms, the most urgent first: the order in which the page shows them.

    What has to be answered comes first, then what is acknowledged, then what has returned; what is
    shelved, suppressed or out of service comes last. Each goes by priority, whatever the kind; of
    one priority, what is measured over a limit comes before what has no data, and both before what
    is only predicted; the newest first.
    """
    certainty = 2 if alarm.predicted else 1 if alarm.kind in (STALE_DATA, SENSOR_FAULT) else 0
    return (
        _LISTED.index(alarm.state),
        alarm.priority,
        certainty,
        -(alarm.raised_at_us or alarm.since_us),
        alarm.id,
    )


def journal_line(
    alarm: Alarm, before: str, event: str, now_us: int, who: str, comment: str
) -> AlarmTransition:
    """Tell the journal how an alarm came from a state into its present one."""
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
    )


def event_line(
    asset: str, kind: EventKind, message: str, now_us: int, who: str, comment: str = ""
) -> AlarmTransition:
    """Tell the journal of an event: worth knowing, but no alarm."""
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


def with_peak(alarm: Alarm, now_us: int) -> Alarm:
    """Note the value of an alarm whose condition is there, if it is its highest so far."""
    value, peak = alarm.value, alarm.peak_value
    if not alarm.present or value is None or (peak is not None and value <= peak):
        return alarm
    return replace(alarm, peak_value=value, peak_at_us=now_us)


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
