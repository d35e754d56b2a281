import numpy as np
import pytest

from twin_core.filtering import begin, run_filter
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile, simulate

COLD = Point(0.0, 0.0, 22.0)


@pytest.fixture(scope="module")
def rows() -> OperatingProfile:
    time_s = np.array([0.0, 60.0, 90.0, 300.0, 301.0, 1200.0])
    speed_rpm = np.array([0.0, 1500.0, 1500.0, 3000.0, 3000.0, 0.0])
    return OperatingProfile(time_s, speed_rpm, np.full(6, 2650.0), np.full(6, 22.0))


def cold(model: ThermalModel) -> Observer:
    return begin(model, model.parameters.centre, {"t_inner_ring_c": 22.0}, COLD, at_rest=True)


def test_rows_are_taken_one_after_the_other(model: ThermalModel, rows: OperatingProfile) -> None:
    readings: list[dict[str, float]] = [
        {"t_inner_ring_c": 99.0},  # of the first row: the observer has begun with it
        {"t_inner_ring_c": 22.5, "t_outer_ring_c": 22.1},
        {},
        {"t_outer_ring_c": 23.0},
        {"t_inner_ring_c": 25.0},
        {"t_inner_ring_c": 31.0, "t_outer_ring_c": 28.0},
    ]
    filtered, by_hand = run_filter(cold(model), rows, readings), cold(model)
    for row in range(1, 6):
        by_hand.predict(
            rows.time_s[row] - rows.time_s[row - 1], rows.speed_rpm[row - 1], 2650.0, 22.0
        )
        by_hand.update(readings[row])
    assert filtered.to_dict() == by_hand.to_dict()
    assert filtered.revolutions == pytest.approx((1500.0 * 240.0 + 3000.0 * 900.0) / 60.0)


def test_without_readings_it_is_a_simulation(model: ThermalModel, rows: OperatingProfile) -> None:
    alone = run_filter(cold(model), rows, [{}] * rows.size)
    start = cold(model).temperatures_c
    path = simulate(model, model.parameters.centre, rows, start).temperatures_c
    np.testing.assert_allclose(alone.temperatures_c, path[-1], atol=1e-3)


def test_of_one_row_nothing_is_advanced(model: ThermalModel, rows: OperatingProfile) -> None:
    observer = run_filter(cold(model), rows.rows(slice(1)), [{"t_inner_ring_c": 60.0}])
    assert observer.to_dict() == cold(model).to_dict()
