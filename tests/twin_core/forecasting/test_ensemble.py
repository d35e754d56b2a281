"""The forecast ensemble: centre, spread, sensors against nodes, limits, failures."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from twin_core.bearings import bearing
from twin_core.forecasting import QUANTILE_LEVELS, Forecast, forecast
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.simulation import OperatingProfile, simulate, steady_state

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
RUN_IN = 1.0e7


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


@pytest.fixture(scope="module")
def known(model: ThermalModel) -> Posterior:
    """A narrow posterior, as after a rich identification."""
    prior = prior_posterior(model)
    return replace(prior, covariance=0.05**2 * np.eye(prior.z.size))


def hold(speed_rpm: float, load_n: float, rows: int = 121) -> OperatingProfile:
    time_s = 60.0 * np.arange(rows, dtype=np.float64)
    return OperatingProfile(
        time_s, np.full(rows, speed_rpm), np.full(rows, load_n), np.full(rows, 22.0)
    )


def now(model: ThermalModel, speed_rpm: float = 1500.0) -> tuple[np.ndarray, np.ndarray]:
    """A steady machine, its nodes known to 0.1 K."""
    values = model.parameters.centre
    return steady_state(model, values, speed_rpm, 2650.0, 22.0, RUN_IN), 0.01 * np.eye(13)


def test_median_follows_the_simulation_at_the_optimum(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    profile = hold(4200.0, 2650.0)
    result = forecast(
        model, known, MachineState(state, covariance, RUN_IN, 22.0), profile, members=400
    )
    centre = simulate(model, model.parameters.centre, profile, state, RUN_IN).temperatures_c
    for name in SENSORS:
        expected = centre @ model.sensor_row(name)
        # what a sensor reads is a quarter of a minute old
        expected[1:] += known.sensor_lag_s / 60.0 * (expected[:-1] - expected[1:])
        assert_allclose(result.quantile(name)[2], expected, atol=0.15)
    for node, name in enumerate(model.node_names):
        assert_allclose(result.quantile(name)[2], centre[:, node], atol=0.25)


def test_fan_starts_at_the_observed_state_and_opens(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    result = forecast(
        model, known, MachineState(state, covariance, RUN_IN, 22.0), hold(4200.0, 2650.0)
    )
    for name in SENSORS:
        quantiles = result.quantile(name)
        assert quantiles[2, 0] == pytest.approx(float(model.sensor_row(name) @ state), abs=0.05)
        width = quantiles[4] - quantiles[0]
        # at the start: state .1, offset .1, white and resolution .06 K
        assert 0.3 < width[0] < 0.9
        assert width[-1] > 2.0 * width[0]
    assert np.all(np.diff(result.quantiles, axis=0) >= 0.0)
    assert result.quantiles.shape == (len(QUANTILE_LEVELS), 121, 15)
    assert result.names == (*SENSORS, *model.node_names)


def test_spread_agrees_with_linear_propagation(model, known) -> None:  # type: ignore[no-untyped-def]
    """s^2 = g' C g + deviation^2 for a narrow posterior and an exactly known state."""
    state, _ = now(model)
    profile = hold(4200.0, 2650.0)
    result = forecast(
        model, known, MachineState(state, np.zeros((13, 13)), RUN_IN, 22.0), profile, members=1000
    )
    row, step = model.sensor_row("t_node_4_c"), 1e-3
    gradient = np.empty(known.z.size)
    for k in range(known.z.size):
        ends = []
        for sign in (step, -step):
            z = np.zeros(known.z.size)
            z[k] = sign
            values = model.parameters.values_from_z(z)
            ends.append(simulate(model, values, profile, state, RUN_IN).temperatures_c[-1] @ row)
        gradient[k] = (ends[0] - ends[1]) / (2.0 * step)
    expected = float(np.sqrt(gradient @ known.covariance @ gradient + 0.25**2))
    quantiles = result.quantile("t_node_4_c")[:, -1]
    assert (quantiles[4] - quantiles[0]) / (2 * 1.96) == pytest.approx(expected, rel=0.12)
    assert (quantiles[3] - quantiles[1]) / (2 * 0.6745) == pytest.approx(expected, rel=0.12)


