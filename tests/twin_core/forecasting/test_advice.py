"""Excitation advice: what it ranks first, what it refuses, and the numbers behind it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_core.bearings import bearing
from twin_core.forecasting.advice import (
    Advice,
    NothingIdentifiedError,
    advise,
)
from twin_core.forecasting.candidates import candidates, why_not
from twin_core.forecasting.design import Design, held_profile
from twin_core.forecasting.ensemble import LOAD_DEVIATION
from twin_core.forecasting.envelope import envelope
from twin_core.forecasting.runaway import LIKELY
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.identification.problem import IdentificationProblem
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.profiles import Step
from twin_core.simulation import simulate, steady_state
from twin_core.windows import LowRiskRegion, MinuteData

FloatArray = NDArray[np.float64]
SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
TRAINED = (OperatingSpan(5801.0, 2648.0, 21600.0, 0.0),)
TARGET = Step(5800.0, 5500.0, 7200.0)
REGION = LowRiskRegion(speed_rpm_max=5900.0, load_n_max=3400.0)
WARNING_C = {"t_inner_ring_c": 90.0, "t_outer_ring_c": 80.0}


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


def rows_of(model: ThermalModel, levels: tuple[Step, ...]) -> IdentificationData:
    """Noise-free data of the central machine, run from cold."""
    profile = held_profile(levels, 22.0)
    path = simulate(model, model.parameters.centre, profile, np.full(13, 22.0)).temperatures_c
    minutes = MinuteData(
        profile.time_s,
        profile.speed_rpm,
        profile.load_n,
        profile.ambient_c,
        {name: path @ model.sensor_row(name) for name in SENSORS},
        np.ones(profile.size, dtype=np.bool_),
    )
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))


def information_of(model: ThermalModel, data: IdentificationData) -> FloatArray:
    """J'J of an identification at the prior's centre: data and priors."""
    problem = IdentificationProblem(model, data)
    jacobian = problem.jacobian(np.zeros(problem.unknown_count))
    return np.asarray(jacobian.T @ jacobian)


def trained_on(model: ThermalModel, points: tuple[OperatingSpan, ...]) -> Posterior:
    """As after an identification of the central machine at some points, run from cold."""
    levels = tuple(Step(p.speed_rpm, p.load_n, p.duration_s) for p in points)
    p = model.parameters.size
    return replace(
        prior_posterior(model),
        covariance=np.linalg.inv(information_of(model, rows_of(model, levels)))[:p, :p],
        trained=TrainedRange(points, 360, True, 0.0),
    )


@pytest.fixture(scope="module")
def single_load(model: ThermalModel) -> Posterior:
    return trained_on(model, TRAINED)


@pytest.fixture(scope="module")
def state(model: ThermalModel) -> MachineState:
    values = model.parameters.centre
    warm = steady_state(model, values, 5800.0, 2650.0, 22.0, 2.0e6)
    return MachineState(warm, 0.2**2 * np.eye(13), 2.0e6, 22.0)


@pytest.fixture(scope="module")
def advice(model: ThermalModel, single_load: Posterior, state: MachineState) -> Advice:
    return advise(model, single_load, state, TARGET, REGION, WARNING_C)


# ---------------------------------------------------------------------------- the ranking
def test_a_pair_of_loads_at_the_target_speed_comes_first(advice: Advice) -> None:
    low, high = advice.steps[0].levels
    assert low.speed_rpm == high.speed_rpm == 5800.0
    assert 1300.0 <= low.load_n <= 2650.0
    assert high.load_n == 3400.0
    assert advice.steps[0].narrower_by > 0.3
    assert advice.worth_while
    assert "two loads at one speed" in advice.steps[0].why


def test_a_repetition_of_the_data_comes_last_and_says_so(advice: Advice) -> None:
    repeats = [step for step in advice.steps if "repeats a point" in step.why]
    assert {step.levels[0].load_n for step in repeats} == {2650.0}
    assert all("hardly anything new" in step.why for step in repeats)
    best, worst = advice.steps[0], advice.steps[-1]
    assert {level.load_n for level in worst.levels} == {2650.0}
    name = advice.sensor
    assert worst.cautious_half_width_k[name] > 1.3 * best.cautious_half_width_k[name]


def test_steps_are_ranked_by_the_cautious_interval(advice: Advice) -> None:
    widths = [step.cautious_half_width_k[advice.sensor] for step in advice.steps]
    # steps within three per cent are told apart by their length
    assert all(after >= before / 1.03 for before, after in pairwise(widths))
    for step in advice.steps:
        for name in SENSORS:
            assert step.half_width_k[name] <= step.cautious_half_width_k[name] + 1e-9
            assert step.cautious_half_width_k[name] <= advice.now[name].half_width_k + 1e-9


def test_where_a_runaway_is_not_excluded_steps_that_leave_the_least_of_it_come_first(
    model: ThermalModel, state: MachineState
) -> None:
    """Hot at the point, and refused where a step itself is too near to a runaway."""
    values = model.parameters.centre.copy()
    values[model.parameters.index("M0")] *= 2.2
    values[model.parameters.index("gs")] *= 0.3
    hot = replace(trained_on(model, TRAINED), z=model.parameters.z_from_values(values))
    region = LowRiskRegion(speed_rpm_max=5900.0, load_n_max=5000.0)
    found = advise(model, hot, state, TARGET, region, {})
    assert "runaway not excluded" in found.labels
    assert found.by_runaway
    assert found.margin is not None
    left = [step.runaway_probability for step in found.steps]
    assert len(left) > 5
    assert all(p is not None and p <= found.margin.probability * 1.001 for p in left)
    assert left[0] < 0.8 * found.margin.probability
    # Odds that differ by less than a factor of 1.25 are told apart by the interval.
    odds = [p / (1.0 - p) for p in left if p is not None]
    assert all(after >= before / 1.25 for before, after in pairwise(odds))
    assert f"{100 * left[0]:.1f} % expected after" in found.steps[0].why
    own = [one.reason for one in found.excluded if "runaway not excluded at" in one.reason]
    assert any("5000 N itself" in reason for reason in own)
    for step in found.steps:
        for level in step.levels:
            held = envelope(model, hot, state, [level.speed_rpm], [level.load_n], {})
            assert held.runaway_probability[0, 0] <= LIKELY


def test_where_a_runaway_is_excluded_the_interval_alone_ranks(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    near = Step(5800.0, 3600.0, 7200.0)
    found = advise(model, single_load, state, near, REGION, WARNING_C)
    assert "runaway not excluded" not in found.labels
    assert not found.by_runaway
    assert not any("runaway" in step.why for step in found.steps)


def test_a_possible_shift_takes_more_from_one_load_than_from_a_pair(advice: Advice) -> None:
    """One load cannot be told from a shift of the friction, the difference of two can."""

    def loss(levels: int) -> float:
        steps = [
            step
            for step in advice.steps
            if len(step.levels) == levels
            and step.levels[0].speed_rpm == 5800.0
            and step.levels[-1].load_n == 3400.0
        ]
        name = advice.sensor
        return float(
            np.mean([step.cautious_half_width_k[name] / step.half_width_k[name] for step in steps])
        )

    assert loss(1) > 1.05 * loss(2)


def test_the_target_is_forecast_with_its_labels(advice: Advice) -> None:
    assert advice.sensor == "t_inner_ring_c"
    for name in SENSORS:
        now = advice.now[name]
        assert now.q025 < now.q50 < now.q975
        assert now.half_width_k == pytest.approx(0.5 * (now.q975 - now.q025))
    assert advice.labels == ("load law from prior only",)


def test_beyond_the_regions_speed_the_load_moves_at_a_known_one(
    model: ThermalModel, state: MachineState
) -> None:
    slow = trained_on(model, (OperatingSpan(4200.0, 2650.0, 21600.0, 0.0),))
    region = LowRiskRegion(speed_rpm_max=4300.0, load_n_max=3400.0)
    found = advise(model, slow, state, Step(6200.0, 5500.0, 7200.0), region, WARNING_C)
    assert all(level.speed_rpm <= 4300.0 for step in found.steps for level in step.levels)
    first, second = found.steps[0].levels
    assert first.speed_rpm == second.speed_rpm
    assert first.load_n != second.load_n


def test_a_known_machine_has_nothing_left_to_learn(
    model: ThermalModel, state: MachineState
) -> None:
    known = replace(
        trained_on(model, (*TRAINED, OperatingSpan(5800.0, 3400.0, 7200.0, 21600.0))),
        covariance=1e-4 * np.eye(model.parameters.size),
    )
    found = advise(model, known, state, TARGET, REGION, WARNING_C)
    assert not found.worth_while
    assert all("hardly anything new" in step.why for step in found.steps)


# ---------------------------------------------------------------------------- the next step
def test_the_next_step_is_what_brings_most_within_twenty_minutes(advice: Advice) -> None:
    soon = [step for step in advice.steps if step.duration_s <= 1200.0]
    assert {step.duration_s for step in soon} == {600.0, 900.0, 1200.0}
    assert advice.next_step == soon[0]
    name = advice.sensor
    least_k = min(step.cautious_half_width_k[name] for step in soon)
    assert soon[0].cautious_half_width_k[name] <= 1.03 * least_k
    # Among them are steps down in load and in speed that are worth while.
    for lighter in (
        [step for step in soon if max(level.load_n for level in step.levels) < 2650.0],
        [step for step in soon if max(level.speed_rpm for level in step.levels) < 5800.0],
    ):
        assert max(step.narrower_by for step in lighter) >= 0.1


def test_the_shortest_step_that_reaches_the_asked_half_width_is_next(
    model: ThermalModel, single_load: Posterior, state: MachineState, advice: Advice
) -> None:
    name = advice.sensor
    now_k = advice.now[name].half_width_k
    widths = {
        duration_s: min(
            step.cautious_half_width_k[name]
            for step in advice.steps
            if step.duration_s == duration_s
        )
        for duration_s in (600.0, 1200.0)
    }
    assert widths[1200.0] < widths[600.0] < now_k
    for asked_k, duration_s in ((1.01 * widths[600.0], 600.0), (1.01 * widths[1200.0], 1200.0)):
        found = advise(model, single_load, state, TARGET, REGION, WARNING_C, half_width_k=asked_k)
        assert not found.reached
        assert found.next_step is not None
        assert found.next_step.duration_s <= duration_s
        assert found.next_step.cautious_half_width_k[name] <= 1.03 * asked_k
    for asked_k, reached in ((0.99 * now_k, False), (now_k, True)):
        found = advise(model, single_load, state, TARGET, REGION, WARNING_C, half_width_k=asked_k)
        assert found.reached is reached
        assert (found.next_step is None) is reached
    with pytest.raises(ValueError, match="half_width_k is 0"):
        advise(model, single_load, state, TARGET, REGION, WARNING_C, half_width_k=0.0)


def test_beyond_the_speeds_that_were_run_the_promise_keeps_the_tail_of_the_speed_law(
    model: ThermalModel, state: MachineState
) -> None:
    """The linear prediction alone would have ten minutes at a slower speed narrow it."""
    slow = trained_on(model, (OperatingSpan(2400.0, 2650.0, 3600.0, 0.0),))
    target, region = Step(6200.0, 2650.0, 7200.0), LowRiskRegion(2450.0, 3400.0)
    design = Design(model, slow, state, SENSORS, SENSORS, target)
    found = advise(model, slow, state, target, region, WARNING_C)
    for step in found.steps:
        linear_k = 1.96 * design.after(step.levels).shifted_std_k[0]
        promised_k = step.cautious_half_width_k["t_inner_ring_c"]
        now_k = found.now["t_inner_ring_c"].half_width_k
        assert promised_k == pytest.approx(now_k) or promised_k > 1.5 * linear_k


# ---------------------------------------------------------------------------- what is refused
def test_speed_and_load_are_never_changed_at_once(advice: Advice) -> None:
    refused = [step for step in advice.excluded if "at once" in step.reason]
    assert refused
    for step in refused:
        assert step.levels[0].speed_rpm < 0.9 * 5800.0
        assert abs(step.levels[0].load_n - 2650.0) > 0.08 * 2650.0
        assert "5801 rpm, 2648 N" in step.reason
    for ranked in advice.steps:
        assert why_not(ranked.levels, TRAINED) is None


@pytest.mark.parametrize(
    ("levels", "allowed"),
    [
        ([(5800, 3400)], True),
        ([(4300, 2650)], True),
        ([(4300, 3400)], False),
        ([(4300, 2650), (4300, 3400)], True),
        ([(4300, 3400), (4300, 2650)], False),
        ([(5800, 2000), (4300, 2650)], False),
        ([(5800, 2000), (5800, 3400)], True),
    ],
)
def test_one_thing_at_a_time(levels: list[tuple[float, float]], allowed: bool) -> None:
    step = [Step(speed, load, 2700.0) for speed, load in levels]
    assert (why_not(step, TRAINED) is None) == allowed


def test_a_step_that_may_pass_a_warning_is_refused(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    inner = float(model.sensor_row("t_inner_ring_c") @ state.temperatures_c)
    limits = {"t_inner_ring_c": inner + 2.5}
    found = advise(model, single_load, state, TARGET, REGION, limits)
    hot = [step for step in found.excluded if "too hot" in step.reason]
    assert any(level.load_n == 3400.0 for step in hot for level in step.levels)
    assert all(step.peak_c["t_inner_ring_c"] < inner + 2.5 for step in found.steps)
    assert "its limit is" in hot[0].reason


def test_a_hot_machine_may_cool_down_on_the_step(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    inner = float(model.sensor_row("t_inner_ring_c") @ state.temperatures_c)
    limits = {"t_inner_ring_c": inner + 2.5}
    hot = replace(state, temperatures_c=state.temperatures_c + 15.0)
    found, from_hot = (
        advise(model, single_load, start, TARGET, REGION, limits) for start in (state, hot)
    )
    cool = {step.levels for step in found.steps if step.levels[-1].load_n < 2000.0}
    # two hours at a light load are enough to cool down, and no reason to refuse the step
    lasting = {levels for levels in cool if sum(level.duration_s for level in levels) >= 7200.0}
    assert lasting
    assert lasting <= {s.levels for s in from_hot.steps}
    assert all(step.peak_c["t_inner_ring_c"] < inner + 2.5 for step in from_hot.steps)
    refused = [s for s in from_hot.excluded if "too hot" in s.reason]
    assert any(level.load_n == 3400.0 for step in refused for level in step.levels)


def test_candidates_stay_inside_the_region() -> None:
    for region in (REGION, LowRiskRegion(4300.0, 3000.0), LowRiskRegion(1000.0, 500.0)):
        steps = list(candidates(TRAINED, TARGET, region))
        assert len(set(steps)) == len(steps)
        levels = [level for step in steps for level in step]
        assert max(level.speed_rpm for level in levels) <= region.speed_rpm_max
        assert max(level.load_n for level in levels) <= region.load_n_max
        assert {len(step) for step in steps} == {1, 2}


def test_a_set_point_at_the_edge_of_the_region_is_not_lost_to_noise() -> None:
    edge = (OperatingSpan(5904.0, 3412.0, 21600.0, 0.0),)
    levels = {(step[0].speed_rpm, step[0].load_n) for step in candidates(edge, TARGET, REGION)}
    assert (5800.0, 3400.0) in levels
    assert all(speed <= 5900.0 and load <= 3400.0 for speed, load in levels)


def test_nothing_identified_and_no_machine_are_named(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    with pytest.raises(NothingIdentifiedError, match="identify first"):
        advise(model, prior_posterior(model), state, TARGET, REGION, WARNING_C)
    with pytest.raises(ValueError, match="expected a positive speed"):
        advise(model, single_load, state, Step(0.0, 1.0, 60.0), REGION, WARNING_C)
    other = build_model(bearing=bearing("6016"))
    with pytest.raises(ValueError, match="6016"):
        advise(other, single_load, state, TARGET, REGION, WARNING_C)


# ---------------------------------------------------------------------------- the numbers
def test_the_design_agrees_with_an_identification_of_the_step(
    model: ThermalModel, single_load: Posterior
) -> None:
    """C' from the derivatives that an identification of the step's data would use."""
    cold = MachineState(np.full(13, 22.0), np.zeros((13, 13)), 0.0, 22.0)
    step = (Step(5800.0, 2000.0, 2700.0), Step(5800.0, 3400.0, 2700.0))
    design = Design(model, single_load, cold, SENSORS, SENSORS, TARGET)
    std_k, shifted_k, _, _ = design.after(step)

    information = information_of(model, rows_of(model, step))
    p = model.parameters.size
    # the step's own priors are not counted twice
    information[:p, :p] += np.linalg.inv(single_load.covariance) - np.eye(p)
    covariance = np.linalg.inv(information)[:p, :p]

    target = held_profile((TARGET,), 22.0)
    gradient = np.empty((p, 2))
    for k in range(p):
        ends = []
        for z in (0.01, -0.01):
            moved = np.zeros(p)
            moved[k] = z
            values = model.parameters.values_from_z(moved)
            end = simulate(model, values, target, np.full(13, 22.0)).temperatures_c[-1]
            ends.append(model.sensor_matrix(SENSORS) @ end)
        gradient[k] = (ends[0] - ends[1]) / 0.02
    rise_c = model.sensor_matrix(SENSORS) @ (
        simulate(model, model.parameters.centre, target, np.full(13, 22.0)).temperatures_c[-1] - 22
    )
    by_load_k = LOAD_DEVIATION * np.log(5500.0 / 3400.0) * rise_c
    expected = np.sqrt(np.sum(gradient * (covariance @ gradient), axis=0) + 0.25**2 + by_load_k**2)
    # the identification also fits the sensors' lag and a common deviation at the start
    assert std_k == pytest.approx(expected, rel=0.1)
    assert np.all(shifted_k > std_k)
    assert np.all(std_k < design.std_k)


def test_the_forecast_interval_is_that_of_the_ensemble(
    model: ThermalModel, state: MachineState
) -> None:
    """For a narrow posterior the linear prediction and the ensemble agree."""
    known = replace(trained_on(model, TRAINED), covariance=0.05**2 * np.eye(model.parameters.size))
    design = Design(model, known, state, SENSORS, SENSORS, TARGET)
    found = advise(model, known, state, TARGET, REGION, WARNING_C, members=1000)
    for k, name in enumerate(SENSORS):
        assert found.now[name].half_width_k == pytest.approx(1.96 * design.std_k[k], rel=0.1)


def test_longer_and_more_varied_steps_never_teach_less(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    design = Design(model, single_load, state, SENSORS, SENSORS, TARGET)
    short = design.after((Step(5800.0, 3400.0, 1800.0),)).std_k
    long = design.after((Step(5800.0, 3400.0, 5400.0),)).std_k
    assert np.all(long <= short + 1e-9)


def test_the_more_thermometers_the_more_a_step_teaches(
    model: ThermalModel, single_load: Posterior, state: MachineState
) -> None:
    step = (Step(5800.0, 2000.0, 2700.0), Step(5800.0, 3400.0, 2700.0))
    more, both, outer, none = (
        Design(model, single_load, state, SENSORS, measured, TARGET).after(step)[0]
        for measured in (
            (*SENSORS, "t_node_7_c", "speed_rpm"),
            SENSORS,
            ("t_outer_ring_c",),
            ("ambient_c",),
        )
    )
    assert more.shape == (2,)
    assert np.all(more < both)
    assert np.all(both < outer)
    assert np.all(outer < none)


def test_a_step_that_cannot_be_simulated_is_refused(
    model: ThermalModel, single_load: Posterior
) -> None:
    burning = MachineState(np.full(13, 2500.0), np.zeros((13, 13)), 0.0, 22.0)
    found = advise(model, single_load, burning, TARGET, REGION, {})
    assert found.steps == ()
    assert not found.worth_while
    assert {step.reason for step in found.excluded if "at once" not in step.reason} == {
        "too hot: thermal runaway of the twin there"
    }
