"""What becomes of a telling: rules without any clock, socket or store of their own.

An event that has to be told is called ``KIND:NUMBER``: ``raised:2`` is the second time that an
alarm called for an operator in its life. The number makes the id of the event, by which a receiver
knows one that comes again.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Final
from zoneinfo import ZoneInfo

from service.alarms.states import ACTIVE_STATES, SET_ASIDE_STATES, AlarmState
from service.clock import MICROSECONDS
from service.site.notification_section import DailyHours, NotificationSection, QuietHours
from service.store import Alarm, Silence, Telling

RAISED: Final = "raised"
RETURNED: Final = "returned"
ACKNOWLEDGED: Final = "acknowledged"
ESCALATED: Final = "escalated"
#: Process seconds after which an alarm that is over is not told any more.
GIVE_UP_S: Final = 86_400.0


def kind_of(event: str) -> str:
    """What kind of event an owed one is."""
    return event.partition(":")[0]


def is_wanted(section: NotificationSection, alarm: Alarm, family: str) -> bool:
    """Whether a notification tells of such an alarm by itself."""
    return (
        not section.only_escalations
        and alarm.priority in section.priorities
        and (not section.assets or alarm.asset in section.assets)
        and (not section.families or family in section.families)
    )


def noted(
    telling: Telling | None, alarm: Alarm, section: NotificationSection, wanted: bool
) -> Telling | None:
    """Take in an alarm as it is now; None where the notification has nothing to do with it.

    Parameters
    ----------
    telling
        What was told of it before, if anything.
    alarm
        As it is now.
    section
        The notification.
    wanted
        Whether the notification tells of such an alarm by itself; see `is_wanted`.
    """
    if telling is None:
        if alarm.state != AlarmState.UNACK or not wanted:
            return None
        owed = (f"{RAISED}:1",)
        return Telling(section.id, alarm, 1, alarm.since_us, owed)
    before, telling = telling.alarm, replace(telling, alarm=alarm)
    if alarm.state == AlarmState.UNACK:
        if alarm.since_us != telling.since_us:
            telling = _raised_again(telling, before, wanted)
    elif alarm.state == AlarmState.ACKED:
        telling = _acknowledged(telling, before, section)
    else:
        telling = _gone(telling)
    return closed(telling)


def closed(telling: Telling) -> Telling:
    """Note that a telling is over when its alarm is, and nothing is owed."""
    over = telling.alarm.state == AlarmState.NORM and not telling.owed
    return replace(telling, over=True) if over else telling


def _raised_again(telling: Telling, before: Alarm, wanted: bool) -> Telling:
    over = (RETURNED, ACKNOWLEDGED)
    untold = [event for event in telling.owed if kind_of(event) not in over]
    # Whoever has not heard that it was gone need not hear that it is there again.
    believed = any(kind_of(event) == RETURNED for event in telling.owed) or (
        telling.told and before.state != AlarmState.ACKED
    )
    number = telling.raise_number + 1
    if wanted and not believed and not any(kind_of(event) == RAISED for event in untold):
        untold.append(f"{RAISED}:{number}")
    return replace(
        telling,
        raise_number=number,
        since_us=telling.alarm.since_us,
        owed=tuple(untold),
        released_us=telling.released_us if believed else None,
        steps=telling.steps if believed else 0,
    )


def _acknowledged(telling: Telling, before: Alarm, section: NotificationSection) -> Telling:
    owed = telling.owed
    if telling.released_us is None and not telling.called:
        # Held back, and somebody has taken it meanwhile.
        return replace(telling, owed=tuple(one for one in owed if kind_of(one) != RAISED))
    # Programs keep a state of their own, and who was called in waits for somebody to take over.
    event = f"{ACKNOWLEDGED}:{telling.raise_number}"
    tells = section.kind == "webhook" or telling.called
    knows = telling.told or any(kind_of(one) in (RAISED, ESCALATED) for one in owed)
    if tells and knows and before.state != AlarmState.ACKED and event not in owed:
        owed += (event,)
    return replace(telling, owed=owed)


def _gone(telling: Telling) -> Telling:
    """Take in that an alarm has returned, is over, or was set aside."""
    told_later = [event for event in telling.owed if kind_of(event) in (RAISED, ESCALATED)]
    if telling.alarm.state in SET_ASIDE_STATES or (telling.released_us is None and told_later):
        # Nobody is told of it: it was held back until now, or is not to be heard of.
        left = telling.owed if telling.told else ()  # without its raise a return means nothing
        kept = tuple(event for event in left if event not in told_later)
        telling = replace(telling, owed=kept)
        told_later = []
    event = f"{RETURNED}:{telling.raise_number}"
    if (telling.told or told_later) and event not in telling.owed:
        telling = replace(telling, owed=(*telling.owed, event))
    return telling


def sent(telling: Telling, events: Sequence[str]) -> Telling:
    """Take in that events were told; the alarm may have changed while they were under way."""
    told = telling.told
    for event in events:
        told = kind_of(event) != RETURNED
    owed = tuple(event for event in telling.owed if event not in events)
    kinds = {kind_of(event) for event in owed}
    if told and telling.alarm.state not in ACTIVE_STATES and RETURNED not in kinds:
        owed = (*owed, f"{RETURNED}:{telling.raise_number}")
    if not told and telling.alarm.state == AlarmState.UNACK and RAISED not in kinds:
        owed = (*owed, f"{RAISED}:{telling.raise_number}")
    return closed(replace(telling, owed=owed, told=told, over=False))


def given_up(telling: Telling, now_us: int) -> Telling:
    """Leave what could not be told of an alarm that has been over for a day."""
    gone_us = telling.alarm.returned_at_us
    waits = telling.owed and telling.alarm.state not in ACTIVE_STATES and gone_us is not None
    if waits and gone_us is not None and now_us - gone_us > GIVE_UP_S * MICROSECONDS:
        return closed(replace(telling, owed=()))
    return telling


def escalated(source: Telling, target: Telling | None, to: str, now_us: int) -> Telling:
    """Call another notification in, because nobody has acknowledged an alarm.

    Parameters
    ----------
    source
        Of the notification that was told first.
    target
        What the other one was told, if anything.
    to
        The other one's id.
    now_us
        Process time.
    """
    event = f"{ESCALATED}:{source.notification}.{source.raise_number}.{source.steps + 1}"
    if target is None:
        target = Telling(to, source.alarm, source.raise_number, source.since_us)
    released_us = now_us if target.released_us is None else target.released_us
    return replace(target, owed=(*target.owed, event), called=True, released_us=released_us)


def due(telling: Telling, silences: Iterable[Silence], now_us: int) -> tuple[str, ...]:
    """Events that may be told at a process time."""
    if not telling.owed or is_silent(telling.alarm.asset, silences, now_us):
        return ()
    if telling.released_us is None:
        return tuple(event for event in telling.owed if kind_of(event) != RAISED)
    return telling.owed


def is_held(
    section: NotificationSection, alarm: Alarm, silences: Iterable[Silence], now_us: int
) -> bool:
    """Whether an alarm is not to be told at the moment: quiet hours, or a silence."""
    return is_quiet(section.quiet_hours, alarm.priority, now_us) or is_silent(
        alarm.asset, silences, now_us
    )


def is_quiet(quiet: QuietHours | None, priority: int, now_us: int) -> bool:
    """Whether quiet hours hold a priority back at a process time."""
    return quiet is not None and priority in quiet.priorities and is_within(quiet, (), now_us)


def is_silent(asset: str, silences: Iterable[Silence], now_us: int) -> bool:
    """Whether a silence is about an asset at a process time."""
    return any(one.covers(asset) and is_in_force(one, now_us) for one in silences)


def is_in_force(silence: Silence, now_us: int) -> bool:
    """Whether nobody is told because of a silence at a process time."""
    if not silence.begins_us <= now_us < silence.ends_us:
        return False
    if not silence.begins and not silence.days:
        return True
    hours = DailyHours.model_validate(
        {
            "begins": silence.begins or "00:00",
            "ends": silence.ends or "23:59:59.999999",
            "time_zone": silence.time_zone,
        }
    )
    return is_within(hours, silence.days, now_us)


def is_within(hours: DailyHours, days: Sequence[int], now_us: int) -> bool:
    """Whether a process time lies in a span of the day.

    Parameters
    ----------
    hours
        The span, in its time zone.
    days
        Days of the week on which it begins, 0 for Monday; none for all.
    now_us
        Process time, UTC microseconds.
    """
    moment = datetime.fromtimestamp(now_us / MICROSECONDS, UTC)
    local = moment.astimezone(ZoneInfo(hours.time_zone))
    now, begins, ends = local.time(), hours.begins, hours.ends
    if begins < ends:
        begun = begins <= now < ends
        first = local
    else:  # over midnight: what is left of it belongs to the day before
        begun = now >= begins or now < ends
        first = local if now >= begins else local - timedelta(days=1)
    return begun and (not days or first.weekday() in days)
