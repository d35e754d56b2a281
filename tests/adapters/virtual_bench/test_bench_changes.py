"""Machines that change while they run: ageing, faults, and what the truth says about them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from adapters.virtual_bench import (
    BenchParameters,
    BenchProfile,
    MachineChange,
    Scenario,
    Truth,
    find_scenario,
    friction_moment_nmm,
    scenario_profile,
    simulate,
)
from adapters.virtual_bench.controller import BenchController
from adapters.virtual_bench.live import TRUTH_COLUMNS, LiveBench

BENCH = BenchParameters.for_bearing("6311")
HOUR = 3600.0
STEP_S = 20.0
DAY_ROWS = int(24 * HOUR / STEP_S)


def _run(name: str, seed: int = 3) -> tuple[BenchProfile, Truth]:
    profile = scenario_profile(find_scenario(name), BENCH, seed, STEP_S)
    return profile, simulate(profile, BENCH, max_step_s=20.0)


@pytest.fixture(scope="module")
def calm() -> Truth:
    return _run("durability")[1]


def _row(hours: float) -> int:
    return round(hours * HOUR / STEP_S)


def test_a_change_grows_evenly_in_the_logarithm_stays_and_goes_back() -> None:
    change = MachineChange("load", 100.0, 20.0, 4.0, end_s=200.0)
    times = np.array([0.0, 100.0, 110.0, 120.0, 200.0, 210.0, 220.0, 1e6])
    assert change.at(times) == pytest.approx([1.0, 1.0, 2.0, 4.0, 4.0, 2.0, 1.0, 1.0])


def test_days_are_alike_and_low_risk() -> None:
    for name, days in (("durability", 5), ("grease-degradation", 6), ("cooling-loss", 4)):
        scenario = find_scenario(name)
        assert scenario.duration_s == days * 24 * HOUR + 180.0
        assert len(scenario.steps) == 1 + 6 * days
        assert scenario.steps[1:7] == scenario.steps[-6:]
        assert all(step.risk == "low" for step in scenario.steps)
        assert max(step.speed_rpm for step in scenario.steps) <= 4300.0
        assert max(step.load_n for step in scenario.steps) <= 3400.0


def test_durability_runs_in_and_then_ages_slowly(calm: Truth) -> None:
    moment = [
        friction_moment_nmm(
            BENCH,
            speed_rpm=3000.0,
            load_n=2650.0,
            oil_temperature_c=60.0,
            run_in=float(calm.run_in[_row(hours)]),
            oil=float(calm.oil[_row(hours)]),
        )
        for hours in (0.0, 24.0, 120.0)
    ]
    assert moment[1] < 0.93 * moment[0]  # the grease runs in on the first day
    assert 1.01 * moment[1] < moment[2] < 1.04 * moment[1]  # and ages by a few per cent in four
    assert 0.75 < calm.oil[-1] < 0.9
    assert np.all(np.diff(calm.oil) <= 0.0)


def test_grease_degradation_heats_the_bearing_from_its_onset(calm: Truth) -> None:
    profile, sick = _run("grease-degradation")
    onset = _row(54.0)
    assert sick.temperatures_c[:onset] == pytest.approx(calm.temperatures_c[:onset])
    assert sick.oil[-1] == 0.0
    assert profile.condition is not None
    assert profile.condition.oil_loss[[0, -1]] == pytest.approx([5.0, 60.0])
    compared = calm.time_s.size - 1
    hotter = sick.t_inner_ring_c[:compared] - calm.t_inner_ring_c[:compared]
    late = _row(114.0)  # 4200 rpm, 3300 N
    assert hotter[late] > 4.0
    assert sick.power_w[late] > 1.15 * calm.power_w[late]
    after = hotter[onset : _row(118.0)]
    assert np.all(after > -1e-3)
    # the outer ring follows by the share that its place in the heat's path gives it
    outer = sick.t_outer_ring_c[:compared] - calm.t_outer_ring_c[:compared]
    assert 0.3 < outer[late] / hotter[late] < 0.6


def test_cooling_loss_lifts_the_outer_ring_and_lowers_friction(calm: Truth) -> None:
    profile, covered = _run("cooling-loss")
    onset, late = _row(54.0), _row(90.0)
    assert covered.temperatures_c[:onset] == pytest.approx(calm.temperatures_c[:onset])
    assert profile.condition is not None
    assert profile.condition.cooling[[onset - 1, late]] == pytest.approx([1.0, 0.5])
    assert covered.t_outer_ring_c[late] - calm.t_outer_ring_c[late] > 3.0
    # warmer oil, less friction: the rings come closer
    assert covered.power_w[late] < calm.power_w[late]
    difference = covered.t_inner_ring_c - covered.t_outer_ring_c
    assert difference[late] < calm.t_inner_ring_c[late] - calm.t_outer_ring_c[late] - 1.0


def test_half_the_cooling_doubles_what_the_housing_needs_above_ambient() -> None:
    """Radiation and convection together fall: with a closed shaft the rise nearly doubles."""
    closed = replace(BENCH, shaft_scale=0.0, run_in_state=0.0)
    scenario = find_scenario("cooling-loss")
    time_s = np.arange(0.0, 200 * HOUR, HOUR)
    same = np.ones_like(time_s)
    rises = []
    for cooling in (1.0, 0.5):
        whole = replace(
            scenario, changes=(MachineChange("cooling", -2.0, 1.0, cooling),), oil_loss=0.0
        )
        condition = BenchController(whole, closed, 0).condition(time_s)
        profile = BenchProfile(time_s, 3000.0 * same, 2650.0 * same, 22.0 * same, condition)
        rises.append(simulate(profile, closed, max_step_s=60.0).paper_nodes_c[-1, 0] - 22.0)
    # friction falls a little and the film of a warmer surface is better
    assert 1.4 < rises[1] / rises[0] < 1.9


def test_overload_is_on_the_machine_but_not_in_the_plan() -> None:
    controller = BenchController(find_scenario("overload"), BENCH, seed=1)
    minutes = 60.0 * np.array([140.0, 170.0, 220.0])
    _, load = controller.true_point(minutes)
    assert load == pytest.approx([2650.0, 5300.0, 2650.0], abs=45.0)
    assert [controller.state(time_s).load_setpoint_n for time_s in minutes] == [2650.0] * 3
    live = LiveBench(find_scenario("overload"), seed=1, parameters=BENCH)
    live.advance(170.0 * 60.0)
    reading = live.load_n()
    assert reading is not None
    assert reading == pytest.approx(5300.0, abs=60.0)  # the load cell sees it
    rows = np.array(live.take_truth())
    column = TRUTH_COLUMNS.index("t_inner_ring_c")
    assert rows[170 * 6, column] - rows[150 * 6, column] > 5.0


def test_live_bench_and_offline_simulation_of_a_change_are_one() -> None:
    scenario = Scenario(
        "short",
        "",
        "6311",
        find_scenario("overload").steps,
        changes=(
            MachineChange("oil loss", 600.0, 60.0, 2000.0),
            MachineChange("cooling", 900.0, 300.0, 0.5),
            MachineChange("load", 1200.0, 60.0, 1.5),
        ),
        oil_loss=5.0,
        ambient_daily_k=1.0,
    )
    live = LiveBench(scenario, seed=7, parameters=BENCH)
    live.advance(1800.0)
    rows = np.array(live.take_truth())
    profile = scenario_profile(scenario, BENCH, 7)
    truth = simulate(profile, BENCH)
    for name, values in (
        ("t_inner_ring_c", truth.t_inner_ring_c),
        ("oil", truth.oil),
        ("run_in", truth.run_in),
        ("friction_w", truth.power_w),
    ):
        assert rows[:, TRUTH_COLUMNS.index(name)] == pytest.approx(values[0:1801:10], rel=1e-12)
    assert rows[-1, TRUTH_COLUMNS.index("cooling")] == pytest.approx(0.5)
    assert rows[-1, TRUTH_COLUMNS.index("oil_loss")] == pytest.approx(10_000.0)
    assert rows[-1, TRUTH_COLUMNS.index("load_setpoint_n")] == 2650.0
    assert truth.oil[1800] < 0.9


def test_runs_can_be_repeated_and_differ_by_seed() -> None:
    first, again, other = (
        scenario_profile(find_scenario("durability"), BENCH, seed, 600.0) for seed in (1, 1, 2)
    )
    assert np.array_equal(first.ambient_c, again.ambient_c)
    assert np.array_equal(first.speed_rpm, other.speed_rpm)
    assert np.abs(first.ambient_c - other.ambient_c).max() > 0.3
    assert 2.0 < np.ptp(first.ambient_c) < 5.0  # the course of a day


def test_other_scenarios_leave_the_machine_as_it_is() -> None:
    for name in ("staircase", "load-steps", "rapid-acceleration", "sensor-break", "demo"):
        condition = scenario_profile(find_scenario(name), BENCH, 1, 60.0).condition
        assert condition is not None
        assert not condition.oil_loss.any()
        assert np.all(condition.cooling == 1.0)


def test_oil_is_lost_faster_when_hot_and_not_at_rest() -> None:
    time_s = np.arange(0.0, 40 * HOUR, HOUR)
    same = np.ones_like(time_s)
    lost = []
    for speed_rpm, ambient_c in ((0.0, 25.0), (3000.0, 25.0), (3000.0, 40.0)):
        aged = replace(find_scenario("durability"), oil_loss=10.0)
        profile = BenchProfile(
            time_s,
            speed_rpm * same,
            2650.0 * same,
            ambient_c * same,
            BenchController(aged, BENCH, 0).condition(time_s),
        )
        lost.append(1.0 - simulate(profile, BENCH, max_step_s=60.0).oil[-1])
    assert lost[0] == 0.0
    # 15 K of ambient are somewhat less than 15 K of grease: warm oil makes less heat
    assert 1.5 < lost[2] / lost[1] < 2.0


@pytest.mark.parametrize(
    ("oil", "ratio", "tolerance"),
    [(1.0, 1.0, 1e-12), (0.7, 1.045, 0.015), (0.4, 1.09, 0.02), (0.0, 1.3, 0.05)],
)
def test_friction_of_a_grease_that_loses_oil(oil: float, ratio: float, tolerance: float) -> None:
    def moment(left: float) -> float:
        return friction_moment_nmm(
            BENCH, speed_rpm=3000.0, load_n=2650.0, oil_temperature_c=60.0, oil=left
        )

    assert moment(oil) / moment(1.0) == pytest.approx(ratio, abs=tolerance)


def test_dry_contacts_slide_with_the_friction_of_boundary_lubrication() -> None:
    def sliding(oil: float) -> float:
        """Heavy load and thin oil: hardly anything but sliding is left."""
        thin = replace(
            BENCH, oil_40_mm2_s=8.0, oil_100_mm2_s=2.0, rolling_scale=1e-9, thickening=0.0
        )
        return friction_moment_nmm(
            thin, speed_rpm=9000.0, load_n=2650.0, oil_temperature_c=40.0, oil=oil
        )

    film = math.exp(-2.6e-8 * (9000.0 * 8.0) ** 1.4 * 87.5)
    before = film * 0.12 + (1.0 - film) * 0.05
    assert sliding(0.0) / sliding(1.0) == pytest.approx(0.12 / before, rel=1e-6)
    assert sliding(0.2) / sliding(1.0) == pytest.approx(0.5 * (0.12 / before + 1.0), rel=1e-6)
