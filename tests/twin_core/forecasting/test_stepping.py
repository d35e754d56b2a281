"""The way to a high-risk point: step sizes, what to look at, where it ends."""

from dataclasses import replace

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.forecasting.envelope import envelope
from twin_core.forecasting.stepping import (
    LARGEST_RATIO,
    levels_towards,
    stepping_plan,
)
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.profiles import Step

ALARM_C = {"t_inner_ring_c": 105.0, "t_outer_ring_c": 95.0}
STATE = MachineState(np.full(13, 40.0), 0.2**2 * np.eye(13), 1.0e7, 22.0)


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


@pytest.fixture(scope="module")
def trained(model: ThermalModel) -> Posterior:
    prior = prior_posterior(model)
    points = (
        OperatingSpan(1500.0, 3300.0, 3600.0, 0.0),
        OperatingSpan(4200.0, 2000.0, 3600.0, 3600.0),
        OperatingSpan(4200.0, 3000.0, 3600.0, 7200.0),
    )
    z = prior.z.copy()
    z[model.parameters.index("M0")] = 1.5
    return replace(
        prior,
        z=z,
        covariance=0.3**2 * np.eye(z.size),
        trained=TrainedRange(points, 180, True, 0.0),
    )


def test_at_a_known_speed_only_the_load_moves_in_small_steps(trained: Posterior) -> None:
    way = levels_towards(trained, 4200.0, 5500.0)
    assert way[-1] == (4200.0, 5500.0)
    assert {speed for speed, _ in way} == {4200.0}
    loads = [3000.0, *(load for _, load in way)]
    ratios = np.divide(loads[1:], loads[:-1])
    assert np.all(ratios <= LARGEST_RATIO + 1e-9)
    assert np.all(ratios > 1.0)
    assert ratios == pytest.approx(ratios[0])


def test_an_unknown_speed_is_reached_before_the_load_moves(trained: Posterior) -> None:
    way = levels_towards(trained, 6200.0, 5500.0)
    assert way[-1] == (6200.0, 5500.0)
    previous = (4200.0, 3000.0)
    for level in way:
        assert (level[0] == previous[0]) != (level[1] == previous[1])
        assert 1.0 < level[0] / previous[0] * level[1] / previous[1] <= LARGEST_RATIO + 1e-9
        previous = level
    speeds = [speed for speed, _ in way]
    assert speeds == sorted(speeds)


def test_a_lighter_point_is_reached_in_one_go(trained: Posterior) -> None:
    assert levels_towards(trained, 4200.0, 1000.0) == [(4200.0, 1000.0)]
    assert levels_towards(trained, 4200.0, 3000.0) == [(4200.0, 3000.0)]


def test_edges_are_those_of_the_envelope(model: ThermalModel, trained: Posterior) -> None:
    (step,) = stepping_plan(model, trained, STATE, Step(4200.0, 3600.0, 7200.0), ALARM_C)
    found = envelope(
        model,
        trained,
        STATE,
        [2000.0, 4200.0],
        [1000.0, 3600.0],
        {},
    )
    for name in ALARM_C:
        assert step.expected_c[name] == pytest.approx(found.steady_c[name][1, 1, 1])
        assert step.stop_above_c[name] == pytest.approx(found.steady_c[name][2, 1, 1])
        assert step.expected_c[name] < step.stop_above_c[name]
    assert step.allowed
    assert step.reason == ""
    assert step.runaway_not_excluded == found.runaway_not_excluded[1, 1]


def test_the_way_ends_before_the_first_level_that_may_pass_the_limit(
    model: ThermalModel, trained: Posterior
) -> None:
    target = Step(4200.0, 7000.0, 7200.0)
    free = stepping_plan(model, trained, STATE, target, {})
    assert all(step.allowed for step in free)
    edges = [step.stop_above_c["t_inner_ring_c"] for step in free]
    assert edges == sorted(edges)
    limit_c = 0.5 * (edges[1] + edges[2])
    barred = stepping_plan(model, trained, STATE, target, {"t_inner_ring_c": limit_c})
    assert [step.allowed for step in barred] == [index < 2 for index in range(len(edges))]
    assert f"its limit {limit_c:g} °C" in barred[2].reason
    assert f"{barred[2].load_n:.0f} N" in barred[-1].reason
    assert free[-1].runaway_not_excluded
