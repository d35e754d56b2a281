"""Surrogates recover a machine of their own kind, stay bounded, and know when they know nothing."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from service.lab.surrogates import SURROGATE_KINDS, fit_surrogate, surrogate_forecasters
from service.lab.surrogates.forecasters import Surrogate
from service.lab.surrogates.lag import fit_lag
from service.lab.surrogates.maps import SurrogateKind, fit_map
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
GENERATOR = np.array([[-1 / 1200.0, 1 / 4000.0], [1 / 2500.0, -1 / 1500.0]])
GRID = [(n, f) for n in (1500.0, 2500.0, 4000.0) for f in (2000.0, 3000.0)]


def steady_k(speed_rpm: float, load_n: float) -> np.ndarray:
    """A gently curved map of two sensors."""
    speed, load = speed_rpm / 1e3, load_n / 1e3
    inner = 3.0 + 6.0 * speed + 0.4 * speed**2 + 2.0 * load
    return np.array([inner, 0.6 * inner])


def machine(
    stages: list[tuple[float, float]], minutes: int = 60, noise_k: float = 0.0, start_k: float = 0.0
) -> MinuteData:
    """A machine that is exactly of the form that the surrogates assume."""
    rng = np.random.default_rng(4)
    keep = expm(60.0 * GENERATOR)
    excess, speed, load = [np.full(2, start_k)], [], []
    for speed_rpm, load_n in stages:
        target = steady_k(speed_rpm, load_n)
        for _ in range(minutes):
            excess.append(target + (excess[-1] - target) @ keep)
            speed.append(speed_rpm)
            load.append(load_n)
    table = 20.0 + np.array(excess[:-1]) + noise_k * rng.standard_normal((len(speed), 2))
    return MinuteData(
        60.0 * np.arange(len(speed)),
        np.array(speed),
        np.array(load),
        np.full(len(speed), 20.0),
        dict(zip(SENSORS, table.T, strict=True)),
        np.ones(len(speed), dtype=np.bool_),
    )


def profile_of(rows: MinuteData) -> OperatingProfile:
    return OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)


def first_of(rows: MinuteData) -> dict[str, float]:
    return {name: float(values[0]) for name, values in rows.temperatures_c.items()}


@pytest.fixture(scope="module")
def fitted() -> dict[str, Surrogate]:
    rows = machine(GRID, noise_k=0.03)
    return {kind: fit_surrogate(kind, [rows]) for kind in SURROGATE_KINDS}


def test_the_lag_and_the_steady_values_are_recovered() -> None:
    lag = fit_lag([machine(GRID)])
    # A step of the inputs at a row is seen by spans across it, which belong to no point.
    np.testing.assert_allclose(lag.points, np.array(GRID) / 1e3, rtol=0.01)
    truth = np.array([steady_k(*point) for point in GRID])
    np.testing.assert_allclose(lag.steady_k, truth, atol=0.6)
    slowest = np.sort(-1.0 / np.linalg.eigvals(lag.generator_per_s).real)[-1]
    assert slowest == pytest.approx(np.max(-1.0 / np.linalg.eigvals(GENERATOR).real), rel=0.15)


@pytest.mark.parametrize("kind", SURROGATE_KINDS)
def test_between_the_points_it_learned_from_each_kind_is_good(
    fitted: dict[str, Surrogate], kind: SurrogateKind
) -> None:
    ahead = machine([(2000.0, 2600.0), (3300.0, 2300.0)])
    made = fitted[kind](profile_of(ahead), first_of(ahead))
    for name in SENSORS:
        error = made.centre(name) - ahead.temperatures_c[name]
        assert np.max(np.abs(error)) < 2.0, name
        assert error[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", ["response_surface", "rbf", "svr", "mlp"])
def test_the_band_grows_to_the_error_at_points_left_out(
    fitted: dict[str, Surrogate], kind: SurrogateKind
) -> None:
    ahead = machine([(3300.0, 2300.0)], minutes=900)
    surrogate = fitted[kind]
    made = surrogate(profile_of(ahead), first_of(ahead))
    left_out = surrogate.steady.left_out_k
    assert made.quantiles_c is not None
    assert left_out is not None
    half = 0.5 * (made.quantiles_c[-1] - made.quantiles_c[0])
    np.testing.assert_allclose(half[0], 1.959964 * surrogate.training_rms_k, rtol=1e-5)
    settled = 1.959964 * np.hypot(left_out, surrogate.training_rms_k)
    np.testing.assert_allclose(half[-1], settled, rtol=1e-3)


@pytest.mark.parametrize("kind", SURROGATE_KINDS)
def test_free_runs_of_days_settle_wherever_they_go(
    fitted: dict[str, Surrogate], kind: SurrogateKind
) -> None:
    count = 3 * 1440
    profile = OperatingProfile(
        60.0 * np.arange(count),
        np.full(count, 9000.0),
        np.full(count, 9000.0),
        np.full(count, 20.0),
    )
    made = fitted[kind](profile, dict.fromkeys(SENSORS, 120.0))
    assert np.all(np.isfinite(made.centre_c))
    np.testing.assert_allclose(made.centre_c[-1], made.centre_c[-60], atol=1e-3)


def test_kriging_knows_that_it_is_far_from_its_points(fitted: dict[str, Surrogate]) -> None:
    near, far = np.array([[2.5, 2.5]]), np.array([[8.0, 6.0]])
    of_kriging = fitted["kriging"].steady
    inside, outside = of_kriging.predict(near)[1], of_kriging.predict(far)[1]
    assert inside is not None
    assert outside is not None
    assert np.all(outside > 3.0 * inside)
    # the others only know how wrong they were at points left out, wherever that is
    of_rbf = fitted["rbf"].steady
    np.testing.assert_array_equal(of_rbf.predict(near)[1], of_rbf.predict(far)[1])  # type: ignore[arg-type]


def test_surrogates_without_a_trend_fall_back_to_the_mean_far_away() -> None:
    points = np.array(GRID) / 1e3
    steady = np.array([steady_k(*point) for point in GRID])
    found, _ = fit_map("rbf", points, steady).predict(np.array([[60.0, 60.0]]))
    np.testing.assert_allclose(found[0], steady.mean(axis=0), rtol=1e-6)
    trend, _ = fit_map("response_surface", points, steady).predict(np.array([[6.0, 2.5]]))
    np.testing.assert_allclose(trend[0], steady_k(6000.0, 2500.0), rtol=0.15)


def test_a_single_point_teaches_no_slope_and_no_band() -> None:
    rows = machine([(1500.0, 2650.0)], minutes=120)
    ahead = machine([(6000.0, 5500.0)], minutes=600)
    for kind, forecaster in surrogate_forecasters([rows]).items():
        made = forecaster(profile_of(ahead), first_of(ahead))
        assert made.quantiles_c is None, kind
        np.testing.assert_allclose(
            made.centre_c[-1] - 20.0, steady_k(1500.0, 2650.0), rtol=0.08, err_msg=kind
        )


def test_gaps_missing_values_and_bad_rows_are_left_out() -> None:
    whole = machine(GRID)
    temperatures = {name: values.copy() for name, values in whole.temperatures_c.items()}
    temperatures["t_outer_ring_c"][70:80] = np.nan
    good = whole.good.copy()
    good[200:204] = False
    holed = replace(whole, temperatures_c=temperatures, good=good)
    holed = holed.take(np.arange(holed.size) // 10 != 30)
    np.testing.assert_allclose(fit_lag([holed]).steady_k, fit_lag([whole]).steady_k, rtol=0.05)


def test_a_sensor_without_a_reading_starts_at_its_steady_value(
    fitted: dict[str, Surrogate],
) -> None:
    ahead = machine([GRID[3]])
    made = fitted["kriging"](profile_of(ahead), {SENSORS[0]: 30.0, SENSORS[1]: float("nan")})
    assert made.centre(SENSORS[0])[0] == pytest.approx(30.0)
    assert made.centre(SENSORS[1])[0] == pytest.approx(20.0 + steady_k(*GRID[3])[1], abs=1.5)


def test_what_cannot_be_learned_from_is_refused() -> None:
    rows = machine([(1500.0, 2650.0)])
    with pytest.raises(ValueError, match="no windows"):
        fit_surrogate("mlp", [])
    other = replace(rows, temperatures_c={SENSORS[0]: rows.temperatures_c[SENSORS[0]]})
    with pytest.raises(ValueError, match="differ in their sensors"):
        fit_surrogate("mlp", [rows, other])
    with pytest.raises(ValueError, match="no ten minutes in a row"):
        fit_surrogate("mlp", [rows.take(slice(0, 5))])
    ramp = replace(rows, speed_rpm=np.linspace(0.0, 6000.0, rows.size))
    with pytest.raises(ValueError, match="held for a quarter of an hour"):
        fit_surrogate("mlp", [ramp])
    with pytest.raises(ValueError, match="surrogate 'lasso', expected one of response_surface"):
        fit_surrogate("lasso", [rows])  # type: ignore[arg-type]


def test_without_scikit_learn_one_line_says_what_to_install() -> None:
    script = "import sys; sys.modules['sklearn'] = None; import service.lab.surrogates"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=280
    )
    assert done.returncode == 1
    expected = "scikit-learn is not installed: pip install 'bearing-twin[surrogates]'"
    assert done.stderr.splitlines()[-1] == f"ImportError: {expected}"
