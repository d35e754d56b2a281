"""Shelving, suppression by design, out of service, latches and re-alarms."""

import os
import signal
import subprocess
import sys
import uuid
from dataclasses import replace
from pathlib import Path

import alarm_bench
import pytest
from alarm_bench import COLD, HOT, SECOND_US, UNKNOWN, Bench
from hypothesis import given, settings
from hypothesis import strategies as st
from patience import patience

from service.alarms import (
    LONGEST_SHELVING_S,
    SET_ASIDE_STATES,
    AlarmCondition,
    AlarmState,
    NotAllowedError,
    UnknownAlarmError,
)
from service.store import Alarm

STANDS = "the machine stands"


def suppressed(condition: AlarmCondition, reason: str = STANDS) -> AlarmCondition:
    return replace(condition, suppressed_reason=reason)


def raised(bench: Bench, condition: AlarmCondition = HOT) -> str:
    bench.after(1, condition)
    return bench.only().id


# ---------------------------------------------------------------------------- shelving
@pytest.mark.parametrize(("condition", "state"), [(HOT, "UNACK"), (COLD, "NORM")])
def test_shelving_ends_by_itself_as_the_condition_is_then(
    bench: Bench, condition: AlarmCondition, state: str
) -> None:
    alarm_id = raised(bench)
    bench.book.acknowledge(alarm_id, "eva")
    shelved = bench.book.shelve(alarm_id, 600, "eva", "the sensor is being changed")
    assert (shelved.state, shelved.shelved_by) == ("SHLVD", "eva")
    assert shelved.shelved_until_us == bench.clock.us + 600 * SECOND_US
    assert bench.after(599, condition) == "SHLVD"
    assert bench.after(1, condition) == state
    line = bench.journal()[-1]
    assert (line.event, line.who, line.from_state, line.to_state) == (
        "unshelve", "service", "SHLVD", state,
    )  # fmt: skip
    back = bench.told[-1]
    assert (back.shelved_until_us, back.shelved_by) == (None, None)


