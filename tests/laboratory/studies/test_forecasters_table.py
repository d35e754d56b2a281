"""Every method is scored on the same rows, and a method without a band is not given one."""

from dataclasses import replace

import numpy as np
import pytest

from bearing_twin_laboratory.studies.forecasters import (
    TWIN,
    ForecastScore,
    mean_scores,
    score,
    score_document,
)
from twin_core.forecasting import SensorForecast, naive_forecasters, with_normal_band
from twin_core.naive import NAIVE_KINDS
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")


def staircase() -> MinuteData:
    speed = np.repeat([1500.0, 3000.0, 4500.0], 60)
    rise = np.zeros(180)
    for row in range(179):
        rise[row + 1] = 0.95 * rise[row] + 0.05 * 8.0 * speed[row] / 1e3
    return MinuteData(
        60.0 * np.arange(180.0),
        speed,
        np.full(180, 2650.0),
        np.full(180, 20.0),
        {SENSORS[0]: 20.0 + rise, SENSORS[1]: 20.0 + 0.7 * rise},
        np.ones(180, dtype=np.bool_),
    )


def made(centre_c: list[float], deviation_k: float | None) -> SensorForecast:
    time_s, table = 60.0 * np.arange(len(centre_c)), np.array(centre_c)[:, None]
    if deviation_k is None:
        return SensorForecast(time_s, ("t_inner_ring_c",), table)
    return with_normal_band(time_s, ("t_inner_ring_c",), table, np.full_like(table, deviation_k))


def test_scores_of_a_band_and_of_a_path_alone() -> None:
    measured = {"t_inner_ring_c": np.array([20.0, 22.0, np.nan, 30.0])}
    (path,) = score("path", made([21.0, 21.0, 99.0, 33.0], None), measured)
    assert (path.max_error_k, path.rms_k) == (3.0, pytest.approx(np.sqrt(11.0 / 3.0)))
    assert path.crps_k == pytest.approx(5.0 / 3.0)
    assert path.coverage is path.half_width_k is path.interval_score_k is None
    (band,) = score("band", made([21.0, 21.0, 99.0, 33.0], 1.0), measured)
    assert band.coverage == pytest.approx(2.0 / 3.0)
    assert band.half_width_k == pytest.approx(1.96, abs=1e-3)
    # twice the half-width, and 40 times what lies outside: 3 - 1.96 on one of three rows
    assert band.interval_score_k == pytest.approx(3.92 + 40.0 * 1.04 / 3.0, abs=0.01)
    assert band.crps_k < path.crps_k


def test_errors_are_against_the_truth_where_it_is_known() -> None:
    measured = {"t_inner_ring_c": np.array([20.0, 22.0, np.nan])}
    truth = {"t_inner_ring_c": np.array([21.0, 21.0, 50.0])}
    (found,) = score("band", made([21.0, 21.0, 21.0], 0.1), measured, truth)
    assert found.max_error_k == 0.0
    assert found.coverage == 0.0
    assert score("band", made([21.0], 0.1), {"t_inner_ring_c": np.array([np.nan])}) == ()


def test_the_naive_methods_are_what_they_are() -> None:
    rows = staircase()
    training, ahead_rows = rows.take(slice(0, 120)), rows.take(slice(119, 180))
    ahead = OperatingProfile(
        ahead_rows.time_s, ahead_rows.speed_rpm, ahead_rows.load_n, ahead_rows.ambient_c
    )
    truth = {name: values.copy() for name, values in ahead_rows.temperatures_c.items()}
    initial_c = {name: float(values[0]) for name, values in truth.items()}
    methods = naive_forecasters([training])
    assert tuple(methods) == NAIVE_KINDS
    error_k = {
        name: score(name, methods[name](ahead, initial_c), truth)[0].max_error_k
        for name in ("arx", "persistence")
    }
    # this machine is ARX itself, and persistence knows nothing of the new speed
    assert error_k["arx"] < 0.5
    assert error_k["persistence"] > 8.0


def test_without_a_held_operating_point_the_naive_methods_are_there_too() -> None:
    rows = staircase()
    ramp = replace(rows, speed_rpm=np.linspace(0.0, 6000.0, 180))
    assert tuple(naive_forecasters([ramp.take(slice(0, None, 3))])) == NAIVE_KINDS


def test_means_over_runs() -> None:
    one = ForecastScore(TWIN, "t_inner_ring_c", 1.0, 0.5, 0.9, 2.0, 5.0, 0.3)
    other = replace(one, max_error_k=3.0, coverage=1.0)
    plain = ForecastScore("arx", "t_inner_ring_c", 4.0, 2.0, None, None, None, 1.5)
    means = mean_scores([[one, plain], [other, plain]])
    assert means[0].max_error_k == 2.0
    assert means[0].coverage == pytest.approx(0.95)
    assert means[1] == plain
    document = score_document(means)
    assert document["arx"]["t_inner_ring_c"]["coverage"] is None
    assert document["twin"]["t_inner_ring_c"]["rms_k"] == 0.5
    lost = score_document([replace(plain, rms_k=float("inf"))])
    assert lost["arx"]["t_inner_ring_c"]["rms_k"] is None
