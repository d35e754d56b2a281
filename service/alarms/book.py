"""The alarm book: which alarms there are now, and what became of each."""

import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from adapters.protocol import Clock
from service.alarms.changes import SERVICE, AlarmChanges, NotAllowedError
from service.alarms.following import follow
from service.alarms.records import (
    AlarmKey,
    as_it_is,
    assets_of,
    event_line,
    following,
    journal_line,
    key_of,
    refusal,
    shortened,
    urgency,
)
from service.alarms.register import Register, Watched
from service.alarms.states import SET_ASIDE_STATES, AlarmEvent, AlarmState
from service.clock import MICROSECONDS
from service.domain.alarm_condition import AlarmCondition, EventKind
from service.domain.alarm_guidance import AlarmName
from service.domain.alarm_kind import SENSOR_FAULT
from service.domain.causes import STALE_DATA
from service.store import Alarm, AlarmChange, AuditEntry, Outbox

#: No alarm may be shelved for longer at a time, in process seconds.
LONGEST_SHELVING_S = 8 * 3600.0
_EVENTS_OF_A_CHANGE = 500
#: Alarms whose shelving ends in one go; the others follow with the next call.
_BACK_AT_ONCE = 20
_NOT_CONFIGURED = "no longer configured"
_TIME_IS_OVER = "the shelving time has expired"
_ONE_ALARM = "one alarm for all assets of its cause"
# What is said to the alarm of a source counts for these of its channels, too.
_COVERED = (STALE_DATA, SENSOR_FAULT)
_PASSED_ON = (AlarmEvent.ACKNOWLEDGE, AlarmEvent.SHELVE)
_COMES_BACK = (AlarmEvent.UNSHELVE, AlarmEvent.PUT_BACK)


