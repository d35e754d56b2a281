"""What becomes of a notification: rules without any clock, socket or store of their own.

An event that is pending is called ``KIND:NUMBER``: ``raised:2`` is the second time that an alarm
called for an operator in its life. The number makes the id of the event, by which a recipient
drops one that comes again.
"""

from collections.abc import Callable, Sequence
from typing import Final

from msgspec.structs import replace

from service.alarms import records
from service.alarms.silencing import Silencing
from service.alarms.states import ACTIVE_STATES, SET_ASIDE_STATES, AlarmState
from service.clock import MICROSECONDS
from service.domain.daily_hours import is_within
from service.features.notifications.sections import NotificationSection, QuietHours
from service.features.notifications.tables import Notification
from service.store import Alarm

RAISED: Final = "raised"
RETURNED: Final = "returned"
ACKNOWLEDGED: Final = "acknowledged"
ESCALATED: Final = "escalated"
#: Process seconds after which an alarm that is over is not sent any more.
GIVE_UP_S: Final = 86_400.0


def kind_of(event: str) -> str:
    """What kind of event a pending one is."""
    return event.partition(":")[0]


def is_selected(
    section: NotificationSection, alarm: Alarm, family_of: Callable[[str], str]
) -> bool:
    """Whether a recipient gets such an alarm without escalation: of one of its assets at least."""
    return (
        not section.only_escalations
        and alarm.priority in section.priorities
        and any(
            (not section.assets or asset in section.assets)
            and (not section.families or family_of(asset) in section.families)
            for asset in records.assets_of(alarm)
        )
    )


def updated(
    notification: Notification | None, alarm: Alarm, section: NotificationSection, selected: bool
) -> Notification | None:
    """Make of a notification, if there was one, that of the alarm as it is now.

    None where the recipient has nothing to do with the alarm. ``selected``: see `is_selected`.
    """
    if notification is None:
        if alarm.state != AlarmState.UNACK or not selected:
            return None
        return Notification(section.id, alarm, 1, alarm.since_us, pending=(f"{RAISED}:1",))
    before, notification = notification.alarm, replace(notification, alarm=alarm)
    if alarm.state == AlarmState.UNACK:
        if alarm.since_us != notification.since_us:
            notification = _raised_again(notification, before, selected)
    elif alarm.state == AlarmState.ACKED:
        notification = _acknowledged(notification, before, section)
    else:
        notification = _gone(notification)
    return closed(notification)


def closed(notification: Notification) -> Notification:
    """Note that a notification is over when its alarm is, and nothing is pending."""
    over = notification.alarm.state == AlarmState.NORM and not notification.pending
    return replace(notification, over=True) if over else notification


def _raised_again(notification: Notification, before: Alarm, selected: bool) -> Notification:
    over, partly = (RETURNED, ACKNOWLEDGED), notification.partly
    pending = [one for one in notification.pending if kind_of(one) not in over or one in partly]
    unsent = {kind_of(event) for event in notification.pending if event not in partly}
    # A recipient that was not notified of the return needs no message of the next raise.
    believed = RETURNED in unsent or (_is_known(notification) and before.state != AlarmState.ACKED)
    number = notification.raise_number + 1
    if selected and not believed and RAISED not in unsent:
        pending.append(f"{RAISED}:{number}")
    return replace(
        notification,
        raise_number=number,
        since_us=notification.alarm.since_us,
        pending=tuple(pending),
        released_us=notification.released_us if believed else None,
        steps=notification.steps if believed else 0,
    )


def _is_known(notification: Notification) -> bool:
    """Whether some address of the recipient knows of the alarm."""
    last = [event for event in notification.pending if event in notification.partly][-1:]
    return kind_of(last[0]) != RETURNED if last else notification.is_notified


def _without_unsent_raise(notification: Notification) -> tuple[str, ...]:
    """What is pending, without a raise that no address has."""
    pending, partly = notification.pending, notification.partly
    return tuple(event for event in pending if kind_of(event) != RAISED or event in partly)


def _acknowledged(
    notification: Notification, before: Alarm, section: NotificationSection
) -> Notification:
    pending = notification.pending
    if notification.released_us is None and not notification.called:
        # Held back, and somebody has acknowledged it meanwhile.
        return replace(notification, pending=_without_unsent_raise(notification))
    # Programs keep a state of their own, and after an escalation people wait for an answer.
    event = f"{ACKNOWLEDGED}:{notification.raise_number}"
    is_for = section.kind == "webhook" or notification.called
    knows = notification.is_notified or any(kind_of(one) in (RAISED, ESCALATED) for one in pending)
    if is_for and knows and before.state != AlarmState.ACKED and event not in pending:
        pending += (event,)
    return replace(notification, pending=pending)


def _gone(notification: Notification) -> Notification:
    """Note that an alarm has returned, is over, or was set aside."""
    is_known = _is_known(notification)
    unsent = [event for event in notification.pending if event not in notification.partly]
    raises = [event for event in unsent if kind_of(event) in (RAISED, ESCALATED)]
    if notification.alarm.state in SET_ASIDE_STATES or (
        notification.released_us is None and raises
    ):
        # Its raise is not sent: it was held back until now, or is set aside.
        gone = raises if is_known else unsent  # no return without raise
        kept = tuple(event for event in notification.pending if event not in gone)
        notification = replace(notification, pending=kept)
        raises = []
    event = f"{RETURNED}:{notification.raise_number}"
    if (is_known or raises) and event not in notification.pending:
        notification = replace(notification, pending=(*notification.pending, event))
    return notification


