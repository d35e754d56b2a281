"""The clock is set while a machine is followed: nothing of it is older, younger or forgotten."""

from collections.abc import Callable
from typing import Any

import pytest
from alarm_bench import SECOND_US

from adapters.samples import Quality, Sample
from service.live.readings import Readings

from .conftest import Live
from .test_watch import Machine, make_machine
from .warm_machine import WARM, running, waiting

__all__ = ["make_machine"]

STEPS_S = (-3600, 3600, -600, 30 * 86_400, -30 * 86_400)
every_step = pytest.mark.parametrize("step_s", STEPS_S)
CHANNEL, SLOW = "t_inner_ring_c", "ambient_c"
NOW_US = 1_790_000_000_000_000
MakeMachine = Callable[..., Machine]


def set_clock(machine: Machine, step_s: int) -> None:
    machine.clock.advance(step_s)
    machine.book.clock_set(step_s * SECOND_US)
    machine.readings.clock_set(step_s * SECOND_US, machine.clock.us)
    machine.estimate.clock_set(step_s * SECOND_US)
    machine.watch.clock_set(step_s * SECOND_US)


@every_step
def test_a_value_is_as_old_as_before(step_s: int) -> None:
    readings = Readings("bench-1", {CHANNEL: 10.0, SLOW: 1800.0}, NOW_US)
    readings.add(
        Sample("bench-1", name, NOW_US, 40.0, Quality.GOOD, NOW_US) for name in (CHANNEL, SLOW)
    )
    now_us = NOW_US + 6 * SECOND_US + step_s * SECOND_US
    readings.clock_set(step_s * SECOND_US, now_us)
    assert readings.good_value(CHANNEL, now_us + 3 * SECOND_US) == 40.0
    assert readings.good_value(CHANNEL, now_us + 5 * SECOND_US) is None
    assert readings.good_value(SLOW, now_us + 1793 * SECOND_US) == 40.0
    assert readings.good_value(SLOW, now_us + 1795 * SECOND_US) is None
    later = Sample("bench-1", CHANNEL, now_us + 1, 41.0, Quality.GOOD, now_us + 1)
    assert readings.add([later]) == [later], "what comes then is news"


@every_step
def test_a_value_by_the_new_time_is_left_as_it_is(step_s: int) -> None:
    """A gateway has followed the time server a moment before us."""
    readings = Readings("bench-1", {CHANNEL: 10.0}, NOW_US)
    now_us = NOW_US + step_s * SECOND_US
    early = Sample("bench-1", CHANNEL, now_us - 200_000, 40.0, Quality.GOOD, now_us - 100_000)
    readings.add([early])
    readings.clock_set(step_s * SECOND_US, now_us)
    assert readings.latest[CHANNEL] == early


@every_step
def test_a_standing_machine_stands_as_long_as_it_does(
    make_machine: MakeMachine, step_s: int
) -> None:
    hot = WARM | {"t_inner_ring_c": 75.0, "t_outer_ring_c": 60.0}
    key = ("measured limit", "t_inner_ring_c warning")
    machine = make_machine(alarms={"rate_of_rise": {"enabled": False}})
    machine.run(hot, 30)
    machine.run(hot | {"speed_rpm": 0.0}, 40)
    set_clock(machine, step_s)
    machine.run(hot | {"speed_rpm": 0.0}, 10)
    assert machine.states()[key] == "UNACK"
    machine.run(hot | {"speed_rpm": 0.0}, 20)
    assert machine.states()[key] == "DSUPR"


@every_step
def test_a_rate_is_known_without_a_gap(make_machine: MakeMachine, step_s: int) -> None:
    machine = make_machine()
    machine.run(WARM, 400)
    for k in range(60):
        if k == 40:
            set_clock(machine, step_s)
        machine.run(WARM | {"t_inner_ring_c": 55.0 + k * 5.0 / 60.0 * 5.0}, 5.0)
    assert machine.states()["rate of rise", "t_inner_ring_c warning"] == "UNACK"
    assert not [kind for kind, _ in machine.states() if kind == "stale data"]


@every_step
def test_the_twin_goes_on_without_a_new_start(make_machine: MakeMachine, step_s: int) -> None:
    machine = make_machine()
    machine.run(WARM, 300)
    followed_s = machine.estimate.followed_s
    set_clock(machine, step_s)
    machine.run(WARM, 60)
    assert machine.estimate.followed_s == pytest.approx(followed_s + 60.0)


@every_step
async def test_verdict_plan_and_forecast_hold(make_live: Callable[..., Live], step_s: int) -> None:
    live = make_live(max_age_s=600.0)
    await running(live, WARM)

    def planned() -> Any:
        live.plan((1800.0, 2400.0, 2650.0), (3600.0, 6200.0, 5500.0))
        forecast = live.documents.forecast()
        return forecast if forecast and forecast.planned else None

    await live.until(planned, "a forecast along the plan", WARM)
    before = live.documents.verdict()
    ahead = plan(live)
    await live.stop()
    live.clock._start_us += step_s * SECOND_US
    live.runtime.clock_set(step_s * SECOND_US)
    live.runtime.documents.running = True
    after = live.documents.verdict()
    assert words(before) == words(after)
    assert plan(live) == ahead == [2400.0, 6200.0]
    stored = len(live.stored)
    live.start()
    await live.until(lambda: len(live.stored) > stored, "estimates for the store", WARM)


@every_step
async def test_a_kept_estimate_that_waits_for_the_kernels_is_as_old_as_before(
    make_live: Callable[..., Live], step_s: int
) -> None:
    live = await waiting(make_live)
    live.clock._start_us += step_s * SECOND_US
    live.runtime.clock_set(step_s * SECOND_US)
    live.ready.set()
    await live.until(lambda: live.runtime.estimate.started, "the kept estimate")
    time_us = live.runtime.estimate.time_us
    assert time_us is not None
    assert 0 <= live.clock.now_us() - time_us < 1800 * SECOND_US


def plan(live: Live) -> list[float]:
    controller = live.documents.summary().controller
    assert controller is not None
    return [step.speed_rpm for step in controller.plan or []]


def words(document: Any) -> list[str]:
    return [one.word for one in document.by_name.values()]
