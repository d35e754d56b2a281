"""What becomes of heats that a member lacks when the machine stops."""

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.forecasting import forecast
from twin_core.forecasting.members import goes_on_as, member_paths
from twin_core.identification.posterior import prior_posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile, simulate_batch, steady_state

HEAVY = (5000.0, 5500.0, 22.0)
RUN_IN = 1e9


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


def profile(*speeds_rpm: float) -> OperatingProfile:
    """Half an hour at each speed, 5500 N."""
    speed = np.repeat(speeds_rpm, 31)
    rows = speed.size
    return OperatingProfile(
        60.0 * np.arange(rows), speed, np.full(rows, 5500.0), np.full(rows, 22.0)
    )


@pytest.mark.parametrize(
    ("speeds_rpm", "stop"), [((0.0, 0.0), 0), ((5000.0, 0.0, 0.0), 31)], ids=["now", "later"]
)
def test_nothing_grows_hotter_in_a_stop(
    model: ThermalModel, speeds_rpm: tuple[float, ...], stop: int
) -> None:
    """The heats that keep members on the course of a hot run are mostly friction: it ends."""
    hot = steady_state(model, model.parameters.centre, *HEAVY, RUN_IN)
    result = forecast(
        model,
        prior_posterior(model),
        MachineState(hot, 0.01 * np.eye(13), RUN_IN, 22.0, operating_point=Point(*HEAVY)),
        profile(*speeds_rpm),
    )
    inner = result.members_c[:, :, result.sensors.index("t_inner_ring_c")]
    # Within minutes the hotter balls may still warm it; after that every member cools.
    assert np.all(inner[:, -1] < inner[:, stop] + 1.0)
    upper = result.quantile("t_inner_ring_c")[4]
    assert upper[-1] < upper[stop] - 5.0


def test_heats_fade_while_the_machine_runs_and_end_when_it_stops(model: ThermalModel) -> None:
    centre = model.parameters.centre[np.newaxis]
    start = steady_state(model, centre[0], *HEAVY, RUN_IN)[np.newaxis]
    heat = np.zeros((1, 13))
    heat[0, 3] = 20.0
    running = profile(5000.0, 4000.0)
    whole = simulate_batch(
        model,
        centre,
        running,
        start,
        0.0,
        disturbance_w=heat,
        disturbance_time_s=DISTURBANCE_TIME_S,
    )
    np.testing.assert_array_equal(member_paths(model, centre, running, start, 0.0, heat), whole)

    paths = member_paths(model, centre, profile(5000.0, 0.0), start, 0.0, heat)
    np.testing.assert_allclose(paths[:, :32], whole[:, :32])
    turned = 5000.0 * 31
    resting = profile(0.0)
    np.testing.assert_allclose(
        paths[:, 31:], simulate_batch(model, centre, resting, whole[:, 31], turned)
    )


def test_a_member_that_runs_away_before_the_stop_is_lost_as_a_whole(model: ThermalModel) -> None:
    centre = np.repeat(model.parameters.centre[np.newaxis], 2, axis=0)
    start = np.full((2, 13), 22.0)
    heat = np.array([np.zeros(13), np.full(13, 1e7)])
    paths = member_paths(model, centre, profile(5000.0, 0.0), start, 0.0, heat)
    assert np.all(np.isfinite(paths[0]))
    assert np.all(np.isnan(paths[1]))


def test_a_machine_goes_on_if_it_keeps_running_or_standing() -> None:
    assert goes_on_as(Point(*HEAVY), profile(1500.0))
    assert goes_on_as(Point(0.0, 0.0, 22.0), profile(0.0))
    assert not goes_on_as(Point(*HEAVY), profile(0.0))
    assert not goes_on_as(Point(0.0, 0.0, 22.0), profile(1500.0))