def test_a_sleeve_lies_anywhere_between_ring_and_shaft(model, known) -> None:  # type: ignore[no-untyped-def]
    """From the first row on: the observer knows of no joint of its own either."""
    state, _ = now(model)
    exact = np.zeros((13, 13))
    result = forecast(
        model,
        known,
        MachineState(state, exact, RUN_IN, 22.0),
        hold(1500.0, 2650.0, 2),
        members=1000,
    )
    for body, shaft in ((10, 5), (11, 12)):
        quantiles = result.quantile(f"t_node_{body}_c")[:, 0]
        differences = state[[4 - 1, shaft - 1]] - state[body - 1]
        expected = 1.96 / 2.0 * np.linalg.norm(differences)
        assert expected > 0.8
        assert (quantiles[4] - quantiles[0]) / 2.0 == pytest.approx(expected, rel=0.15)
        assert quantiles[2] == pytest.approx(state[body - 1], abs=0.1 * expected)


def test_a_load_beyond_the_trained_ones_widens_the_band_by_its_distance(model, known) -> None:  # type: ignore[no-untyped-def]
    """What else a load changes is not in the model: 4 % of the rise per ln(load / trained)."""
    state, covariance = now(model)
    profile = hold(4200.0, 5500.0, 241)
    width = {}
    for load_n in (2650.0, 5500.0):
        point = OperatingSpan(4200.0, load_n, 3600.0, 0.0)
        trained = replace(known, trained=TrainedRange((point,), 60, True, 0.0))
        made = forecast(
            model, trained, MachineState(state, covariance, RUN_IN, 22.0), profile, members=1000
        )
        width[load_n] = made
    for name in SENSORS:
        plain, wide = (width[load_n].quantile(name) for load_n in (5500.0, 2650.0))
        half = [0.5 * (band[4, -1] - band[0, -1]) for band in (plain, wide)]
        rise = plain[2, -1] - 22.0
        by_load = 1.96 * 0.04 * np.log(5500.0 / 2650.0) * rise
        assert half[1] == pytest.approx(np.hypot(half[0], by_load), rel=0.1)
        assert_allclose(wide[:, 0], plain[:, 0], atol=0.02)  # it builds up
        assert_allclose(wide[2], plain[2], atol=0.15)


def test_a_start_widens_the_cooler_ring_by_what_the_hotter_one_may_pass_on(model, known) -> None:  # type: ignore[no-untyped-def]
    cold, exact = np.full(13, 22.0), np.zeros((13, 13))
    running = hold(4200.0, 2650.0, 241)
    starting = replace(running, speed_rpm=np.where(running.time_s < 300.0, 0.0, 4200.0))
    half, median = {}, {}
    for profile in (running, starting):
        result = forecast(
            model, known, MachineState(cold, exact, RUN_IN, 22.0), profile, members=600
        )
        quantiles = np.array([result.quantile(name)[:, -1] for name in SENSORS])
        half[profile is starting] = (quantiles[:, 4] - quantiles[:, 0]) / 2.0
        median[profile is starting] = quantiles[:, 2]
    rise = median[True] - 22.0
    expected = 1.96 * 0.04 * np.array([rise[0], rise.mean()])
    assert rise[1] < 0.6 * rise[0]
    added = np.sqrt(half[True] ** 2 - half[False] ** 2)
    assert_allclose(added, expected, rtol=0.15)


def test_samples_of_the_posterior_are_used_when_there_are_any(model) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    prior = prior_posterior(model)
    tight = replace(prior, samples=np.zeros((10, prior.z.size)))
    profile = hold(6200.0, 5500.0)
    wide_fan = forecast(model, prior, MachineState(state, covariance, RUN_IN, 22.0), profile)
    tight_fan = forecast(model, tight, MachineState(state, covariance, RUN_IN, 22.0), profile)
    width = [
        float(np.ptp(fan.quantile("t_inner_ring_c")[[0, 4], -1])) for fan in (wide_fan, tight_fan)
    ]
    assert width[1] < 2.0 < 10.0 < width[0]


