"""The hybrid repeats a structured error where it was seen and leaves the twin alone elsewhere."""

import numpy as np
import pytest

from service.lab.surrogates import ResidualModel, fit_residual, with_residual
from twin_core.forecasting import SensorForecast, with_normal_band
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
BIAS_K = {1500.0: 1.0, 4000.0: -1.5}


def windows() -> tuple[list[MinuteData], list[dict[str, np.ndarray]]]:
    """A twin that is wrong by a constant at each of two speeds, and right on the outer ring."""
    rng = np.random.default_rng(8)
    speed = np.repeat([1500.0, 4000.0], 120)
    twin = np.repeat([35.0, 55.0], 120)
    bias = np.array([BIAS_K[value] for value in speed])
    noise = 0.05 * rng.standard_normal((2, speed.size))
    rows = MinuteData(
        60.0 * np.arange(speed.size),
        speed,
        np.full(speed.size, 2650.0),
        np.full(speed.size, 20.0),
        {SENSORS[0]: twin + bias + noise[0], SENSORS[1]: 0.7 * twin + noise[1]},
        np.ones(speed.size, dtype=np.bool_),
    )
    return [rows], [{SENSORS[0]: twin, SENSORS[1]: 0.7 * twin}]


@pytest.fixture(scope="module")
def model() -> ResidualModel:
    return fit_residual(*windows())


def hours_at(
    speed_rpm: float, load_n: float, inner_c: float
) -> tuple[OperatingProfile, np.ndarray]:
    profile = OperatingProfile(
        60.0 * np.arange(181), *(np.full(181, value) for value in (speed_rpm, load_n, 20.0))
    )
    return profile, np.column_stack([np.full(181, inner_c), np.full(181, 0.7 * inner_c)])


@pytest.mark.parametrize(("speed_rpm", "inner_c"), [(1500.0, 35.0), (4000.0, 55.0)])
def test_a_known_error_comes_back_gradually(
    model: ResidualModel, speed_rpm: float, inner_c: float
) -> None:
    profile, centre = hours_at(speed_rpm, 2650.0, inner_c)
    made = with_residual(SensorForecast(profile.time_s, SENSORS, centre), profile, model)
    correction = made.centre_c - centre
    np.testing.assert_allclose(correction[0], 0.0)
    assert correction[-1, 0] == pytest.approx(BIAS_K[speed_rpm], abs=0.1)
    assert abs(correction[-1, 1]) < 0.05
    assert made.quantiles_c is None


def test_nothing_is_corrected_where_nothing_was_seen(model: ResidualModel) -> None:
    profile, centre = hours_at(6200.0, 5500.0, 90.0)
    mean, deviation = model.correction(profile, centre)
    assert np.max(np.abs(mean)) < 0.05
    # there the process only says how wrong the twin has been on the whole
    assert deviation[-1, 0] > 0.9


def test_variances_add_up(model: ResidualModel) -> None:
    profile, centre = hours_at(6200.0, 5500.0, 90.0)
    twin = with_normal_band(profile.time_s, SENSORS, centre, np.full_like(centre, 2.0))
    made = with_residual(twin, profile, model)
    _, deviation = model.correction(profile, centre)
    quantiles = made.quantiles(SENSORS[0])
    assert quantiles is not None
    np.testing.assert_allclose(
        quantiles[-1] - quantiles[2], 1.959964 * np.hypot(2.0, deviation[:, 0]), rtol=1e-5
    )
    np.testing.assert_allclose(quantiles[2] - quantiles[0], quantiles[-1] - quantiles[2])
    assert np.all(np.diff(quantiles, axis=0) > 0.0)


def test_what_does_not_fit_is_refused(model: ResidualModel) -> None:
    rows, paths = windows()
    with pytest.raises(ValueError, match="1 windows and 0 paths"):
        fit_residual(rows, [])
    with pytest.raises(ValueError, match=r"path has shape \(3,\), expected \(240,\)"):
        fit_residual(rows, [{name: np.zeros(3) for name in SENSORS}])
    few = rows[0].take(slice(0, 20))
    short = [{name: path[:20] for name, path in paths[0].items()}]
    with pytest.raises(ValueError, match="20 residuals, expected at least 30"):
        fit_residual([few], short)
    profile, centre = hours_at(1500.0, 2650.0, 35.0)
    with pytest.raises(ValueError, match="forecast of t_node_1_c, expected t_inner_ring_c"):
        with_residual(
            SensorForecast(profile.time_s, ("t_node_1_c",), centre[:, :1]), profile, model
        )
