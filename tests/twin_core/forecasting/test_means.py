"""Mean forecasts of many machines in one call."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from twin_core.bearings import bearing
from twin_core.forecasting import forecast
from twin_core.forecasting.means import MeanStart, mean_forecasts, start_of
from twin_core.identification.posterior import prior_posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.profiles import Point
from twin_core.simulation import (
    OperatingProfile,
    OperatingProfiles,
    hold_operating_point,
    simulate,
    simulate_batch,
)

MACHINES = 6
LAGS_S = np.array([0.0, 10.0, 30.0, 60.0, 75.0, 200.0])


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


@pytest.fixture(scope="module")
def values(model: ThermalModel) -> np.ndarray:
    """Every machine has parameters of its own."""
    z = np.random.default_rng(3).normal(0.0, 0.5, (MACHINES, model.parameters.size))
    return np.array([model.parameters.values_from_z(row) for row in z])


@pytest.fixture(scope="module")
def states(model: ThermalModel) -> list[MachineState]:
    """Warm machines that run at 3000 rpm; one stands, one has not been followed."""
    rng = np.random.default_rng(4)
    points = [Point(3000.0, 2650.0, 22.0)] * MACHINES
    known: list[Point | None] = [*points[:4], Point(0.0, 0.0, 22.0), None]
    return [
        MachineState(
            40.0 + rng.normal(0.0, 5.0, 13),
            0.01 * np.eye(13),
            1e5 * machine,
            22.0,
            heat_disturbance_w=rng.normal(0.0, 3.0, 13),
            operating_point=point,
        )
        for machine, point in enumerate(known)
    ]


def profile(*speeds_rpm: float, minutes: int = 40) -> OperatingProfile:
    """So many minutes at each speed."""
    speed = np.repeat(speeds_rpm, minutes)
    rows = speed.size
    return OperatingProfile(
        60.0 * np.arange(rows), speed, np.full(rows, 2650.0), np.linspace(22.0, 25.0, rows)
    )


AHEAD = [
    profile(3000.0),
    profile(3000.0, 0.0, 3000.0),
    profile(0.0),
    profile(3000.0, 4500.0),
    profile(2000.0),
    profile(2000.0, minutes=3),
]


def alone(
    model: ThermalModel,
    values: np.ndarray,
    state: MachineState,
    ahead: OperatingProfile,
    lag_s: float,
) -> np.ndarray:
    """The path of one machine, composed from simulations of its parts."""
    stands = np.abs(ahead.speed_rpm) < 10.0
    heat_w = state.heat_disturbance_w
    point = state.operating_point
    if point is not None and (abs(point.speed_rpm) < 10.0) != stands[0]:
        heat_w = np.zeros(13)
    change = int(np.argmax(stands != stands[0])) or ahead.size - 1
    first = simulate_batch(
        model,
        values[None],
        ahead.rows(slice(0, change + 1)),
        state.temperatures_c,
        state.revolutions,
        disturbance_w=heat_w,
        disturbance_time_s=DISTURBANCE_TIME_S,
    )[0]
    turned = np.sum(np.abs(ahead.speed_rpm[:change]) * np.diff(ahead.time_s[: change + 1])) / 60.0
    rest = simulate(
        model, values, ahead.rows(slice(change, None)), first[-1], state.revolutions + turned
    )
    nodes = np.concatenate((first, rest.temperatures_c[1:]))
    readings = nodes @ model.sensor_matrix(model.sensor_names).T
    then_s = np.maximum(ahead.time_s - lag_s, 0.0)
    return np.stack([np.interp(then_s, ahead.time_s, column) for column in readings.T], axis=1)


def test_many_are_as_many_simulations_one_at_a_time(
    model: ThermalModel, values: np.ndarray, states: list[MachineState]
) -> None:
    many = mean_forecasts(model, start_of(values, LAGS_S, states), OperatingProfiles.of(AHEAD))
    assert many.names == model.sensor_names
    for k, ahead in enumerate(AHEAD):
        expected = alone(model, values[k], states[k], ahead, LAGS_S[k])
        assert_allclose(many.readings_c[k, : ahead.size], expected, rtol=0.0, atol=1e-9)
        assert np.isnan(many.readings_c[k, ahead.size :]).all()
        one = mean_forecasts(
            model,
            start_of(values[k : k + 1], LAGS_S[k : k + 1], states[k : k + 1]),
            OperatingProfiles.of([ahead]),
        )
        assert_array_equal(one.readings_c[0], many.readings_c[k, : ahead.size])


def test_a_mean_is_the_centre_of_an_ensemble_that_knows_everything(model: ThermalModel) -> None:
    """With nothing left to know, only noise of sensors and slow deviations surround the mean."""
    posterior = prior_posterior(model)
    state = MachineState(np.full(13, 40.0), 1e-12 * np.eye(13), 1e6, 22.0)
    ahead = profile(3000.0, 1000.0)
    lag_s = posterior.sensor_lag_s
    start = start_of(model.parameters.centre[None], [lag_s], [state])
    mean = mean_forecasts(model, start, OperatingProfiles.of([hold_operating_point(ahead)]))
    sure = np.tile(posterior.z, (2, 1))
    made = forecast(model, _only(posterior, sure), state, ahead, members=400)
    centre = np.mean(made.members_c, axis=0)
    assert_allclose(mean.readings_c[0], centre, atol=1e-6)


def _only(posterior, samples):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    return replace(posterior, samples=samples)


@pytest.mark.parametrize(
    "spoil", ["values", "temperatures_c", "revolutions", "sensor_lag_s", "speed", "time", "load"]
)
def test_a_machine_that_is_not_finite_harms_no_other(
    model: ThermalModel, values: np.ndarray, states: list[MachineState], spoil: str
) -> None:
    good = mean_forecasts(model, start_of(values, LAGS_S, states), OperatingProfiles.of(AHEAD))
    start, ahead = start_of(values, LAGS_S, states), OperatingProfiles.of(AHEAD)
    # Copied: the start may share its arrays with those that it was made of.
    start = MeanStart(*(part.copy() for part in start))
    if spoil == "speed":
        ahead.speed_rpm[2, 3] = np.nan
    elif spoil == "load":
        ahead.load_n[2, 0] = np.inf
    elif spoil == "time":
        ahead.time_s[2, 5] = ahead.time_s[2, 4]
    else:
        getattr(start, spoil)[2] = np.nan
    made = mean_forecasts(model, start, ahead)
    assert np.isnan(made.readings_c[2]).all()
    for k in (0, 1, 3, 4, 5):
        assert_array_equal(made.readings_c[k], good.readings_c[k])


def test_a_machine_that_runs_away_has_no_path_and_harms_no_other(
    model: ThermalModel, values: np.ndarray, states: list[MachineState]
) -> None:
    good = mean_forecasts(model, start_of(values, LAGS_S, states), OperatingProfiles.of(AHEAD))
    start, ahead = start_of(values, LAGS_S, states), OperatingProfiles.of(AHEAD)
    ahead.ambient_c[3] = 1e7
    made = mean_forecasts(model, start, ahead)
    assert np.isnan(made.readings_c[3]).all()
    assert_array_equal(np.delete(made.readings_c, 3, 0), np.delete(good.readings_c, 3, 0))


def test_operating_points_held_are_profiles_of_one_step(
    model: ThermalModel, values: np.ndarray, states: list[MachineState]
) -> None:
    speeds, loads = np.array([1000.0, 3000.0]), np.array([2000.0, 2650.0])
    held = OperatingProfiles.held(speeds, loads, [22.0, 25.0], horizon_s=150.0)
    start = start_of(values[:2], LAGS_S[:2], states[:2])
    one_by_one = [
        OperatingProfile(
            np.array([0.0, 60.0, 120.0, 150.0]), *(np.full(4, value) for value in point)
        )
        for point in zip(speeds, loads, [22.0, 25.0], strict=True)
    ]
    assert_array_equal(
        mean_forecasts(model, start, held).readings_c,
        mean_forecasts(model, start, OperatingProfiles.of(one_by_one)).readings_c,
    )


def test_nodes_are_forecast_without_the_lag_of_sensors(
    model: ThermalModel, values: np.ndarray, states: list[MachineState]
) -> None:
    ahead = OperatingProfiles.of([profile(3000.0)])
    start = start_of(values[:1], [60.0], states[:1])
    names = ("t_node_7_c", "t_outer_ring_c")
    lagging = mean_forecasts(model, start, ahead, names)
    prompt = mean_forecasts(model, start._replace(sensor_lag_s=np.zeros(1)), ahead, names)
    assert lagging.names == names
    assert_array_equal(lagging.readings_c[..., 0], prompt.readings_c[..., 0])
    assert_allclose(lagging.readings_c[0, 1:, 1], prompt.readings_c[0, :-1, 1])


def test_profiles_with_other_inputs_do_not_go_together() -> None:
    one = profile(1000.0)
    other = OperatingProfile(
        one.time_s, one.speed_rpm, one.load_n, one.ambient_c, np.ones((one.size, 1))
    )
    with pytest.raises(ValueError, match=r"their numbers of inputs are \[0, 1\]"):
        OperatingProfiles.of([one, other])
