"""What becomes of an alarm: each change is kept, journalled and announced as one."""

from collections.abc import Callable
from dataclasses import replace

from service.alarms.records import (
    as_it_is,
    following,
    journal_line,
    news_of,
    updated,
    with_peak,
)
from service.alarms.register import Register, Watched
from service.alarms.states import ACTIVE_STATES, AlarmEvent, AlarmState
from service.domain.alarm_condition import AlarmCondition
from service.domain.errors import BearingTwinError
from service.store import Alarm, AlarmChange, AuditEntry, Outbox

#: Who the journal names for what happens without a person.
SERVICE = "service"
_NOT_KNOWN = "no value to judge by yet"


class NotAllowedError(BearingTwinError, ValueError):
    """An alarm's state does not allow what was asked; the text names alarm, state and wish."""


class AlarmChanges:
    """Moves alarms from state to state; its caller holds the lock of the book.

    - ``on_change``: gets every alarm whose state, message or priority changed.
    """

    def __init__(
        self, register: Register, outbox: Outbox, on_change: Callable[[Alarm], None]
    ) -> None:
        self._register = register
        self._outbox = outbox
        self._on_change = on_change

    def withdraw(self, alarm: Alarm, now_us: int, why: str) -> None:
        """End an alarm whose condition is not watched any more."""
        gone = replace(alarm, present=False, returned_at_us=now_us)
        self._go(gone, AlarmState.NORM, "withdraw", now_us, SERVICE, why)

    def turn(
        self,
        watched: Watched,
        condition: AlarmCondition,
        holds: bool,
        now_us: int,
        highest: tuple[float, int] | None,
    ) -> Alarm:
        """Take in that the condition has come or gone, delays included.

        ``highest``: the highest value in the delay, and when it was.
        """
        alarm = watched.alarm
        if holds:
            alarm = replace(
                updated(alarm, condition),
                present=True,
                raised_at_us=alarm.raised_at_us or now_us,
                returned_at_us=None,
            )
            if highest is not None:
                alarm = with_peak(alarm, *highest)
            event = AlarmEvent.SUPPRESS if condition.suppressed_reason else AlarmEvent.RAISE
        else:
            # What is over names all that had it in its life.
            assets = tuple(sorted(watched.had)) if watched.had else alarm.assets
            alarm = replace(alarm, present=False, returned_at_us=now_us, assets=assets)
            event = AlarmEvent.RETURN
        if following(alarm, event) is None:  # set aside already
            return self.replace(alarm)
        if event == AlarmEvent.SUPPRESS:
            alarm = replace(alarm, suppressed_reason=condition.suppressed_reason)
        return self.move(alarm, event, now_us, SERVICE)

    def suppress(self, alarm: Alarm, condition: AlarmCondition, now_us: int) -> Alarm:
        """Set aside what means nothing now, and bring it back as it is then."""
        reason = condition.suppressed_reason
        if not reason and condition.holds is None:
            reason = alarm.suppressed_reason and _NOT_KNOWN
        if reason and alarm.state in ACTIVE_STATES:
            return self.move(
                replace(alarm, suppressed_reason=reason), AlarmEvent.SUPPRESS, now_us, SERVICE
            )
        if alarm.state == AlarmState.DSUPR:
            if not reason:
                alarm = as_it_is(alarm, condition, now_us)
                return self.move(alarm, AlarmEvent.UNSUPPRESS, now_us, SERVICE)
            if reason != alarm.suppressed_reason:
                return self.replace(replace(alarm, suppressed_reason=reason))
        return alarm

    def renew(self, watched: Watched, condition: AlarmCondition, at_us: int) -> Alarm:
        """Keep figures and peak; only a new text or priority of an open alarm is news."""
        alarm = watched.alarm
        if not alarm.present:
            if alarm.state == AlarmState.NORM:
                watched.figures = condition
            return alarm  # what was wrong when it returned stays to be read
        renewed = with_peak(updated(alarm, condition), condition.value, at_us)
        if news_of(renewed) == news_of(alarm):
            self._register.keep(renewed)
            return renewed
        return self.replace(renewed)

    def move(
        self,
        alarm: Alarm,
        event: AlarmEvent,
        now_us: int,
        who: str,
        comment: str = "",
        audit: AuditEntry | None = None,
    ) -> Alarm:
        """Let an event move an alarm to its next state."""
        state = following(alarm, event)
        if state is None:
            raise NotAllowedError(f"alarm {alarm.id} is {alarm.state}: no {event}")
        return self._go(alarm, state, str(event), now_us, who, comment, audit)

    def _go(
        self,
        alarm: Alarm,
        state: AlarmState,
        event: str,
        now_us: int,
        who: str,
        comment: str,
        audit: AuditEntry | None = None,
    ) -> Alarm:
        moved = replace(alarm, state=state.value, since_us=now_us, comment=comment or alarm.comment)
        if state != AlarmState.SHLVD:
            moved = replace(moved, shelved_until_us=None, shelved_by=None)
        if state != AlarmState.DSUPR:
            moved = replace(moved, suppressed_reason=None)
        self._register.move(moved, now_us)
        self.record(alarm, moved, event, now_us, who, comment, audit)
        return moved

    def record(
        self,
        before: Alarm,
        alarm: Alarm,
        event: str,
        now_us: int,
        who: str,
        comment: str,
        audit: AuditEntry | None = None,
    ) -> None:
        """Journal a change, have it written, and announce it."""
        line = journal_line(alarm, before.state, event, now_us, who, comment)
        self._outbox.record(AlarmChange(alarm, (line,), audit))
        self._on_change(alarm)

    def replace(self, alarm: Alarm) -> Alarm:
        """Take news of an alarm that stays in its state."""
        self._register.keep(alarm)
        self._outbox.record(AlarmChange(alarm))
        self._on_change(alarm)
        return alarm
