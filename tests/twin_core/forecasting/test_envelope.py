"""The envelope against long simulations, its limits, and machines that run away."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from twin_core.bearings import bearing
from twin_core.forecasting import forecast
from twin_core.forecasting.envelope import Envelope, envelope
from twin_core.identification.posterior import Posterior, prior_posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.simulation import OperatingProfile, steady_state

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
LIMITS = {"t_inner_ring_c": (90.0, 105.0), "t_outer_ring_c": (80.0,)}
SPEEDS = np.array([500.0, 3000.0, 5000.0, 7000.0])
LOADS = np.array([300.0, 2650.0, 6000.0])
RUN_IN = 1.0e7
AMBIENT_C = 24.0
HOURS = 3600.0

COLD = MachineState(np.full(13, AMBIENT_C), np.zeros((13, 13)), RUN_IN, AMBIENT_C)


@pytest.fixture(scope="module")
def prior(model: ThermalModel) -> Posterior:
    return prior_posterior(model)


@pytest.fixture(scope="module")
def warm_machine(model: ThermalModel, prior: Posterior) -> Posterior:
    """A machine with much friction, known fairly well: it passes its limits within the grid."""
    z = prior.z.copy()
    z[model.parameters.index("M0")] = 2.0
    return replace(prior, z=z, covariance=0.3**2 * np.eye(z.size), sensor_lag_s=0.0)


def certain(posterior: Posterior, **z: float) -> Posterior:
    """Parameters known exactly."""
    return replace(posterior, covariance=np.zeros_like(posterior.covariance), **z)


def from_cold(model: ThermalModel, posterior: Posterior, **changes: object) -> Envelope:
    arguments: dict = {"state": COLD, "speed_rpm": SPEEDS, "load_n": LOADS, "limits": LIMITS}
    return envelope(model, posterior, **arguments | changes)


def test_steady_temperatures_are_those_of_the_model(model: ThermalModel, prior: Posterior) -> None:
    found = from_cold(model, certain(prior))
    for row, load_n in enumerate(LOADS):
        for column, speed_rpm in enumerate(SPEEDS):
            revolutions = RUN_IN + speed_rpm * 8 * 60
            steady = steady_state(
                model, model.parameters.centre, speed_rpm, load_n, AMBIENT_C, revolutions
            )
            for name in SENSORS:
                quantiles = found.steady_c[name][:, row, column]
                # what is left is the sensors' spread, symmetric about the truth
                assert quantiles[1] == pytest.approx(model.sensor_row(name) @ steady, abs=0.03)
                assert 0.4 < quantiles[2] - quantiles[1] < 0.75
                assert 0.4 < quantiles[1] - quantiles[0] < 0.75


@pytest.mark.parametrize("disturbance_w", [0.0, 40.0])
def test_times_are_those_of_a_simulation_minute_by_minute(
    model: ThermalModel, warm_machine: Posterior, disturbance_w: float
) -> None:
    known = certain(warm_machine)
    values = model.parameters.values_from_z(known.z)
    warm = steady_state(model, values, 2000.0, 2650.0, AMBIENT_C, RUN_IN)
    heat = np.zeros(13)
    heat[6] = disturbance_w
    state = replace(COLD, temperatures_c=warm, heat_disturbance_w=heat)
    found = from_cold(model, known, state=state)
    time_s = np.arange(0.0, 8 * HOURS + 1.0, 60.0)
    crossed = 0
    for row, load_n in enumerate(LOADS):
        for column, speed_rpm in enumerate(SPEEDS):
            profile = OperatingProfile(
                time_s,
                np.full(time_s.size, speed_rpm),
                np.full(time_s.size, load_n),
                np.full(time_s.size, AMBIENT_C),
            )
            made = forecast(model, known, state, profile)
            for name in SENSORS:
                for limit in found.limits[name]:
                    path = made.quantile(name)[2]
                    if abs(path.max() - limit.limit_c) < 1.0:
                        continue  # a touch decides
                    over = path >= limit.limit_c
                    time = limit.median_s[row, column]
                    assert np.isfinite(time) == over.any(), (name, speed_rpm, load_n)
                    if over.any():
                        crossed += 1
                        slope = np.gradient(path, 60.0)[np.argmax(over)]
                        expected = time_s[np.argmax(over)]
                        assert time == pytest.approx(expected, abs=60.0 + 0.15 / slope)
    assert crossed >= 3


def test_intervals_and_probabilities_agree_with_forecasts(
    model: ThermalModel, warm_machine: Posterior
) -> None:
    """Steady band, probability and times, against the forecast's own."""
    state = replace(COLD, temperatures_c=np.full(13, 40.0), covariance=np.eye(13))
    found = from_cold(model, warm_machine, state=state, members=400)
    time_s = np.arange(0.0, 8 * HOURS + 1.0, 120.0)
    column, row = 2, 2
    profile = OperatingProfile(
        time_s,
        np.full(time_s.size, SPEEDS[column]),
        np.full(time_s.size, LOADS[row]),
        np.full(time_s.size, AMBIENT_C),
    )
    made = forecast(model, warm_machine, state, profile, members=400, seed=7)
    for name in SENSORS:
        low, _, middle, _, high = made.quantile(name)[:, -1]
        assert_allclose(found.steady_c[name][:, row, column], (low, middle, high), atol=3.0)
        for limit in found.limits[name]:
            expected = made.exceedance(name, limit.limit_c)
            # the forecast's slow deviation has 480 chances to pass the limit, the map's one
            assert limit.probability[row, column] == pytest.approx(expected.probability, abs=0.08)
            if expected.median_s is not None and expected.probability > 0.6:
                median = limit.median_s[row, column]
                assert median == pytest.approx(expected.median_s, rel=0.1)
            if expected.earliest_s is not None:
                earliest = limit.earliest_s[row, column]
                assert earliest == pytest.approx(expected.earliest_s, rel=0.2)