def test_shelving_ends_even_if_nobody_evaluates_or_knows_the_condition(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    bench.clock.advance(600)
    assert bench.book.alarm(alarm_id).state == "UNACK"  # the last that was known
    bench.book.shelve(alarm_id, 600, "eva")
    bench.after(600, UNKNOWN)
    assert bench.only().state == "UNACK"


def test_shelving_ends_after_a_restart_and_keeps_what_came_meanwhile(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    until_us = bench.only().shelved_until_us
    bench.after(10, COLD)
    bench.restart()
    kept = bench.only()
    assert (kept.state, kept.shelved_until_us, kept.present) == ("SHLVD", until_us, False)
    bench.clock.advance(590)
    assert bench.book.active() == []
    assert bench.journal()[-1].to_state == "NORM"


@pytest.mark.wires
def test_what_was_said_outlives_a_killed_process(bench: Bench) -> None:
    """Shelved, acknowledged and out of service, by a process that has no time to close."""
    code = (
        "import os, signal, sys, pathlib\n"
        "from dataclasses import replace\n"
        "from alarm_bench import HOT, Bench\n"
        "bench = Bench(pathlib.Path(sys.argv[1]))\n"
        "for channel in 'abc': bench.after(1, replace(HOT, channel=channel))\n"
        "ids = {one.channel: one.id for one in bench.book.active()}\n"
        "bench.book.acknowledge(ids['a'], 'eva', 'seen')\n"
        "bench.book.shelve(ids['b'], 600, 'eva')\n"
        "bench.book.take_out_of_service(ids['c'], 'ina', 'on order')\n"
        "assert bench.outbox.flush(30)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    other = bench.data_dir / "other"
    tests = Path(alarm_bench.__file__).parent
    path = os.pathsep.join([str(tests), str(tests.parent)])
    killed = subprocess.run(
        [sys.executable, "-c", code, str(other)],
        env=os.environ | {"PYTHONPATH": path},
        timeout=patience(180),
        check=False,
    )
    assert killed.returncode == -signal.SIGKILL
    after = Bench(other)
    try:
        assert {alarm.channel: alarm.state for alarm in after.book.active()} == {
            "a": "ACKED",
            "b": "SHLVD",
            "c": "OOSRV",
        }
        assert [line.who for line in after.journal()[3:]] == ["eva", "eva", "ina"]
        after.clock.advance(603)
        assert next(one for one in after.book.active() if one.channel == "b").state == "UNACK"
    finally:
        after.close()


def test_a_clock_that_is_set_back_does_not_prolong_shelving(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    bench.clock.advance(-30 * 86_400)
    assert bench.book.alarm(alarm_id).state == "UNACK"


@pytest.mark.parametrize("duration_s", [0, -1, LONGEST_SHELVING_S + 1, float("nan")])
def test_shelving_needs_a_duration_within_eight_hours(bench: Bench, duration_s: float) -> None:
    alarm_id = raised(bench)
    with pytest.raises(ValueError, match="expected more than 0 and at most 28800 s"):
        bench.book.shelve(alarm_id, duration_s, "eva")
    assert bench.state() == "UNACK"


def test_shelving_can_be_renewed_and_ended_early(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    bench.clock.advance(500)
    again = bench.book.shelve(alarm_id, 600, "ben", "not done yet")
    assert (again.shelved_until_us, again.shelved_by) == (bench.clock.us + 600 * SECOND_US, "ben")
    assert bench.after(599, HOT) == "SHLVD"
    assert bench.book.unshelve(alarm_id, "ben", "done").state == "UNACK"
    with pytest.raises(NotAllowedError, match="is UNACK: cannot unshelve it"):
        bench.book.unshelve(alarm_id, "ben")


def test_what_is_normal_can_be_shelved_before_it_comes(bench: Bench) -> None:
    bench.after(0, COLD)
    (normal,) = bench.book.normal()
    assert bench.book.active() == []
    shelved = bench.book.shelve(normal.id, 600, "eva", "maintenance")
    assert shelved.raised_at_us == 0
    assert bench.book.normal() == []
    assert bench.after(10, HOT) == "SHLVD"
    assert bench.only().raised_at_us == bench.clock.us
    assert bench.after(590, HOT) == "UNACK"
    bench.after(1, COLD)
    bench.book.acknowledge(bench.only().id, "eva")
    (normal,) = bench.book.normal()
    assert normal.id != shelved.id
    with pytest.raises(NotAllowedError, match="is NORM"):
        bench.book.acknowledge(normal.id, "eva")


# ---------------------------------------------------------------------------- suppression
def test_suppressed_by_design_tells_nobody_and_says_why(bench: Bench) -> None:
    assert bench.after(0, suppressed(COLD)) == "NORM"
    assert bench.after(1, suppressed(HOT)) == "DSUPR"
    assert bench.only().suppressed_reason == STANDS
    assert bench.journal()[-1].comment == STANDS
    assert bench.after(1, suppressed(HOT, "no data")) == "DSUPR"
    assert bench.only().suppressed_reason == "no data"
    assert bench.after(1, suppressed(COLD)) == "DSUPR"
    assert bench.after(1, COLD) == "NORM"
    assert "UNACK" not in {line.to_state for line in bench.journal()}


def test_suppression_takes_a_standing_alarm_and_gives_it_back(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.acknowledge(alarm_id, "eva")
    assert bench.after(1, suppressed(HOT)) == "DSUPR"
    assert bench.after(1, HOT) == "UNACK"
    assert bench.only().suppressed_reason is None
    assert bench.only().id == alarm_id


def test_what_has_returned_unacknowledged_still_waits_for_somebody(bench: Bench) -> None:
    raised(bench)
    bench.after(1, COLD)
    assert bench.after(1, suppressed(COLD)) == "RTNUN"
    assert bench.after(1, suppressed(HOT)) == "DSUPR"


def test_shelving_hides_a_suppressed_alarm_and_ends_in_suppression(bench: Bench) -> None:
    bench.after(1, suppressed(HOT))
    bench.book.shelve(bench.only().id, 600, "eva")
    assert bench.only().suppressed_reason is None
    assert bench.after(599, suppressed(HOT)) == "SHLVD"
    assert bench.after(1, suppressed(HOT)) == "DSUPR"


SLOW_HOT = replace(HOT, off_delay_s=120.0, deadband=1.0)
SLOW_COLD = replace(SLOW_HOT, active=False, value=80.0)
IN_DEADBAND = replace(SLOW_COLD, value=104.5)


@pytest.mark.parametrize("now", [SLOW_COLD, IN_DEADBAND])
def test_the_end_of_a_suppression_raises_nothing_that_does_not_hold_then(
    bench: Bench, now: AlarmCondition
) -> None:
    """Neither the off-delay nor the deadband keeps what was never seen."""
    bench.after(1, suppressed(SLOW_HOT))
    assert bench.after(1, suppressed(now)) == "DSUPR"
    assert bench.after(1, now) == "NORM"
    assert bench.after(1, SLOW_HOT) == "UNACK"
    assert [line.to_state for line in bench.journal()] == ["DSUPR", "NORM", "UNACK"]


@pytest.mark.parametrize("act", ["unshelve", "return_to_service", "by time"])
def test_what_comes_back_by_hand_or_by_time_is_as_it_is_then(bench: Bench, act: str) -> None:
    alarm_id = raised(bench, SLOW_HOT)
    if act == "return_to_service":
        bench.book.take_out_of_service(alarm_id, "ina", "sensor is on order")
    else:
        bench.book.shelve(alarm_id, 600, "eva")
    bench.after(599, SLOW_COLD)
    if act == "by time":
        bench.clock.advance(1)
        assert bench.book.active() == []
    else:
        assert getattr(bench.book, act)(alarm_id, "ina").state == "NORM"
    assert bench.told[-1].returned_at_us == bench.clock.us
    assert bench.after(1, replace(SLOW_HOT, on_delay_s=100.0)) == "NORM", "its delay begins now"


def test_a_suppressed_alarm_waits_until_its_condition_is_known(bench: Bench) -> None:
    """Data come back before there is a rate: what was true before the gap is not true now."""
    bench.after(1, SLOW_HOT)
    bench.after(1, suppressed(UNKNOWN, "no data for inner ring"))
    assert bench.after(1, UNKNOWN) == "DSUPR"
    assert bench.only().suppressed_reason == "no value to judge by yet"
    assert bench.after(1, SLOW_COLD) == "NORM"
    bench.after(1, SLOW_HOT)
    bench.after(1, suppressed(UNKNOWN))
    assert bench.after(1, UNKNOWN) == "DSUPR"
    assert bench.after(1, SLOW_HOT) == "UNACK"


# ---------------------------------------------------------------------------- out of service
def test_out_of_service_lasts_until_somebody_ends_it(bench: Bench) -> None:
    alarm_id = raised(bench)
    out = bench.book.take_out_of_service(alarm_id, "ina", "sensor is on order")
    assert (out.state, out.comment) == ("OOSRV", "sensor is on order")
    for condition in (COLD, HOT, suppressed(HOT), HOT):
        assert bench.after(100_000, condition) == "OOSRV"
    for action in (bench.book.acknowledge, bench.book.reset, bench.book.unshelve):
        with pytest.raises(NotAllowedError, match="is OOSRV"):
            action(alarm_id, "eva")
    with pytest.raises(NotAllowedError, match="is OOSRV: cannot shelve it"):
        bench.book.shelve(alarm_id, 60, "eva")
    bench.restart()
    assert bench.only().state == "OOSRV"
    assert bench.book.return_to_service(alarm_id, "ina", "new sensor").state == "UNACK"


def test_a_normal_alarm_goes_out_of_service_and_comes_back_normal(bench: Bench) -> None:
    bench.after(0, COLD)
    (normal,) = bench.book.normal()
    bench.book.take_out_of_service(normal.id, "ina", "not fitted yet")
    assert bench.book.return_to_service(normal.id, "ina").state == "NORM"
    assert bench.book.active() == []


def test_who_sets_a_normal_alarm_aside_finds_it_again_under_the_same_id(bench: Bench) -> None:
    bench.after(0, COLD)
    (normal,) = bench.book.normal()
    for _ in range(2):
        bench.book.shelve(normal.id, 600, "eva", "cable is being moved")
        assert bench.book.unshelve(normal.id, "eva").state == "NORM"
    bench.book.take_out_of_service(normal.id, "ina", "not fitted yet")
    bench.book.return_to_service(normal.id, "ina")
    with pytest.raises(NotAllowedError, match="is NORM: cannot unshelve it"):
        bench.book.unshelve(normal.id, "eva")
    assert [(one.id, one.comment) for one in bench.book.normal()] == [(normal.id, None)]
    assert bench.after(1, HOT) == "UNACK"
    assert bench.only().id == normal.id
    bench.book.acknowledge(normal.id, "eva")
    bench.after(1, COLD)
    (after,) = bench.book.normal()
    assert after.id != normal.id, "its life is over"


# ---------------------------------------------------------------------------- latches
LATCHED_HOT = replace(HOT, latched=True)
LATCHED_COLD = replace(COLD, latched=True)


@pytest.mark.parametrize("acknowledge_first", [True, False])
def test_a_latched_alarm_waits_for_its_reset(bench: Bench, acknowledge_first: bool) -> None:
    alarm_id = raised(bench, LATCHED_HOT)
    if acknowledge_first:
        bench.book.acknowledge(alarm_id, "eva")
        bench.after(1, LATCHED_COLD)
    else:
        bench.after(1, LATCHED_COLD)
        with pytest.raises(NotAllowedError, match="is RTNUN: cannot reset it"):
            bench.book.reset(alarm_id, "eva")
        bench.book.acknowledge(alarm_id, "eva")
    bench.restart()
    assert bench.state() == "LATCH"
    assert bench.after(1, LATCHED_COLD) == "LATCH"
    assert bench.book.reset(alarm_id, "eva", "looked at it").state == "NORM"
    assert bench.book.active() == []


def test_a_latch_outlives_suppression_but_not_one_that_never_rang(bench: Bench) -> None:
    raised(bench, LATCHED_HOT)
    bench.after(1, suppressed(LATCHED_HOT))
    bench.after(1, suppressed(LATCHED_COLD))
    assert bench.after(1, LATCHED_COLD) == "LATCH"
    assert bench.after(1, LATCHED_HOT) == "UNACK"
    other = replace(LATCHED_COLD, channel="t_node_1_c")
    bench.after(1, other)
    (normal,) = bench.book.normal()
    bench.book.shelve(normal.id, 60, "eva")
    assert bench.after(60, other) == "NORM"


# ---------------------------------------------------------------------------- re-alarm
def test_an_acknowledged_alarm_that_stands_too_long_is_raised_again(bench: Bench) -> None:
    standing = replace(HOT, re_alarm_s=3600)
    alarm_id = raised(bench, standing)
    bench.clock.advance(1800)
    bench.book.acknowledge(alarm_id, "eva")
    assert bench.after(3599, standing) == "ACKED"
    assert bench.after(1, standing) == "UNACK"
    assert bench.journal()[-1].event == "re-alarm"
    assert bench.only().id == alarm_id
    assert bench.after(10_000, standing) == "UNACK"
    bench.book.acknowledge(alarm_id, "eva")
    assert bench.after(10_000, replace(standing, re_alarm_s=0)) == "ACKED"


def test_what_has_gone_is_not_raised_again_while_its_off_delay_runs(bench: Bench) -> None:
    alarm_id = raised(bench, replace(SLOW_HOT, re_alarm_s=3600))
    bench.book.acknowledge(alarm_id, "eva")
    bench.after(3599, replace(SLOW_HOT, re_alarm_s=3600))
    assert bench.after(1, replace(SLOW_COLD, re_alarm_s=3600)) == "ACKED"
    assert bench.after(120, replace(SLOW_COLD, re_alarm_s=3600)) == "NORM"


# ---------------------------------------------------------------------------- words and events
def test_comments_are_journaled_and_the_last_one_is_shown(bench: Bench) -> None:
    alarm_id = raised(bench)
    bench.book.comment(alarm_id, "eva", "fan is dirty")
    assert bench.only().comment == "fan is dirty"
    assert bench.told[-1].comment == "fan is dirty"
    line = bench.journal()[-1]
    assert (line.event, line.from_state, line.to_state, line.comment) == (
        "comment", "UNACK", "UNACK", "fan is dirty",
    )  # fmt: skip
    bench.after(1, COLD)
    bench.book.acknowledge(alarm_id, "eva")
    with pytest.raises(UnknownAlarmError):
        bench.book.comment(alarm_id, "eva", "too late")


def test_events_are_in_the_journal_and_never_among_the_alarms(bench: Bench) -> None:
    bench.book.record_event("bench-1", "model drift", "friction rose by 8 %", comment="version 4")
    (line,) = bench.journal()
    assert (line.alarm_id, line.kind, line.who) == (None, "model drift", "service")
    assert bench.book.active() == []
    assert bench.told == []


def test_what_is_no_longer_configured_does_not_stay_for_ever(bench: Bench) -> None:
    gone = replace(HOT, channel="t_node_4_c")
    bench.after(0, HOT)
    bench.after(0, gone)
    bench.restart()
    bench.book.withdraw("bench-1", {HOT.key})
    assert bench.only().channel == HOT.channel
    line = bench.journal()[-1]
    assert (line.to_state, line.comment) == ("NORM", "no longer configured")


# ---------------------------------------------------------------------------- any story
ACTIONS = ("acknowledge", "reset", "shelve", "unshelve", "take_out_of_service", "return_to_service")


def act(bench: Bench, alarm: Alarm, action: str) -> None:
    arguments = {"shelve": (300.0, "eva"), "take_out_of_service": ("eva", "why")}
    getattr(bench.book, action)(alarm.id, *arguments.get(action, ("eva",)))


@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from([*ACTIONS, True, False, None]),
            st.booleans(),
            st.sampled_from([0, 1, 50, 400]),
        ),
        max_size=30,
    ),
    latched=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_any_story_is_whole(
    shared_bench: Bench, steps: list[tuple[str | bool | None, bool, int]], latched: bool
) -> None:
    bench, asset = shared_bench, uuid.uuid4().hex
    base = replace(HOT, asset=asset, latched=latched, re_alarm_s=200.0)
    for what, hidden, seconds in steps:
        bench.clock.advance(seconds)
        if isinstance(what, str):
            for alarm in bench.book.active(asset) or bench.book.normal(asset):
                try:
                    act(bench, alarm, what)
                except NotAllowedError:
                    assert bench.book.alarm(alarm.id).state == alarm.state
        else:
            value = {True: 106.0, False: 80.0, None: None}[what]
            bench.book.evaluate(
                replace(
                    base, active=what, value=value, suppressed_reason=STANDS if hidden else None
                )
            )
        for alarm in bench.book.active(asset):
            assert AlarmState(alarm.state) is not AlarmState.NORM
            assert (alarm.state == "SHLVD") == (alarm.shelved_until_us is not None)
            assert (alarm.state == "DSUPR") == (alarm.suppressed_reason is not None)
            assert alarm.state not in ("UNACK", "ACKED") or alarm.present
            assert alarm.state not in ("RTNUN", "LATCH") or not alarm.present
    journal = [line for line in bench.journal() if line.asset == asset]
    states = ["NORM", *(line.to_state for line in journal)]
    assert [line.from_state for line in journal] == states[:-1]
    kept = [alarm for alarm in bench.store.alarms.load() if alarm.asset == asset]
    assert [alarm.state for alarm in kept] == [alarm.state for alarm in bench.book.active(asset)]
    # Whatever was: eight hours later nothing is shelved any more.
    bench.clock.advance(LONGEST_SHELVING_S)
    hidden = {alarm.state for alarm in bench.book.active(asset)} & SET_ASIDE_STATES
    assert "SHLVD" not in hidden