def sent(notification: Notification, events: Sequence[str]) -> Notification:
    """Note that events were sent; the alarm may have changed while they were under way."""
    is_notified = notification.is_notified
    for event in events:
        is_notified = kind_of(event) != RETURNED
    pending = tuple(event for event in notification.pending if event not in events)
    kinds = {kind_of(event) for event in pending}
    if not is_notified and not kinds & {RAISED, ESCALATED}:
        # It was raised and returned once more meanwhile: the recipient knows nothing of either.
        pending = tuple(event for event in pending if kind_of(event) != RETURNED)
    partly = tuple(event for event in notification.partly if event in pending)
    state = notification.alarm.state
    if is_notified and state not in ACTIVE_STATES and RETURNED not in kinds:
        pending = (*pending, f"{RETURNED}:{notification.raise_number}")
    if not is_notified and state == AlarmState.UNACK and RAISED not in kinds:
        pending = (*pending, f"{RAISED}:{notification.raise_number}")
    return closed(
        replace(notification, pending=pending, is_notified=is_notified, partly=partly, over=False)
    )


def partly_sent(notification: Notification, events: Sequence[str]) -> Notification:
    """Note that some addresses have events: for the others they stay pending, whatever comes.

    What was dropped while they were under way is pending again, before what came since.
    """
    partly = tuple(dict.fromkeys((*notification.partly, *events)))
    pending = (*partly, *(event for event in notification.pending if event not in partly))
    kept = replace(notification, pending=pending, partly=partly, over=False)
    if kept.alarm.state not in ACTIVE_STATES:
        return _gone(kept)
    unsent = {kind_of(event) for event in pending if event not in partly}
    if _is_known(kept) or RAISED in unsent or kept.alarm.state != AlarmState.UNACK:
        return kept
    return replace(kept, pending=(*pending, f"{RAISED}:{kept.raise_number}"))


def not_taken(notification: Notification, events: Sequence[str]) -> Notification:
    """Drop events that the recipient does not take, and what makes no sense without them."""
    is_notified = _is_known(notification) and RETURNED not in map(kind_of, events)
    pending = [event for event in notification.pending if event not in events]
    if not is_notified and not any(kind_of(event) in (RAISED, ESCALATED) for event in pending):
        pending = []
    partly = tuple(event for event in notification.partly if event in pending)
    return closed(
        replace(notification, pending=tuple(pending), is_notified=is_notified, partly=partly)
    )


def given_up(notification: Notification, now_us: int) -> Notification:
    """Drop what could not be sent of an alarm that has been over for a day."""
    alarm = notification.alarm
    gone_us = alarm.returned_at_us
    if not notification.pending or alarm.state in ACTIVE_STATES or gone_us is None:
        return notification
    if now_us - gone_us > GIVE_UP_S * MICROSECONDS:
        return closed(replace(notification, pending=(), partly=()))
    return notification


def moved(notification: Notification, by_us: int) -> Notification:
    """Give a notification its times by a clock that was set by so much."""
    released_us = notification.released_us
    return replace(
        notification,
        alarm=records.moved(notification.alarm, by_us),
        since_us=notification.since_us + by_us,
        released_us=None if released_us is None else released_us + by_us,
    )


def escalated(
    source: Notification, target: Notification | None, to: str, now_us: int
) -> Notification:
    """Notify another recipient too, because an alarm is not acknowledged.

    - ``source``: of the first recipient; ``target``: of the other one, if there is any.
    - ``to``: id of the other recipient.
    """
    event = f"{ESCALATED}:{source.section_id}.{source.raise_number}.{source.steps + 1}"
    if target is None:
        target = Notification(to, source.alarm, source.raise_number, source.since_us)
    released_us = now_us if target.released_us is None else target.released_us
    pending = (*target.pending, event)
    return replace(target, pending=pending, called=True, released_us=released_us)


def due(notification: Notification, silencing: Silencing, now_us: int) -> tuple[str, ...]:
    """Events that may be sent at a process time."""
    if not notification.pending or is_silenced(notification.alarm, silencing, now_us):
        return ()
    if notification.released_us is None:
        return _without_unsent_raise(notification)
    return notification.pending


def is_held(section: NotificationSection, alarm: Alarm, silencing: Silencing, now_us: int) -> bool:
    """Whether an alarm is not to be sent at the moment: quiet hours, or a silence."""
    return is_quiet(section.quiet_hours, alarm.priority, now_us) or is_silenced(
        alarm, silencing, now_us
    )


def is_silenced(alarm: Alarm, silencing: Silencing, now_us: int) -> bool:
    """Whether silences are about all assets of an alarm at a process time."""
    return all(silencing.covers(asset, now_us) for asset in records.assets_of(alarm))


def is_quiet(quiet: QuietHours | None, priority: int, now_us: int) -> bool:
    """Whether quiet hours hold a priority back at a process time."""
    return quiet is not None and priority in quiet.priorities and is_within(quiet, (), now_us)
