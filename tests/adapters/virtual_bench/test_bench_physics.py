import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters, BenchProfile, Truth, simulate
from adapters.virtual_bench.bearings import BEARINGS, ball_stiffness, hertz_contact
from adapters.virtual_bench.contacts import contact_constants, contact_state, ring_displacement
from adapters.virtual_bench.friction import (
    FrictionConstants,
    friction_constants,
    frictional_moment,
    oil_viscosity,
)
from adapters.virtual_bench.kernel import build_model
from adapters.virtual_bench.network import NODE_COUNT, build_network, paper_node_weights


def _hold(speed_rpm: float, load_n: float, hours: float, step_s: float = 60.0) -> BenchProfile:
    time_s = np.arange(0.0, hours * 3600.0 + 1.0, step_s)
    same = np.ones_like(time_s)
    return BenchProfile(time_s, speed_rpm * same, load_n * same, 22.6 * same)


def _steady(parameters: BenchParameters, speed_rpm: float, load_n: float) -> Truth:
    """Run-in bearing after 60 h; long steps are exact enough for a steady state."""
    run_in = replace(parameters, run_in_state=0.0)
    return simulate(_hold(speed_rpm, load_n, 60.0, 3600.0), run_in, max_step_s=20.0)


def _friction(bearing: str, **changes: float) -> tuple[FrictionConstants, BenchParameters]:
    parameters = replace(BenchParameters.for_bearing(bearing), **changes)  # type: ignore[arg-type]
    return friction_constants(BEARINGS[bearing], parameters), parameters


# --- levels ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("load_n", "inner_c", "outer_c", "inner_range", "outer_range"),
    [  # points and ranges that follow from error / percent in table 8 of Wang et al. 2025
        (2650.0, 54.5, 40.0, (48.0, 62.0), (33.0, 47.0)),
        (4000.0, 61.0, 43.0, (57.0, 64.3), (33.0, 54.0)),
        (5500.0, 74.0, 54.5, (71.8, 76.8), (48.0, 62.0)),
    ],
)
def test_6016_reaches_the_levels_hidden_in_the_papers_table_8(
    load_n: float,
    inner_c: float,
    outer_c: float,
    inner_range: tuple[float, float],
    outer_range: tuple[float, float],
) -> None:
    truth = _steady(BenchParameters.for_bearing("6016"), 5800.0, load_n)
    inner, outer = truth.t_inner_ring_c[-1], truth.t_outer_ring_c[-1]
    assert inner == pytest.approx(inner_c, abs=4.0)
    assert outer == pytest.approx(outer_c, abs=4.0)
    assert inner_range[0] <= inner <= inner_range[1]
    assert outer_range[0] <= outer <= outer_range[1]


def test_6016_load_step_raises_both_rings_like_the_paper() -> None:
    bench = BenchParameters.for_bearing("6016")
    light, heavy = _steady(bench, 5800.0, 2650.0), _steady(bench, 5800.0, 5500.0)
    rise_inner = heavy.t_inner_ring_c[-1] - light.t_inner_ring_c[-1]
    rise_outer = heavy.t_outer_ring_c[-1] - light.t_outer_ring_c[-1]
    assert rise_inner == pytest.approx(20.0, abs=2.0)
    assert rise_outer == pytest.approx(15.0, abs=4.0)


@pytest.mark.parametrize(
    ("load_n", "inner_c", "outer_c"),
    [(2650.0, 59.0, 40.0), (4000.0, 69.0, 45.0), (5500.0, 80.0, 50.0)],
)
def test_6311_levels(load_n: float, inner_c: float, outer_c: float) -> None:
    truth = _steady(BenchParameters.for_bearing("6311"), 6000.0, load_n)
    assert truth.t_inner_ring_c[-1] == pytest.approx(inner_c, abs=1.5)
    assert truth.t_outer_ring_c[-1] == pytest.approx(outer_c, abs=1.5)


def test_default_bench_does_not_run_away_at_the_highest_point() -> None:
    truth = simulate(_hold(6200.0, 5500.0, 40.0), BenchParameters.for_bearing("6311"))
    inner = truth.t_inner_ring_c
    assert inner.max() < 85.0
    assert abs(inner[-1] - inner[-120]) < 0.05  # settled
    assert truth.preload.max() < 1.3


