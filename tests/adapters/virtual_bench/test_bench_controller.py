import numpy as np
import pytest

from adapters.virtual_bench import UnknownScenarioError, find_scenario, list_scenarios
from adapters.virtual_bench.controller import BenchController, RunState
from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.scenarios import BenchPhase, Scenario, SensorFault
from adapters.virtual_bench.sensors import PT100_CHANNELS
from service.cli.bench import SCENARIO_NAMES


def _controller(*steps: BenchPhase) -> BenchController:
    scenario = Scenario("test", "", "6311", steps)
    return BenchController(scenario, BenchParameters.for_bearing("6311"), seed=1)


_REST = BenchPhase("rest", 100.0, 0.0, 2000.0, "low")
_RUN = BenchPhase("run", 200.0, 3000.0, 2000.0, "low")
_LOAD = BenchPhase("load", 300.0, 3000.0, 3000.0, "high")


def test_every_scenario_of_the_issue_is_there() -> None:
    names = [scenario.name for scenario in list_scenarios()]
    assert len(set(names)) == len(names) == 9
    assert set(names) == set(SCENARIO_NAMES)  # those that the command line names in its help
    stairs = find_scenario("staircase").steps[1:]
    assert [step.speed_rpm for step in stairs] == [1500, 2400, 4200, 4900, 5600, 6200]
    assert {(step.load_n, step.duration_s) for step in stairs} == {(2650.0, 5400.0)}


def test_demo_keeps_its_low_risk_part_low() -> None:
    steps = find_scenario("demo").steps
    low = [step for step in steps if step.risk == "low"]
    assert max(step.speed_rpm for step in low) <= 4300
    assert max(step.load_n for step in low) <= 3400
    first_high = next(index for index, step in enumerate(steps) if step.risk == "high")
    assert [step.risk for step in steps[:first_high]] == ["low"] * first_high
    assert [(s.speed_rpm, s.load_n) for s in steps if s.risk == "high"] == [
        (6200, 2650),
        (6200, 5500),
    ]


def test_unknown_scenario_lists_the_known() -> None:
    with pytest.raises(UnknownScenarioError, match=r"'stairs'.*staircase.*demo"):
        find_scenario("stairs")


def test_faults_name_real_channels_and_fit_their_kind() -> None:
    for scenario in list_scenarios():
        for fault in scenario.faults:
            assert isinstance(fault, SensorFault)
            on_can = fault.channel in {"speed_rpm", "load_n"}
            assert on_can or fault.channel in PT100_CHANNELS
            assert on_can == (fault.kind == "not available")
            assert fault.start_s + fault.duration_s < scenario.duration_s  # it recovers


def test_plan_counts_down_and_moves_up() -> None:
    controller = _controller(_REST, _RUN, _LOAD)
    early = controller.state(10.0)
    assert (early.phase, early.run_state) == (1, RunState.STANDING)
    assert [(row.duration_s, row.speed_rpm) for row in early.plan] == [
        (90, 0.0),
        (200, 3000.0),
        (300, 3000.0),
    ]
    assert early.seconds_left == 90
    later = controller.state(150.4)
    assert (later.phase, later.run_state) == (2, RunState.RUNNING)
    assert later.plan[0].duration_s == later.seconds_left == 150
    assert later.elapsed_s == 150
    assert len(later.plan) == 2


def test_a_high_risk_step_is_postponed_and_a_low_risk_step_is_not() -> None:
    controller = _controller(_REST, _RUN, _LOAD, _RUN)
    controller.postpone_high_risk(90.0, 110.0)  # the low-risk step at 100 s
    assert controller.state(100.0).phase == 2
    controller.postpone_high_risk(299.0, 320.0)  # the high-risk step at 300 s
    assert controller.state(320.0).phase == 2
    assert [(row.duration_s, row.load_n) for row in controller.state(320.0).plan] == [
        (1, 2000.0),
        (300, 3000.0),
        (200, 2000.0),
    ]
    assert controller.state(321.0).phase == 3
    controller.postpone_high_risk(321.0, 400.0)  # it has begun: nothing stops it
    assert controller.state(400.0).phase == 3
    assert controller.state(621.0).phase == 4
    speed, load = controller.true_point(np.array([320.0]))
    assert (speed[0], load[0]) == (3000.0, pytest.approx(2000.0, abs=100.0))


def test_standstill_after_the_end() -> None:
    state = _controller(_REST, _RUN, _LOAD).state(10_000.0)
    assert (state.phase, state.run_state) == (4, RunState.FINISHED)
    assert state.plan == ()
    assert (state.seconds_left, state.speed_setpoint_rpm, state.load_setpoint_n) == (0, 0.0, 0.0)


def test_speed_follows_its_ramp() -> None:
    controller = _controller(_REST, _RUN, _LOAD)
    speed, _ = controller.true_point(np.array([99.0, 100.0, 110.0, 130.0, 250.0, 605.0, 900.0]))
    assert speed == pytest.approx([0.0, 0.0, 1000.0, 3000.0, 3000.0, 2500.0, 0.0])


def test_load_has_hysteresis() -> None:
    heavy = BenchPhase("heavy", 100.0, 3000.0, 3000.0, "low")
    light = BenchPhase("light", 100.0, 3000.0, 2000.0, "low")
    controller = _controller(light, heavy, light)
    _, load = controller.true_point(np.array([50.0, 190.0, 290.0]))
    assert load == pytest.approx([2000.0, 2980.0, 2020.0])  # play of 20 N either way


def test_trip_stops_for_good() -> None:
    controller = _controller(_REST, _RUN, _LOAD)
    controller.trip(160.0)
    controller.trip(170.0)
    speed, _ = controller.true_point(np.array([159.0, 165.0, 400.0]))
    assert speed == pytest.approx([3000.0, 2500.0, 0.0])
    state = controller.state(200.0)
    assert (state.run_state, state.plan, state.phase) == (RunState.FAULT, (), 3)


def test_ambient_drifts_slowly_within_its_swing() -> None:
    ambient = _controller(_REST).ambient_c(np.arange(0.0, 40_000.0, 60.0))
    assert 0.3 < ambient.max() - ambient.min() < 1.2
    assert np.abs(np.diff(ambient)).max() < 0.05