def test_more_load_is_never_safer(model: ThermalModel, warm_machine: Posterior) -> None:
    found = from_cold(model, warm_machine)
    for maps in found.limits.values():
        for limit in maps:
            assert np.all(np.diff(limit.probability[1:], axis=0) >= 0.0)
            assert np.all(limit.earliest_s <= limit.median_s)
            assert np.all((limit.probability >= 0.025) == np.isfinite(limit.earliest_s))
    assert found.limits["t_inner_ring_c"][0].probability.max() > 0.5
    assert found.limits["t_inner_ring_c"][0].probability.min() == 0.0
    inner = found.limits["t_inner_ring_c"]
    assert np.all(inner[0].probability >= inner[1].probability)


def test_a_hot_machine_is_over_its_limit_at_once_but_may_cool(
    model: ThermalModel, prior: Posterior
) -> None:
    found = from_cold(model, certain(prior), state=replace(COLD, temperatures_c=np.full(13, 95.0)))
    inner = found.limits["t_inner_ring_c"][0]
    assert_array_equal(inner.median_s, 0.0)
    assert_array_equal(inner.probability, 1.0)
    assert inner.steady_probability[0, 0] < 1e-9
    assert found.runaway_probability[0, 0] == 0.0


def hot_running(model: ThermalModel, prior: Posterior) -> NDArray[np.float64]:
    """A machine whose friction grows with temperature instead of falling."""
    z = prior.z.copy()
    z[model.parameters.index("M0")] = 1.5
    z[model.parameters.index("q")] = -4.0
    return z


def test_runaway_is_told_and_its_verdict_follows_the_label_rule(
    model: ThermalModel, prior: Posterior
) -> None:
    found = from_cold(model, certain(prior, z=hot_running(model, prior)))
    assert found.runaway_probability[0, 0] == 0.0
    assert not found.runaway_not_excluded[0, 0]
    assert found.runaway_probability[-1, -1] == 1.0
    assert found.runaway_not_excluded[-1, -1]
    hottest = np.maximum(*(found.steady_c[name][2] for name in SENSORS))
    assert_array_equal(
        found.runaway_not_excluded, (hottest > 100.0) | (found.runaway_probability > 0.005)
    )


def test_a_member_without_a_steady_state_counts_as_run_away(
    model: ThermalModel, prior: Posterior
) -> None:
    found = from_cold(
        model, certain(prior), state=replace(COLD, temperatures_c=np.full(13, 2500.0))
    )
    assert_array_equal(found.runaway_probability, 1.0)
    assert_allclose(found.steady_c["t_inner_ring_c"], 500.0, atol=0.5)
    assert_allclose(found.limits["t_inner_ring_c"][0].steady_probability, 1.0)


def test_steady_probability_is_the_share_of_members_without_its_stairs(
    model: ThermalModel, warm_machine: Posterior
) -> None:
    inner = from_cold(model, warm_machine, members=20).limits["t_inner_ring_c"][0]
    assert_allclose(inner.probability * 20, np.round(inner.probability * 20), atol=1e-9)
    shares = inner.steady_probability.ravel() * 20
    assert np.count_nonzero(np.abs(shares - np.round(shares)) > 1e-4) >= 2
    few, many = (from_cold(model, warm_machine, members=members) for members in (80, 800))
    for name in SENSORS:
        for rough, fine in zip(few.limits[name], many.limits[name], strict=True):
            assert_allclose(rough.steady_probability, fine.steady_probability, atol=0.12)
            # eight hours from cold are nearly steady
            assert_allclose(fine.steady_probability, fine.probability, atol=0.06)


def test_same_seed_same_envelope(model: ThermalModel, prior: Posterior) -> None:
    first, second, other = (from_cold(model, prior, seed=seed) for seed in (3, 3, 4))
    assert_array_equal(first.steady_c["t_inner_ring_c"], second.steady_c["t_inner_ring_c"])
    assert np.any(first.steady_c["t_inner_ring_c"] != other.steady_c["t_inner_ring_c"])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"members": 7}, "members is 7, expected an even number"),
        ({"horizon_s": 0.0}, "horizon_s is 0.0"),
        ({"speed_rpm": [2000.0, 1000.0]}, "speed_rpm is"),
        ({"load_n": []}, "load_n is"),
        ({"load_n": [-1.0, 5.0]}, "load_n is"),
        ({"limits": {"t_node_4_c": (90.0,)}}, "no sensor 't_node_4_c'"),
    ],
)
def test_wrong_requests_are_named(
    model: ThermalModel, prior: Posterior, changes: dict, text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        from_cold(model, prior, **changes)


def test_the_posterior_of_another_bearing_is_refused(model: ThermalModel) -> None:
    other = prior_posterior(build_model(bearing=bearing("6016")))
    with pytest.raises(ValueError, match="6016"):
        from_cold(model, other)


def test_running_in_goes_on_while_the_point_is_held(model: ThermalModel, prior: Posterior) -> None:
    state = replace(COLD, revolutions=0.0)
    fresh = envelope(model, certain(prior), state, [3000.0], [2650.0], {}, members=400)
    row = model.sensor_row("t_inner_ring_c")
    begun, ended = (
        row @ steady_state(model, model.parameters.centre, 3000.0, 2650.0, AMBIENT_C, revolutions)
        for revolutions in (0.0, 3000.0 * 8 * 60)
    )
    assert begun > ended + 0.5
    assert fresh.steady_c["t_inner_ring_c"][1, 0, 0] == pytest.approx(ended, abs=0.1)
