"""The alarm book: which alarms there are now, and what became of each."""

import threading
from collections.abc import Callable
from dataclasses import replace
from uuid import uuid4

from adapters.drivers import Clock
from service.alarms.conditions import AlarmCondition
from service.alarms.recorder import AlarmRecorder
from service.alarms.states import ACTIVE_STATES, AlarmEvent, AlarmState, next_state
from service.store import Alarm, AlarmTransition, Store

#: Who the journal names for what happens without a person.
SERVICE = "service"
_MICROSECONDS = 1_000_000


class UnknownAlarmError(KeyError):
    """There is no open alarm of this id."""


class AlarmBook:
    """Turns conditions into alarms with delays, deadbands, acknowledgement and a journal.

    The book is in memory; it never waits for the store. Changes are written behind it, in order
    (`flush` waits for them), and read back at the next start. All methods may be called from any
    thread.

    Parameters
    ----------
    store : Store
        Holds the alarms that were open when the service stopped; takes the changes.
    clock : Clock
        Delays count in its process time.
    on_change : callable
        Gets every alarm whose state, message or priority changed, in order, also once when it
        has become normal. It must return quickly.
    """

    def __init__(self, store: Store, clock: Clock, on_change: Callable[[Alarm], None]) -> None:
        self._clock = clock
        self._on_change = on_change
        self._lock = threading.RLock()
        self._timers: dict[tuple[str, str, str, str], _Timer] = {}
        self._open = {_key(alarm): alarm for alarm in store.load_alarms()}
        self._recorder = AlarmRecorder(store)

    def evaluate(self, condition: AlarmCondition) -> None:
        """Take note of the present truth of a condition; raises, renews or returns its alarm."""
        now_us = self._clock.now_us()
        with self._lock:
            alarm = self._open.get(condition.key)
            raised = alarm is not None and alarm.state in ACTIVE_STATES
            holds = condition.active
            if raised and holds is False and condition.in_deadband:
                holds = None
            timer = self._timers.setdefault(condition.key, _Timer())
            if holds is None:
                timer.pause()
            elif holds == raised:
                timer.reset()
                if alarm is not None and raised:
                    self._renew(alarm, condition)
            elif timer.run(now_us) >= (condition.on_delay_s if holds else condition.off_delay_s):
                timer.reset()
                if holds:
                    self._raise(alarm, condition, now_us)
                elif alarm is not None:
                    self._move(
                        replace(alarm, returned_at_us=now_us), AlarmEvent.RETURN, now_us, SERVICE
                    )

    def acknowledge(self, alarm_id: str, who: str, comment: str = "") -> Alarm:
        """Acknowledge an open alarm and return it as it is then.

        An alarm that was acknowledged already stays as it is; one that has returned to normal is
        over thereby.

        Parameters
        ----------
        alarm_id : str
            Which alarm.
        who, comment : str
            For the journal.

        Raises
        ------
        UnknownAlarmError
            If there is no open alarm of this id.
        """
        now_us = self._clock.now_us()
        with self._lock:
            alarm = self.alarm(alarm_id)
            if next_state(AlarmState(alarm.state), AlarmEvent.ACKNOWLEDGE) == alarm.state:
                return alarm
            return self._move(
                replace(alarm, acknowledged_at_us=now_us, acknowledged_by=who),
                AlarmEvent.ACKNOWLEDGE,
                now_us,
                who,
                comment,
            )

    def alarm(self, alarm_id: str) -> Alarm:
        """Give one open alarm.

        Raises
        ------
        UnknownAlarmError
            If there is no open alarm of this id.
        """
        with self._lock:
            for alarm in self._open.values():
                if alarm.id == alarm_id:
                    return alarm
        raise UnknownAlarmError(f"no open alarm {alarm_id!r}")

    def active(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are not over, of one asset or of all: most urgent first, then newest."""
        with self._lock:
            alarms = [one for one in self._open.values() if asset is None or one.asset == asset]
        return sorted(alarms, key=lambda one: (one.priority, -one.raised_at_us, one.id))

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until the store has all changes so far; False when that takes too long."""
        return self._recorder.flush(timeout_s)

    def close(self, timeout_s: float = 2.0) -> None:
        """Write what is left, for at most so many wall seconds, and stop."""
        self._recorder.close(timeout_s)

    def _raise(self, alarm: Alarm | None, condition: AlarmCondition, now_us: int) -> None:
        if alarm is None:
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
                raised_at_us=now_us,
                since_us=now_us,
                returned_at_us=None,
                acknowledged_at_us=None,
                acknowledged_by=None,
                value=None,
                limit_value=None,
                unit=None,
                lead_time_s=None,
                probability=None,
            )
        alarm = replace(_updated(alarm, condition), returned_at_us=None)
        self._move(alarm, AlarmEvent.RAISE, now_us, SERVICE)

    def _renew(self, alarm: Alarm, condition: AlarmCondition) -> None:
        """Keep the figures of a standing alarm fresh; only a new text or priority is news."""
        renewed = _updated(alarm, condition)
        self._open[_key(alarm)] = renewed
        if (renewed.message, renewed.priority) != (alarm.message, alarm.priority):
            self._recorder.record(renewed)
            self._on_change(renewed)

    def _move(
        self, alarm: Alarm, event: AlarmEvent, now_us: int, who: str, comment: str = ""
    ) -> Alarm:
        state = next_state(AlarmState(alarm.state), event)
        moved = replace(alarm, state=state.value, since_us=now_us)
        if state == AlarmState.NORM:
            del self._open[_key(moved)]
        else:
            self._open[_key(moved)] = moved
        self._recorder.record(
            moved,
            AlarmTransition(
                alarm_id=moved.id,
                asset=moved.asset,
                kind=moved.kind,
                channel=moved.channel,
                level=moved.level,
                time_us=now_us,
                from_state=alarm.state,
                to_state=state.value,
                who=who,
                comment=comment,
                value=moved.value,
                message=moved.message,
            ),
        )
        self._on_change(moved)
        return moved


class _Timer:
    """Adds up the process time during which a condition was known to differ from its alarm."""

    def __init__(self) -> None:
        self._total_us = 0
        self._last_us: int | None = None

    def run(self, now_us: int) -> float:
        """Go on counting; returns the seconds so far."""
        if self._last_us is not None:
            self._total_us += max(now_us - self._last_us, 0)
        self._last_us = now_us
        return self._total_us / _MICROSECONDS

    def pause(self) -> None:
        """Stand still until the condition is known again."""
        self._last_us = None

    def reset(self) -> None:
        """Begin anew."""
        self._total_us = 0
        self._last_us = None


def _key(alarm: Alarm) -> tuple[str, str, str, str]:
    return alarm.asset, alarm.kind, alarm.channel, alarm.level


def _updated(alarm: Alarm, condition: AlarmCondition) -> Alarm:
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
    )
