"""How an alarm follows its condition: delays, the deadband, and what was between two looks."""

from dataclasses import replace
from typing import NamedTuple

from service.alarms.changes import AlarmChanges
from service.alarms.register import Watched
from service.alarms.states import ACTIVE_STATES, AlarmState
from service.alarms.timers import Timer
from service.domain.alarm_condition import AlarmCondition
from service.store import Alarm


def follow(
    changes: AlarmChanges, watched: Watched, condition: AlarmCondition, now_us: int
) -> Alarm:
    """Let an alarm follow its condition from the last look to this one; gives it as it is then.

    What has come since the last look is shown until the next one.
    """
    has_come = False
    for at_us, seen in condition.since_last_look(watched.judged_from_us):
        for step in (_hold, _follow):
            was_present, alarm = watched.alarm.present, watched.alarm
            # What was acknowledged returns, so that the next time calls again; what is open goes on
            # until it is gone at a look.
            may_return = (
                not has_come
                and alarm.state == AlarmState.ACKED
                and at_us >= (alarm.acknowledged_at_us or 0)
            )
            step(_Moment(changes, watched, seen, at_us, now_us, may_return))
            has_come |= watched.alarm.present and not was_present
    _follow(_Moment(changes, watched, condition, now_us, now_us, not has_come))
    return watched.alarm


class _Moment(NamedTuple):
    """A condition as it was at a time, and what is known of its alarm at this look.

    ``may_return``: whether the alarm may end by it.
    """

    changes: AlarmChanges
    watched: Watched
    condition: AlarmCondition
    at_us: int
    now_us: int
    may_return: bool


def _hold(moment: _Moment) -> None:
    """Count until a new value, as one holds until the next: its delay may be over by then."""
    changes, watched, condition, at_us, now_us, may_return = moment
    timer = watched.timer
    if timer is None or timer.is_paused:
        return
    passed_s = timer.run_to(at_us)
    if watched.alarm.present:
        if may_return and passed_s >= condition.off_delay_s:
            watched.timer = None
            changes.turn(watched, condition, False, now_us, None)
    elif not condition.active and timer.highest and passed_s >= condition.on_delay_s:
        watched.timer = None
        highest = replace(condition, active=True, value=timer.highest[0])
        changes.turn(watched, highest, True, now_us, timer.highest)


def _follow(moment: _Moment) -> None:
    """Let an alarm follow its condition as it was at a time, now or since the last look."""
    changes, watched, condition, at_us, now_us, may_return = moment
    alarm, holds = watched.alarm, condition.active
    if alarm.present and holds is False and condition.in_deadband:
        holds = None
    if alarm.state in ACTIVE_STATES and condition.probability is not None:
        # Its text says how probable it is.
        alarm = changes.renew(watched, condition, at_us)
    if holds is None:
        if watched.timer is not None:
            watched.timer.pause()
    elif holds == alarm.present:
        watched.timer = None
        changes.renew(watched, condition, at_us)
    else:
        watched.timer = timer = watched.timer or Timer()
        passed_s = timer.run(at_us) if at_us == now_us else timer.run_to(at_us)
        if holds:
            timer.note(condition.value, at_us)
        delay_s = condition.on_delay_s if holds else condition.off_delay_s
        if passed_s >= delay_s and (holds or may_return):
            watched.timer = None
            changes.turn(watched, condition, holds, now_us, timer.highest)