class AlarmBook:
    """Turns conditions into alarms with delays, deadbands, acknowledgement and a journal.

    The book is in memory; it never waits for the store. Changes are written behind it, in order,
    and read back at the next start. All methods may be called from any thread.

    An alarm has an id for one life, which ends when it is normal after it was raised. It has that
    id before it is raised, so that it can be shelved or taken out of service; until one of that
    happens it is not kept.

    - ``on_change``: gets every alarm whose state, message or priority changed, in order, also once
      when it has become normal. It must return quickly.
    - ``begins_empty``: whether the open alarms are another cell's until `take_over` names their
      assets.
    - ``loaded_by_us``: by how many microseconds the clock was set since the open alarms were dated.
      None: by another clock; they go by the calendar, and no setting of this one moves them.
    """

    def __init__(
        self,
        outbox: Outbox,
        clock: Clock,
        on_change: Callable[[Alarm], None],
        *,
        begins_empty: bool = False,
        loaded_by_us: int | None = 0,
    ) -> None:
        self._clock = clock
        self._on_change = on_change
        self._lock = threading.RLock()
        self._register = Register([] if begins_empty else outbox.load_alarms())
        if loaded_by_us is not None:
            self._register.dated_here()
            self._register.clock_set(loaded_by_us)
        self._outbox = outbox
        self._changes = AlarmChanges(self._register, outbox, on_change)

    # ------------------------------------------------------------------ what the rules say
    def evaluate(self, condition: AlarmCondition) -> None:
        """Record the present truth of a condition; raises, renews or returns its alarm."""
        self.evaluate_all((condition,))

    def evaluate_all(self, conditions: Iterable[AlarmCondition]) -> None:
        """Record the present truth of many conditions, in their order, at one moment."""
        now_us = self._clock.now_us()
        with self._lock:
            self._end_surplus(now_us)
            self._end_shelving(now_us)
            for condition in conditions:
                watched = self._register.take(condition, now_us)
                if condition.active or not watched.rests or condition.was_active:
                    self._judge(watched, condition, now_us)
                elif condition.active is False:  # as almost always, and nothing comes of it
                    watched.figures = condition

    def _judge(self, watched: Watched, condition: AlarmCondition, now_us: int) -> None:
        joined = watched.join(condition)
        alarm = follow(self._changes, watched, condition, now_us)
        alarm = self._changes.suppress(alarm, condition, now_us)
        holds = condition.active if not alarm.present or not condition.in_deadband else None
        standing_s = (now_us - alarm.since_us) / MICROSECONDS
        is_due = holds is not False and 0 < condition.re_alarm_s <= standing_s
        if alarm.state == AlarmState.ACKED and (is_due or joined):
            comment = f"also: {shortened(sorted(joined))}" if joined else ""
            self._changes.move(alarm, AlarmEvent.RE_ALARM, now_us, SERVICE, comment)

    def withdraw(self, asset: str, known: Collection[AlarmKey]) -> None:
        """End the alarms of an asset whose conditions are not among those that are known.

        After a change of the configuration nothing would ever bring them back to normal.
        """
        now_us = self._clock.now_us()
        with self._lock:
            for alarm in self._register.open_of(asset):
                if (key := key_of(alarm))[0] and key not in known:
                    self._changes.withdraw(alarm, now_us, _NOT_CONFIGURED)

    def pause_delays(self, asset: str) -> None:
        """Let the delays of an asset stand still: its conditions were not judged for a while."""
        with self._lock:
            self._register.pause_timers(asset)

    def drop_delays(self, asset: str, names: Collection[AlarmName]) -> None:
        """Let delays of alarms begin from zero, which are judged otherwise from now on."""
        with self._lock:
            self._register.drop_timers(asset, names)

    def shared(self) -> dict[AlarmKey, Alarm]:
        """Give the open alarms of causes that assets share."""
        with self._lock:
            return self._register.shared()

    def keep_under(self, key: AlarmKey, assets: Collection[str] | None) -> None:
        """Keep a shared alarm under one of these assets; of none it ends.

        None: it goes on in another cell, and nothing is known of it here any more.
        """
        now_us = self._clock.now_us()
        with self._lock:
            alarm = self.shared().get(key)
            if assets and alarm is not None and alarm.asset not in assets:
                self._changes.replace(replace(alarm, asset=min(assets)))
            elif not assets:
                if assets is not None and alarm is not None:
                    self._changes.withdraw(alarm, now_us, _NOT_CONFIGURED)
                self._register.drop(key)

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

    def record_events(
        self,
        assets: Sequence[str],
        kind: EventKind,
        message: str,
        times_us: Mapping[str, int] | None = None,
    ) -> None:
        """Write the same event of many assets into the journal; without times it is now."""
        now_us, times_us = self._clock.now_us(), times_us or {}
        for begin in range(0, len(assets), _EVENTS_OF_A_CHANGE):
            portion = assets[begin : begin + _EVENTS_OF_A_CHANGE]
            lines = tuple(
                event_line(one, kind, message, times_us.get(one, now_us), SERVICE)
                for one in portion
            )
            self._outbox.record(AlarmChange(None, lines))

    def dated_elsewhere(self) -> set[str]:
        """Give the ids of alarms that another clock dated, and that go by the calendar."""
        with self._lock:
            return self._register.dated_elsewhere()

    def keep_moved(self) -> None:
        """Have all open alarms written as they are, where times were moved as they were loaded."""
        with self._lock:
            for watched in self._register.listed(None, normal=False):
                self._changes.replace(watched.alarm)

    def clock_set(self, by_us: int) -> None:
        """Let delays, shelving and what stands go on: the clock was set by so much."""
        with self._lock:
            for alarm in self._register.clock_set(by_us):
                self._changes.replace(alarm)

    # ------------------------------------------------------------------ what people say
    def acknowledge(
        self, alarm_id: str, who: str, comment: str = "", audit: AuditEntry | None = None
    ) -> Alarm:
        """Acknowledge an alarm and return it as it is then; one that has returned is over.

        The line of the audit trail, where there is one, is written in one transaction with the
        alarm's change. So it is by the methods below. Raises `UnknownAlarmError` if there is no
        alarm of this id; `NotAllowedError` if the alarm's state does not allow it. So do the
        methods below.
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
        """Shelve an alarm for a while; it comes back automatically.

        ``duration_s``: process seconds, at most `LONGEST_SHELVING_S`.
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
        """Give one alarm. Raises `UnknownAlarmError` if there is no alarm of this id."""
        with self._lock:
            self._end_shelving(self._clock.now_us())
            return self._register.find(alarm_id)

    def loaded(self) -> list[Alarm]:
        """All alarms that are not over, as they are: no shelving ends by this."""
        with self._lock:
            return [watched.shown for watched in self._register.listed(None, normal=False)]

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

    def watched(self, asset: str | None, *, normal: bool) -> list[Watched]:
        """As `active` or `normal`, in no order; `Watched.shown` gives the alarm as it is then."""
        with self._lock:
            self._end_shelving(self._clock.now_us())
            return self._register.listed(asset, normal)

    def assets(self, *, normal: bool) -> list[str]:
        """Assets that have such alarms, in the order of their ids."""
        with self._lock:
            return self._register.assets(normal)

    # ------------------------------------------------------------------ changes
    def _listed(self, asset: str | None, normal: bool) -> list[Alarm]:
        with self._lock:
            listed = [watched.shown for watched in self.watched(asset, normal=normal)]
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
                raise NotAllowedError(refusal(alarm, event))
            if event == AlarmEvent.ACKNOWLEDGE:
                alarm = replace(alarm, acknowledged_at_us=now_us, acknowledged_by=who)
            elif event == AlarmEvent.SHELVE:
                until_us = now_us + round(duration_s * MICROSECONDS)
                alarm = replace(alarm, shelved_until_us=until_us, shelved_by=who)
            condition = self._register.condition(alarm)
            if event in _COMES_BACK:
                alarm = as_it_is(alarm, condition, now_us)
            alarm = self._changes.move(alarm, event, now_us, who, comment, audit)
            if condition is None:
                return alarm
            if event in _PASSED_ON:
                self._pass_on(alarm, condition, event, who, comment, duration_s)
            return self._changes.suppress(alarm, condition, now_us)

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
        for asset in assets_of(alarm) if condition.covers else ():
            for other in self._register.open_of(asset):
                if (
                    other.kind in _COVERED
                    and other.channel in condition.covers
                    and other.state not in SET_ASIDE_STATES
                    and following(other, event) is not None
                ):
                    self._act(other.id, event, who, comment, duration_s)

    def _end_surplus(self, now_us: int) -> None:
        """End the alarms of a cause that has another one."""
        surplus, self._register.surplus = self._register.surplus, []
        for alarm in surplus:
            gone = replace(alarm, present=False, returned_at_us=now_us, state="NORM")
            self._changes.record(alarm, gone, "withdraw", now_us, SERVICE, _ONE_ALARM)
        shared = self._register.shared()
        for key in {key_of(alarm) for alarm in surplus} & shared.keys():
            self._changes.replace(shared[key])

    def _end_shelving(self, now_us: int) -> None:
        """Bring back what was shelved long enough, or by a clock that was ahead by hours."""
        longest_us = round(LONGEST_SHELVING_S * MICROSECONDS)
        for alarm in self._register.shelving_over(now_us, longest_us, _BACK_AT_ONCE):
            condition = self._register.condition(alarm)
            alarm = as_it_is(alarm, condition, now_us)
            alarm = self._changes.move(alarm, AlarmEvent.UNSHELVE, now_us, SERVICE, _TIME_IS_OVER)
            if condition is not None:
                self._changes.suppress(alarm, condition, now_us)
