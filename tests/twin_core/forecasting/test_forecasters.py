"""One form for all forecasts: paths, bands, and the twin's ensemble beside the others."""

import numpy as np
import pytest

from twin_core.forecasting import (
    QUANTILE_LEVELS,
    Forecast,
    SensorForecast,
    naive_forecasters,
    of_ensemble,
    with_normal_band,
)
from twin_core.naive import NAIVE_KINDS, fit_naive
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")


def staircase() -> MinuteData:
    speed = np.repeat([1500.0, 3000.0], 60)
    load = np.full(120, 2650.0)
    rise = np.repeat([8.0, 19.0], 60) * (1.0 - np.exp(-np.tile(np.arange(60.0), 2) / 20.0))
    return MinuteData(
        60.0 * np.arange(120.0),
        speed,
        load,
        np.full(120, 20.0),
        {SENSORS[0]: 20.0 + rise, SENSORS[1]: 20.0 + 0.7 * rise},
        np.ones(120, dtype=np.bool_),
    )


def test_a_normal_band_has_its_quantiles() -> None:
    forecast = with_normal_band(
        np.array([0.0, 60.0]), SENSORS, np.array([[20.0, 30.0], [21.0, 31.0]]), np.full((2, 2), 2.0)
    )
    lower, _, median, _, upper = forecast.quantiles("t_outer_ring_c")  # type: ignore[misc]
    np.testing.assert_allclose(median, forecast.centre("t_outer_ring_c"))
    np.testing.assert_allclose(upper - median, 1.959964 * 2.0, rtol=1e-6)
    np.testing.assert_allclose(median - lower, 1.959964 * 2.0, rtol=1e-6)


def test_an_unknown_sensor_is_named() -> None:
    forecast = SensorForecast(np.zeros(1), SENSORS, np.zeros((1, 2)))
    assert forecast.quantiles(SENSORS[0]) is None
    with pytest.raises(KeyError, match=r"t_node_4_c.*expected one of t_inner_ring_c"):
        forecast.centre("t_node_4_c")


def test_naive_forecasters_are_the_naive_forecasts() -> None:
    rows = staircase()
    profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
    now_c = {SENSORS[0]: 25.0, SENSORS[1]: 23.0}
    tables = fit_naive([rows]).forecast(profile, now_c)
    forecasters = naive_forecasters([rows])
    assert tuple(forecasters) == NAIVE_KINDS
    for kind, forecaster in forecasters.items():
        made = forecaster(profile, now_c)
        assert made.quantiles_c is None
        for name in SENSORS:
            np.testing.assert_array_equal(made.centre(name), tables[kind][name])


def test_the_twins_sensors_come_before_its_nodes() -> None:
    quantiles = np.arange(5.0 * 3 * 4).reshape(5, 3, 4)
    ensemble = Forecast(
        time_s=np.arange(3.0),
        names=(*SENSORS, "node_1", "node_2"),
        quantiles=quantiles,
        members_c=np.zeros((2, 3, 2)),
        sensors=SENSORS,
        runaway_probability=0.0,
        labels=(),
        whole_run_factor=np.ones((3, 2)),
    )
    forecast = of_ensemble(ensemble)
    assert forecast.sensors == SENSORS
    np.testing.assert_array_equal(forecast.quantiles("t_outer_ring_c"), quantiles[:, :, 1])
    np.testing.assert_array_equal(forecast.centre("t_outer_ring_c"), quantiles[2, :, 1])
    assert QUANTILE_LEVELS[2] == 0.5
