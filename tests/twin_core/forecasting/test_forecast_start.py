"""A forecast begins where the observer stands, also when its model does not fit the machine."""

from dataclasses import replace

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters, measure, scenario_profile, simulate
from adapters.virtual_bench.scenarios import find_scenario
from twin_core.bearings import bearing
from twin_core.forecasting import forecast
from twin_core.identification.posterior import prior_posterior
from twin_core.initial_state import initial_state
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.models import build_model
from twin_core.observer import Observer
from twin_core.simulation import OperatingProfile, simulate_batch

HOLD_S = np.arange(0.0, 601.0, 60.0)


def test_the_forecast_goes_on_from_the_measured_temperature_without_a_jump() -> None:
    """Late in a stage the reading moves slowly; so must the forecast of an unidentified twin."""
    bench = BenchParameters.for_bearing("6311")
    profile = scenario_profile(find_scenario("demo"), bench, 0, step_s=1.0)
    measured = measure(profile, simulate(profile, bench), 0)
    model = build_model(bearing=bearing("6311"))
    posterior = prior_posterior(model)
    values = model.parameters.values_from_z(posterior.z)
    mean, covariance = initial_state(
        model, values, {"t_inner_ring_c": float(measured.t_inner_ring_c[0])}, 22.6, 0.0, 0.0, True
    )
    observer = Observer(model, values, mean, covariance)
    end = 3 * 60 + 40 * 60  # in the stage of 1500 rpm, 15 min before its end
    for second in range(0, end, 10):
        observer.predict(
            10.0,
            float(measured.speed_rpm[second]),
            float(measured.load_n[second]),
            float(measured.ambient_c[second]),
        )
        observer.update(
            {
                "t_inner_ring_c": float(measured.t_inner_ring_c[second + 10]),
                "t_outer_ring_c": float(measured.t_outer_ring_c[second + 10]),
            }
        )
    ahead = OperatingProfile(
        HOLD_S,
        np.full(HOLD_S.size, 1500.0),
        np.full(HOLD_S.size, 2650.0),
        np.full(HOLD_S.size, float(measured.ambient_c[end])),
    )

    row = model.sensor_row("t_inner_ring_c")

    def ahead_c(disturbance_w: np.ndarray | None) -> np.ndarray:
        paths = simulate_batch(
            model,
            values[None],
            ahead,
            observer.temperatures_c,
            observer.revolutions,
            disturbance_w=disturbance_w,
            disturbance_time_s=DISTURBANCE_TIME_S,
        )
        return np.asarray(paths[0] @ row)

    reading = measured.t_inner_ring_c[end : end + 601 : 60]
    with_heat = np.abs(ahead_c(observer.heat_disturbance_w) - reading).max()
    without = np.abs(ahead_c(None) - reading).max()
    assert with_heat < min(0.5, 0.75 * without)

    warmer = np.zeros(13)
    warmer[model.node_names.index("t_node_4_c")] = 5.0
    started = [
        forecast(
            model,
            posterior,
            replace(observer.state(), heat_disturbance_w=heat, operating_point=None),
            ahead,
            members=50,
        ).quantile("t_inner_ring_c")[2]
        for heat in (None, warmer)
    ]
    assert np.all(started[1][2:] > started[0][2:] + 0.3)

    # Members start on the observed course: at the same operating point the band opens slowly.
    opened = []
    for point in (None, observer.operating_point):
        band = forecast(
            model,
            posterior,
            replace(observer.state(), operating_point=point),
            ahead,
            members=50,
        ).quantile("t_inner_ring_c")
        opened.append(band[4] - band[0])
    assert opened[1][0] == pytest.approx(opened[0][0])
    assert opened[1][1] - opened[1][0] < 0.3 < opened[0][1] - opened[0][0]
    assert np.abs(band[2] - reading).max() < 0.5
