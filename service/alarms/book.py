"""The alarm book: which alarms there are now, and what became of each."""

import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace

from adapters.protocol import Clock
from service.alarms.records import (
    AlarmKey,
    event_line,
    following,
    journal_line,
    updated,
    urgency,
    with_peak,
)
from service.alarms.register import Register, Watched
from service.alarms.states import ACTIVE_STATES, SET_ASIDE_STATES, AlarmEvent, AlarmState
from service.alarms.timers import Timer
from service.clock import MICROSECONDS
from service.domain.alarm_condition import AlarmCondition, EventKind
from service.store import Alarm, AlarmChange, AuditEntry, Outbox

#: Who the journal names for what happens without a person.
SERVICE = "service"
#: No alarm may be shelved for longer at a time, in process seconds.
LONGEST_SHELVING_S = 8 * 3600.0
_EVENTS_OF_A_CHANGE = 500
_NOT_CONFIGURED = "no longer configured"
_TIME_IS_OVER = "the shelving time has expired"
# What is said to the alarm of a source counts for these of its channels, too.
_COVERED = ("stale data", "sensor fault")
_PASSED_ON = (AlarmEvent.ACKNOWLEDGE, AlarmEvent.SHELVE)


class NotAllowedError(ValueError):
    """An alarm's state does not allow what was asked; the text names alarm, state and wish."""