def test_tight_bearing_runs_away_and_stays_finite() -> None:
    tight = replace(BenchParameters.for_bearing("6311"), clearance_um=15.0, preload_share=1.0)
    truth = simulate(_hold(6200.0, 5500.0, 4.0), tight)
    assert truth.t_inner_ring_c[-1] > 110.0
    assert np.isfinite(truth.temperatures_c).all()


def test_few_random_benches_run_away_and_all_differ() -> None:
    ends = []
    for seed in range(30):
        truth = _steady(BenchParameters.random(seed), 6200.0, 5500.0)
        assert np.isfinite(truth.temperatures_c).all()
        ends.append(truth.t_inner_ring_c[-1])
    assert sum(end > 110.0 for end in ends) <= 3
    assert len({round(float(end), 3) for end in ends}) == 30
    assert BenchParameters.random(5) == BenchParameters.random(5)


# --- friction ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed_rpm", "oil_c", "power_w"),
    [(1500, 35, 28.5), (2400, 45, 43.4), (4200, 55, 72.4), (4900, 60, 82.2), (6200, 70, 98.8)],
)
def test_friction_follows_the_catalogue_where_it_is_valid(
    speed_rpm: float, oil_c: float, power_w: float
) -> None:
    # worked by hand from the SKF catalogue for 6311, 2650 N, oil 100/10.5 mm2/s
    constants, _ = _friction(
        "6311", oil_40_mm2_s=100.0, friction_scale=1.0, replenishment_viscosity_mm2_s=1e6
    )
    viscosity = oil_viscosity(oil_c, constants.walther_a, constants.walther_b)
    moment = sum(frictional_moment(float(speed_rpm), 2650.0, viscosity, constants))
    assert moment * speed_rpm * math.pi / 30.0 == pytest.approx(power_w, abs=0.15)


def test_oil_passes_through_both_data_sheet_points() -> None:
    constants, parameters = _friction("6311")
    for oil_c, expected in ((40.0, parameters.oil_40_mm2_s), (100.0, parameters.oil_100_mm2_s)):
        found = oil_viscosity(oil_c, constants.walther_a, constants.walther_b)
        assert found == pytest.approx(expected, rel=1e-9)


def _powers(constants: FrictionConstants, speed_rpm: float, load_n: float) -> list[float]:
    return [
        sum(
            frictional_moment(
                speed_rpm,
                load_n,
                oil_viscosity(float(oil_c), constants.walther_a, constants.walther_b),
                constants,
            )
        )
        for oil_c in range(10, 96, 3)
    ]


def test_friction_falls_with_temperature_at_all_operating_speeds() -> None:
    # slower and heavily loaded, mixed friction rises again when hot, as it should
    for bearing, speed, load in itertools.product(
        BEARINGS, (1500.0, 4200.0, 6200.0), (1000.0, 2650.0, 5500.0)
    ):
        constants, _ = _friction(bearing)
        powers = _powers(constants, speed, load)
        assert all(later < earlier for earlier, later in itertools.pairwise(powers))


def test_catalogue_form_without_the_cap_is_a_trap() -> None:
    constants, _ = _friction("6016", replenishment_viscosity_mm2_s=1e6)
    powers = _powers(constants, 5800.0, 2650.0)
    assert powers[0] < 0.5 * max(powers)  # a cold bearing as if it ran dry


@pytest.mark.parametrize("bearing", sorted(BEARINGS))
def test_cold_start_has_falling_friction_power_and_gets_hot(bearing: str) -> None:
    truth = simulate(_hold(5800.0, 2650.0, 12.0), BenchParameters.for_bearing(bearing))
    power = truth.power_w[1:]
    assert np.diff(power).max() <= 1e-6
    assert power[0] > 1.2 * power[-1]
    assert truth.t_inner_ring_c[-1] > 50.0


def test_running_in_lowers_friction_with_revolutions() -> None:
    fresh = replace(BenchParameters.for_bearing("6311"), run_in_state=1.0)
    truth = simulate(_hold(5600.0, 2650.0, 24.0), fresh)
    peak = int(truth.t_inner_ring_c.argmax())
    assert 30 < peak < 300  # minutes
    assert truth.t_inner_ring_c[peak] - truth.t_inner_ring_c[-1] > 4.0


