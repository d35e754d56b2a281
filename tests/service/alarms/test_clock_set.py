"""A clock that is set changes neither a delay nor a shelving, and no alarm stands for another time.

The book is given by how much the clock was set in the moment in which it is, as the cell does it.
"""

from dataclasses import replace

import pytest
from alarm_bench import COLD, HOT, SECOND_US, Bench

from service.alarms import SharedCauses
from service.domain.causes import STALE_DATA

STEPS_S = (-3600, 3600, -600, 30 * 86_400, -30 * 86_400)
every_step = pytest.mark.parametrize("step_s", STEPS_S)


def set_clock(bench: Bench, step_s: int) -> None:
    bench.clock.advance(step_s)
    bench.book.clock_set(step_s * SECOND_US)


def raised(bench: Bench) -> str:
    bench.after(0, HOT)
    assert bench.after(HOT.on_delay_s, HOT) == "UNACK"
    return bench.only().id


@every_step
def test_shelving_ends_after_its_time(bench: Bench, step_s: int) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    bench.clock.advance(200)
    set_clock(bench, step_s)
    assert bench.only().shelved_until_us == bench.clock.us + 400 * SECOND_US
    assert bench.after(399, HOT) == "SHLVD"
    assert bench.after(2, HOT) == "UNACK"


@every_step
def test_shelving_ends_after_its_time_across_a_restart(bench: Bench, step_s: int) -> None:
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    bench.clock.advance(200)
    set_clock(bench, step_s)
    bench.restart()
    assert bench.after(399, HOT) == "SHLVD"
    bench.clock.advance(-step_s)  # while the service is off; it is found at the start
    bench.restart(loaded_by_us=-step_s * SECOND_US)
    assert bench.state() == "SHLVD"
    bench.book.keep_moved()
    bench.restart()
    assert bench.after(0, HOT) == "SHLVD"
    assert bench.after(2, HOT) == "UNACK"


@every_step
def test_delays_are_counted_on(bench: Bench, step_s: int) -> None:
    slow = replace(HOT, on_delay_s=30.0)
    assert bench.after(0, slow) == "NORM"
    assert bench.after(10, slow) == "NORM"
    set_clock(bench, step_s)
    assert bench.after(19, slow) == "NORM"
    assert bench.after(1, slow) == "UNACK"
    over = replace(COLD, off_delay_s=30.0)
    bench.after(0, over)
    set_clock(bench, step_s)
    assert bench.after(29, over) == "UNACK"
    assert bench.after(1, over) == "RTNUN"


@every_step
def test_an_acknowledged_alarm_calls_again_after_its_time(bench: Bench, step_s: int) -> None:
    again = replace(HOT, re_alarm_s=900.0)
    bench.after(0, again)
    bench.after(again.on_delay_s, again)
    bench.book.acknowledge(bench.only().id, "eva")
    bench.clock.advance(600)
    set_clock(bench, step_s)
    assert bench.after(299, again) == "ACKED"
    assert bench.after(1, again) == "UNACK"


@every_step
def test_an_alarm_has_stood_as_long_as_it_did(bench: Bench, step_s: int) -> None:
    raised(bench)
    bench.clock.advance(100)
    set_clock(bench, step_s)
    told = len(bench.told)
    bench.after(100, COLD)
    bench.after(COLD.off_delay_s, COLD)
    assert bench.only().state == "RTNUN"
    line = bench.journal()[-1]
    assert line.duration_s == pytest.approx(200 + COLD.off_delay_s)
    assert [alarm.state for alarm in bench.told[told:]] == ["RTNUN"]


@every_step
def test_an_open_alarm_is_kept_and_announced_as_it_is_then(bench: Bench, step_s: int) -> None:
    alarm_id = raised(bench)
    bench.book.acknowledge(alarm_id, "eva")
    before, lines = bench.only(), len(bench.journal())
    set_clock(bench, step_s)
    after = bench.only()
    assert bench.told[-1] == after
    assert after == replace(
        before,
        **{
            name: getattr(before, name) + step_s * SECOND_US
            for name in ("since_us", "raised_at_us", "acknowledged_at_us", "peak_at_us")
        },
    )
    assert len(bench.journal()) == lines, "what was written stays as it was"
    bench.restart()
    assert bench.only() == after


@every_step
def test_the_delay_of_a_shared_cause_is_counted_on(bench: Bench, step_s: int) -> None:
    shared = SharedCauses(bench.book)
    lost = replace(HOT, kind=STALE_DATA, channel="source:pt100", level="", on_delay_s=30.0)

    def after(seconds: float) -> list[str]:
        bench.clock.advance(seconds)
        shared.take(lost, bench.clock.us)
        shared.evaluate()
        return [alarm.state for alarm in bench.book.active()]

    assert after(0) == after(10) == []
    set_clock(bench, step_s)
    shared.clock_set(step_s * SECOND_US)
    assert after(19) == []
    assert after(1) == ["UNACK"]


@every_step
def test_what_was_dated_before_the_machine_was_started_goes_by_the_calendar(
    bench: Bench, step_s: int
) -> None:
    """Its clock may have been wrong until a time server put it right."""
    alarm_id = raised(bench)
    bench.book.shelve(alarm_id, 600, "eva")
    until_us = bench.only().shelved_until_us
    bench.restart(loaded_by_us=None)
    set_clock(bench, step_s)
    bench.clock.advance(-step_s)
    assert bench.only().shelved_until_us == until_us
    bench.clock.advance(1)
    bench.book.shelve(alarm_id, 500, "eva")  # by the present clock
    assert bench.book.dated_elsewhere() == set()
    set_clock(bench, step_s)
    assert bench.after(499, HOT) == "SHLVD"
    assert bench.after(2, HOT) == "UNACK"