def test_same_seed_same_forecast(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    profile = hold(4200.0, 2650.0, 31)
    first, same, other = (
        forecast(model, known, MachineState(state, covariance, RUN_IN, 22.0), profile, seed=seed)
        for seed in (1, 1, 2)
    )
    assert_array_equal(first.quantiles, same.quantiles)
    assert np.any(first.quantiles != other.quantiles)


def test_a_sensor_is_less_certain_than_the_node_beneath(model, known) -> None:  # type: ignore[no-untyped-def]
    """Offset, noise and resolution belong to the measured value only."""
    state, covariance = now(model)
    result = forecast(
        model, known, MachineState(state, 0.0 * covariance, RUN_IN, 22.0), hold(1500.0, 2650.0, 3)
    )
    start = result.quantiles[4, 0] - result.quantiles[0, 0]
    assert np.all(start[:2] > 0.3)
    between_joints = [2 + 6 - 1, 2 + 10 - 1, 2 + 11 - 1]
    assert_allclose(np.delete(start, between_joints)[2:], 0.0, atol=1e-9)


def test_irregular_rows_and_a_change_on_the_way(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    profile = OperatingProfile(
        np.array([0.0, 7.0, 60.0, 61.5, 1800.0, 7200.0]),
        np.array([1500.0, 1500.0, 1500.0, 6200.0, 6200.0, 6200.0]),
        np.full(6, 2650.0),
        np.full(6, 22.0),
    )
    result = forecast(model, known, MachineState(state, covariance, RUN_IN, 22.0), profile)
    median = result.quantile("t_inner_ring_c")[2]
    assert median[3] == pytest.approx(median[0], abs=0.2)
    assert median[5] > median[4] > median[3] + 5.0


def test_what_no_sensor_shows_is_named_with_its_own_band(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    machine = MachineState(state, covariance, RUN_IN, 22.0)
    fast = forecast(model, known, machine, hold(6200.0, 2650.0)).not_known
    slow = forecast(model, known, machine, hold(700.0, 2650.0)).not_known
    assert {"t_node_3_c", "t_node_6_c", "t_node_7_c", "t_node_12_c"} <= set(fast)
    assert {"t_node_3_c"} <= set(slow) < set(fast)
    assert not {*SENSORS, "t_node_2_c", "t_node_4_c"} & set(fast), "the rings' sensors show these"
    assert all(3.5 < slow[name] < fast[name] for name in slow)
    # Whatever the law of load: a node's own band is not that of the whole forecast.
    vague = forecast(model, prior_posterior(model), machine, hold(6200.0, 2650.0))
    assert vague.quantile("t_node_4_c")[4, -1] - vague.quantile("t_node_4_c")[0, -1] > 20.0
    assert "t_node_4_c" not in vague.not_known
    # Nobody knows where a body that was not followed begins.
    covariance[0, 0] = 2.0**2
    lost = replace(machine, covariance=covariance)
    assert "t_node_1_c" in forecast(model, known, lost, hold(700.0, 2650.0)).not_known
    # Errors four times as wide: what is useful is four times as wide, too.
    errors = replace(
        model.errors,
        **{name: 4.0 * getattr(model.errors, name) for name in ("white_k", "slow_k", "offset_k")},
    )
    wide = forecast(replace(model, errors=errors), known, machine, hold(700.0, 2650.0)).not_known
    assert set(wide) < set(slow)


def test_a_runaway_counts_as_over_every_limit_and_is_reported(model) -> None:  # type: ignore[no-untyped-def]
    prior = prior_posterior(model)
    state, covariance = now(model)
    samples = np.zeros((4, prior.z.size))
    # in one of four samples friction is huge and grows with temperature
    index = model.parameters.index
    samples[0, index("M0")] = 4.0
    samples[0, index("q")] = -4.0
    samples[0, index("s")] = 4.0
    spoilt = replace(prior, samples=samples)
    result = forecast(
        model, spoilt, MachineState(state, covariance, RUN_IN, 22.0), hold(6200.0, 5500.0, 241)
    )
    assert result.runaway_probability == pytest.approx(0.25)
    assert "runaway not excluded" in result.labels
    assert result.exceedance("t_inner_ring_c", 129.0).probability == pytest.approx(0.25)
    assert np.all(np.isfinite(result.quantiles))
    assert result.quantile("t_inner_ring_c")[4, -1] > 129.0


def test_members_whose_simulation_fails_are_not_dropped(model) -> None:  # type: ignore[no-untyped-def]
    prior = prior_posterior(model)
    state, _ = now(model)
    spread = np.zeros((13, 13))
    spread[3, 3] = 1e5**2  # an absurdly unsure node: most members start where nothing can follow
    result = forecast(
        model, prior, MachineState(state, spread, RUN_IN, 22.0), hold(1500.0, 2650.0, 5)
    )
    share = result.exceedance("t_outer_ring_c", 450.0).probability
    assert share > 0.5
    assert result.runaway_probability >= share
    assert np.all(np.isfinite(result.quantiles))
    assert np.all(np.isfinite(result.members_c))


def by_hand(paths: list[list[float]]) -> Forecast:
    members = np.array(paths)[:, :, None]
    return Forecast(
        time_s=60.0 * np.arange(members.shape[1]),
        names=("t_inner_ring_c",),
        quantiles=np.zeros((5, members.shape[1], 1)),
        members_c=members,
        sensors=("t_inner_ring_c",),
        runaway_probability=0.0,
        labels=(),
        whole_run_factor=np.ones(members.shape[1:]),
    )


def test_exceedance_by_hand() -> None:
    result = by_hand(
        [[50, 60, 70], [50, 50, 60], [65, 50, 50], [50, 50, 50]],
    )
    found = result.exceedance("t_inner_ring_c", 60.0)
    assert found.probability == 0.75
    assert found.earliest_s == 0.0  # the third member begins over the limit
    assert found.median_s == 60.0
    found = result.exceedance("t_inner_ring_c", 55.0)
    assert found.median_s == 30.0  # half way between 50 at 0 s and 60 at 60 s
    assert result.exceedance("t_inner_ring_c", 66.0).median_s is None
    assert result.exceedance("t_inner_ring_c", 99.0).earliest_s is None


def test_exceedance_within_a_span() -> None:
    result = by_hand([[50, 60, 50, 50, 70], [50, 50, 50, 50, 70]])
    assert result.exceedance("t_inner_ring_c", 65.0, end_s=180.0).probability == 0.0
    assert result.exceedance("t_inner_ring_c", 58.0, start_s=120.0).earliest_s == pytest.approx(
        180.0 + 60.0 * 8 / 20
    )
    assert result.exceedance("t_inner_ring_c", 58.0, end_s=60.0).probability == 0.5
    with pytest.raises(ValueError, match="no row"):
        result.exceedance("t_inner_ring_c", 58.0, start_s=1e4)
    with pytest.raises(KeyError, match="t_inner_ring_c"):
        result.exceedance("t_oil_c", 58.0)


def test_senseless_orders_are_refused(model, known) -> None:  # type: ignore[no-untyped-def]
    state, covariance = now(model)
    with pytest.raises(ValueError, match="even number"):
        forecast(
            model,
            known,
            MachineState(state, covariance, 0.0, 22.0),
            hold(1500.0, 2650.0),
            members=11,
        )
    with pytest.raises(ValueError, match="6016"):
        forecast(
            model,
            replace(known, bearing="6016"),
            MachineState(state, covariance, 0.0, 22.0),
            hold(1500.0, 2650.0),
        )