# --- contacts ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bearing", "inner", "load_n", "semi_major_mm", "semi_minor_mm"),
    [  # Brewe-Hamrock approximations, good to about 3 %
        ("6311", True, 1656.0, 2.14, 0.227),
        ("6311", False, 1656.0, 2.05, 0.294),
        ("6016", True, 946.0, 1.53, 0.175),
        ("6016", False, 946.0, 1.49, 0.202),
    ],
)
def test_hertz_contact_sizes(
    bearing: str, inner: bool, load_n: float, semi_major_mm: float, semi_minor_mm: float
) -> None:
    contact = hertz_contact(BEARINGS[bearing], inner=inner)
    growth = 1e3 * load_n ** (1.0 / 3.0)
    assert contact.semi_major_m * growth == pytest.approx(semi_major_mm, rel=0.03)
    assert contact.semi_minor_m * growth == pytest.approx(semi_minor_mm, rel=0.03)


def test_ball_stiffness() -> None:
    assert ball_stiffness(BEARINGS["6311"]) == pytest.approx(1.47e10, rel=0.03)
    assert ball_stiffness(BEARINGS["6016"]) == pytest.approx(1.19e10, rel=0.03)


def test_load_distribution_carries_the_load() -> None:
    stiffness, count = 1.49e10, 8
    for clearance in (60e-6, 0.0, -10e-6):
        delta = ring_displacement(2650.0, clearance, stiffness, count)
        angles = 2.0 * np.pi * np.arange(count) / count
        forces = stiffness * np.maximum(delta * np.cos(angles) - clearance / 2.0, 0.0) ** 1.5
        assert (forces * np.cos(angles)).sum() == pytest.approx(2650.0, rel=1e-5)
        if clearance == 0.0:  # Stribeck: Qmax is near 5 F / Z
            assert forces.max() == pytest.approx(5.0 * 2650.0 / 8.0, rel=0.15)


def test_hot_inner_ring_adds_preload_and_speed_adds_conductance() -> None:
    bearing = BEARINGS["6311"]
    constants = contact_constants(bearing, BenchParameters.for_bearing("6311"))
    cold, inner_slow, _ = contact_state(1500.0, 2650.0, 20.0, 20.0, 20.0, constants)
    hot, inner_fast, _ = contact_state(6000.0, 2650.0, 80.0, 85.0, 50.0, constants)
    assert cold == pytest.approx(1.0)
    assert hot > 1.05
    assert inner_fast > 1.7 * inner_slow
    assert contact_state(0.0, 2650.0, 20.0, 20.0, 20.0, constants)[1] > 0.0


# --- network and integration -------------------------------------------------------------------


def test_network_is_symmetric_connected_and_positive() -> None:
    for name, bearing in BEARINGS.items():
        model = build_model(BenchParameters.for_bearing(name))
        matrix = model.network.conductance
        assert (matrix == matrix.T).all()
        assert (matrix >= 0.0).all()
        assert (model.network.capacity > 1.0).all()
        weights = paper_node_weights(build_network(bearing, BenchParameters.for_bearing(name)))
        assert weights.sum(axis=1) == pytest.approx(np.ones(13))
        assert ((weights > 0).sum(axis=0) >= 1).all()  # every node belongs to one of the paper's


def test_heat_is_conserved_when_nothing_leaves() -> None:
    closed = replace(
        BenchParameters.for_bearing("6311"), shaft_scale=0.0, outside_scale=0.0, emissivity=0.0
    )
    truth = simulate(_hold(3000.0, 2650.0, 0.5, 1.0), closed)
    capacity = build_model(closed).network.capacity
    stored = float(capacity @ (truth.temperatures_c[-1] - truth.temperatures_c[0]))
    assert stored == pytest.approx(float(truth.power_w[1:].sum()), rel=1e-9)


def test_bench_at_rest_stays_at_ambient() -> None:
    truth = simulate(_hold(0.0, 2650.0, 1.0), BenchParameters.for_bearing("6311"))
    assert truth.temperatures_c == pytest.approx(np.full((61, NODE_COUNT), 22.6), abs=1e-9)


def test_step_of_one_second_is_fine_enough() -> None:
    bench, profile = BenchParameters.for_bearing("6311"), _hold(6200.0, 5500.0, 1.0, 10.0)
    coarse, fine = simulate(profile, bench), simulate(profile, bench, max_step_s=0.05)
    assert np.abs(coarse.t_inner_ring_c - fine.t_inner_ring_c).max() < 0.03
    assert np.abs(coarse.temperatures_c - fine.temperatures_c).max() < 0.2


def test_unknown_bearing_is_named() -> None:
    with pytest.raises(ValueError, match=r"bearing '6205'.*6311, 6016"):
        BenchParameters.for_bearing("6205")