class AlarmBook:
    """Turns conditions into alarms with delays, deadbands, acknowledgement and a journal.

    The book is in memory; it never waits for the store. Changes are written behind it, in order,
    and read back at the next start. All methods may be called from any thread.

    An alarm has an id for one life, which ends when it is normal after it was raised. It has that
    id before it is raised, so that it can be shelved or taken out of service; until one of that
    happens it is not kept.

    Parameters
    ----------
    outbox : Outbox
        Knows the alarms that were open when the service stopped; takes the changes.
    clock : Clock
        Delays and shelving count in its process time.
    on_change : callable
        Gets every alarm whose state, message or priority changed, in order, also once when it
        has become normal. It must return quickly.
    begins_empty : bool
        Whether the open alarms are another cell's until `take_over` names their assets.
    """

    def __init__(
        self,
        outbox: Outbox,
        clock: Clock,
        on_change: Callable[[Alarm], None],
        *,
        begins_empty: bool = False,
    ) -> None:
        self._clock = clock
        self._on_change = on_change
        self._lock = threading.RLock()
        self._register = Register([] if begins_empty else outbox.load_alarms())
        self._outbox = outbox

    # ------------------------------------------------------------------ what the rules say
    def evaluate(self, condition: AlarmCondition) -> None:
        """Take note of the present truth of a condition; raises, renews or returns its alarm."""
        self.evaluate_all((condition,))

    def evaluate_all(self, conditions: Iterable[AlarmCondition]) -> None:
        """Take note of the present truth of many conditions, in their order, at one moment."""
        now_us = self._clock.now_us()
        with self._lock:
            self._end_shelving(now_us)
            for condition in conditions:
                watched = self._register.take(condition, now_us)
                if condition.active or not watched.rests:
                    self._judge(watched, condition, now_us)
                elif condition.active is False:  # as almost always, and nothing comes of it
                    watched.figures = condition

    def _judge(self, watched: Watched, condition: AlarmCondition, now_us: int) -> None:
        alarm, holds = watched.alarm, condition.active
        if alarm.present and holds is False and condition.in_deadband:
            holds = None
        if holds is None:
            if watched.timer is not None:
                watched.timer.pause()
        elif holds == alarm.present:
            watched.timer = None
            alarm = self._renew(watched, condition, now_us)
        else:
            watched.timer = timer = watched.timer or Timer()
            if timer.run(now_us) >= (condition.on_delay_s if holds else condition.off_delay_s):
                watched.timer = None
                alarm = self._turn(alarm, condition, holds, now_us)
        alarm = self._suppress(alarm, condition, now_us)
        standing_s = (now_us - alarm.since_us) / MICROSECONDS
        if alarm.state == AlarmState.ACKED and 0 < condition.re_alarm_s <= standing_s:
            self._move(alarm, AlarmEvent.RE_ALARM, now_us, SERVICE)

    def withdraw(self, asset: str, known: Collection[AlarmKey]) -> None:
        """End the alarms of an asset whose conditions do not exist any more.

        After a change of the configuration nothing would ever bring them back to normal.

        Parameters
        ----------
        asset : str
            Whose alarms.
        known : collection of tuple
            The keys of all conditions that the asset has.
        """
        now_us = self._clock.now_us()
        with self._lock:
            for key, watched in list(self._register.open.items()):
                if key[0] == asset and key not in known:
                    gone = replace(watched.alarm, present=False, returned_at_us=now_us)
                    self._go(gone, AlarmState.NORM, "withdraw", now_us, SERVICE, _NOT_CONFIGURED)

    def forget(self, assets: Collection[str]) -> None:
        """End the alarms of assets that are not followed any more, and know nothing of them."""
        with self._lock:
            for asset in assets:
                self.withdraw(asset, ())
            self._register.forget(set(assets))

    def leave(self, assets: Collection[str]) -> None:
        """Know nothing of some assets any more: their alarms go on in another cell."""
        with self._lock:
            self._register.forget(set(assets))

    def take_over(self, assets: Collection[str]) -> None:
        """Go on with the open alarms of assets that another cell followed; reads from the store."""
        wanted = set(assets)
        alarms = [alarm for alarm in self._outbox.load_alarms() if alarm.asset in wanted]
        with self._lock:
            self._register.add(alarms)

    def record_event(
        self, asset: str, kind: EventKind, message: str, who: str = SERVICE, comment: str = ""
    ) -> None:
        """Write an event into the journal: worth knowing, but no alarm."""
        event = event_line(asset, kind, message, self._clock.now_us(), who, comment)
        self._outbox.record(AlarmChange(None, (event,)))

    def record_events(self, assets: Sequence[str], kind: EventKind, message: str) -> None:
        """Write the same event of many assets into the journal."""
        now_us = self._clock.now_us()
        for begin in range(0, len(assets), _EVENTS_OF_A_CHANGE):
            portion = assets[begin : begin + _EVENTS_OF_A_CHANGE]
            lines = tuple(event_line(one, kind, message, now_us, SERVICE) for one in portion)
            self._outbox.record(AlarmChange(None, lines))

    # ------------------------------------------------------------------ what people say
    def acknowledge(
        self, alarm_id: str, who: str, comment: str = "", audit: AuditEntry | None = None
    ) -> Alarm:
        """Acknowledge an alarm and return it as it is then; one that has returned is over.

        The line of the audit trail, where there is one, is written in one transaction with the
        alarm's change. So it is by the methods below.

        Raises
        ------
        UnknownAlarmError
            If there is no alarm of this id.
        NotAllowedError
            If the alarm's state does not allow it. So do the methods below.
        """
        return self._act(alarm_id, AlarmEvent.ACKNOWLEDGE, who, comment, audit=audit)

    def reset(
        self, alarm_id: str, who: str, comment: str = "", audit: AuditEntry | None = None
    ) -> Alarm:
        """Reset a latched alarm that has returned to normal and is acknowledged."""
        return self._act(alarm_id, AlarmEvent.RESET, who, comment, audit=audit)

    def shelve(
        self,
        alarm_id: str,
        duration_s: float,
        who: str,
        comment: str = "",
        audit: AuditEntry | None = None,
    ) -> Alarm:
        """Set an alarm aside for a while; it comes back by itself.

        Parameters
        ----------
        alarm_id : str
            Which alarm.
        duration_s : float
            Process seconds, at most `LONGEST_SHELVING_S`.
        who, comment : str
            For the journal.
        audit : AuditEntry, optional
            See `acknowledge`.
        """
        if not 0 < duration_s <= LONGEST_SHELVING_S:
            raise ValueError(
                f"duration_s {duration_s:g}: expected more than 0 and at most "
                f"{LONGEST_SHELVING_S:g} s"
            )
        return self._act(alarm_id, AlarmEvent.SHELVE, who, comment, duration_s, audit)

    def unshelve(
        self, alarm_id: str, who: str, comment: str = "", audit: AuditEntry | None = None
    ) -> Alarm:
        """End the shelving of an alarm early."""
        return self._act(alarm_id, AlarmEvent.UNSHELVE, who, comment, audit=audit)

    def take_out_of_service(
        self, alarm_id: str, who: str, comment: str, audit: AuditEntry | None = None
    ) -> Alarm:
        """Silence an alarm until it is returned to service."""
        return self._act(alarm_id, AlarmEvent.TAKE_OUT, who, comment, audit=audit)

    def return_to_service(
        self, alarm_id: str, who: str, comment: str = "", audit: AuditEntry | None = None
    ) -> Alarm:
        """Let an alarm that was out of service work again."""
        return self._act(alarm_id, AlarmEvent.PUT_BACK, who, comment, audit=audit)

    def comment(
        self, alarm_id: str, who: str, comment: str, audit: AuditEntry | None = None
    ) -> Alarm:
        """Write a comment on an alarm that is not over."""
        now_us = self._clock.now_us()
        with self._lock:
            alarm = replace(self.alarm(alarm_id), comment=comment)
            if alarm.state == AlarmState.NORM:
                raise NotAllowedError(f"alarm {alarm_id} is NORM: it has nothing to comment on")
            self._register.keep(alarm)
            line = journal_line(alarm, alarm.state, "comment", now_us, who, comment)
            self._outbox.record(AlarmChange(alarm, (line,), audit))
            self._on_change(alarm)
        return alarm

    # ------------------------------------------------------------------ what there is
    def alarm(self, alarm_id: str) -> Alarm:
        """Give one alarm.

        Raises
        ------
        UnknownAlarmError
            If there is no alarm of this id.
        """
        with self._lock:
            self._end_shelving(self._clock.now_us())
            return self._register.find(alarm_id)

    def present(self, asset: str) -> frozenset[tuple[str, str, str]]:
        """Kind, channel and level of every condition of an asset that is there.

        With its delays, whatever the state of its alarm.
        """
        with self._lock:
            return self._register.present(asset)

    def active(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are not over, of one asset or of all: see `urgency` for their order."""
        return self._listed(asset, normal=False)

    def normal(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are normal: the conditions that are watched and not there."""
        return self._listed(asset, normal=True)

    # ------------------------------------------------------------------ changes
    def _listed(self, asset: str | None, normal: bool) -> list[Alarm]:
        with self._lock:
            self._end_shelving(self._clock.now_us())
            listed = self._register.listed(asset, normal)
        return sorted(listed, key=urgency)

    def _act(
        self,
        alarm_id: str,
        event: AlarmEvent,
        who: str,
        comment: str,
        duration_s: float = 0.0,
        audit: AuditEntry | None = None,
    ) -> Alarm:
        now_us = self._clock.now_us()
        with self._lock:
            alarm = self.alarm(alarm_id)
            if following(alarm, event) is None:
                by = f" (acknowledged by {alarm.acknowledged_by})" if alarm.acknowledged_by else ""
                raise NotAllowedError(
                    f"alarm {alarm_id} is {alarm.state}{by}: cannot {_ACTIONS[event]}"
                )
            if event == AlarmEvent.ACKNOWLEDGE:
                alarm = replace(alarm, acknowledged_at_us=now_us, acknowledged_by=who)
            elif event == AlarmEvent.SHELVE:
                until_us = now_us + round(duration_s * MICROSECONDS)
                alarm = replace(alarm, shelved_until_us=until_us, shelved_by=who)
            alarm = self._move(alarm, event, now_us, who, comment, audit)
            condition = self._register.condition(alarm)
            if condition is None:
                return alarm
            if event in _PASSED_ON:
                self._pass_on(alarm, condition, event, who, comment, duration_s)
            return self._suppress(alarm, condition, now_us)

    def _pass_on(
        self,
        alarm: Alarm,
        condition: AlarmCondition,
        event: AlarmEvent,
        who: str,
        comment: str,
        duration_s: float,
    ) -> None:
        """Say the same to the open alarms that this one covers: one cause, one answer."""
        comment = comment or f"with: {alarm.message}"
        for other in [watched.alarm for watched in self._register.open.values()]:
            if (
                other.asset == alarm.asset
                and other.kind in _COVERED
                and other.channel in condition.covers
                and other.state not in SET_ASIDE_STATES
                and following(other, event) is not None
            ):
                self._act(other.id, event, who, comment, duration_s)

    def _end_shelving(self, now_us: int) -> None:
        """Bring back what was shelved long enough; also after the clock was set back by hours."""
        longest_us = round(LONGEST_SHELVING_S * MICROSECONDS)
        for alarm in [self._register.open[key].alarm for key in self._register.shelved]:
            until_us = alarm.shelved_until_us
            if until_us is not None and not 0 < until_us - now_us <= longest_us:
                alarm = self._move(alarm, AlarmEvent.UNSHELVE, now_us, SERVICE, _TIME_IS_OVER)
                condition = self._register.condition(alarm)
                if condition is not None:
                    self._suppress(alarm, condition, now_us)

    def _turn(self, alarm: Alarm, condition: AlarmCondition, holds: bool, now_us: int) -> Alarm:
        """Take in that the condition has come or gone, delays included."""
        if holds:
            alarm = replace(
                updated(alarm, condition),
                present=True,
                raised_at_us=alarm.raised_at_us or now_us,
                returned_at_us=None,
            )
            alarm = with_peak(alarm, now_us)
            event = AlarmEvent.SUPPRESS if condition.suppressed_reason else AlarmEvent.RAISE
        else:
            alarm = replace(alarm, present=False, returned_at_us=now_us)
            event = AlarmEvent.RETURN
        if following(alarm, event) is None:  # set aside already
            return self._replace(alarm)
        if event == AlarmEvent.SUPPRESS:
            alarm = replace(alarm, suppressed_reason=condition.suppressed_reason)
        return self._move(alarm, event, now_us, SERVICE)

    def _suppress(self, alarm: Alarm, condition: AlarmCondition, now_us: int) -> Alarm:
        """Set aside what means nothing now, and bring it back."""
        reason = condition.suppressed_reason
        if reason and alarm.state in ACTIVE_STATES:
            return self._move(
                replace(alarm, suppressed_reason=reason), AlarmEvent.SUPPRESS, now_us, SERVICE
            )
        if alarm.state == AlarmState.DSUPR:
            if not reason:
                return self._move(alarm, AlarmEvent.UNSUPPRESS, now_us, SERVICE)
            if reason != alarm.suppressed_reason:
                return self._replace(replace(alarm, suppressed_reason=reason))
        return alarm

    def _renew(self, watched: Watched, condition: AlarmCondition, now_us: int) -> Alarm:
        """Keep the figures fresh; only a new text or priority of an open alarm is news."""
        alarm = watched.alarm
        if not alarm.present:
            if alarm.state == AlarmState.NORM:
                watched.figures = condition
            return alarm  # what was wrong when it returned stays to be read
        renewed = with_peak(updated(alarm, condition), now_us)
        if (renewed.message, renewed.priority) == (alarm.message, alarm.priority):
            self._register.keep(renewed)
            return renewed
        return self._replace(renewed)

    def _move(
        self,
        alarm: Alarm,
        event: AlarmEvent,
        now_us: int,
        who: str,
        comment: str = "",
        audit: AuditEntry | None = None,
    ) -> Alarm:
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
        line = journal_line(moved, alarm.state, event, now_us, who, comment)
        self._outbox.record(AlarmChange(moved, (line,), audit))
        self._on_change(moved)
        return moved

    def _replace(self, alarm: Alarm) -> Alarm:
        """Take news of an alarm that stays in its state."""
        self._register.keep(alarm)
        self._outbox.record(AlarmChange(alarm))
        self._on_change(alarm)
        return alarm


_ACTIONS = {
    AlarmEvent.ACKNOWLEDGE: "acknowledge it",
    AlarmEvent.RESET: "reset it",
    AlarmEvent.SHELVE: "shelve it",
    AlarmEvent.UNSHELVE: "unshelve it",
    AlarmEvent.TAKE_OUT: "take it out of service",
    AlarmEvent.PUT_BACK: "return it to service",
}
