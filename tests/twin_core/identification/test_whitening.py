"""The whitening filter against a dense Cholesky factor."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from twin_core.identification.whitening import LOSS_SCALE, Loss, whitening


def covariance(time_s: np.ndarray) -> np.ndarray:
    lag = np.abs(time_s[:, None] - time_s[None, :])
    return 0.15**2 * np.eye(time_s.size) + 0.30**2 * np.exp(-lag / 1800.0) + 0.10**2


@pytest.mark.parametrize("gaps", [False, True])
def test_equals_the_inverse_cholesky_factor(gaps: bool) -> None:
    rng = np.random.default_rng(2)
    time_s = 60.0 * np.arange(150.0)
    if gaps:
        time_s = np.sort(rng.choice(time_s, 90, replace=False)) + rng.uniform(0, 20, 90)
    residuals = rng.normal(size=(3, time_s.size))
    dense = np.linalg.solve(np.linalg.cholesky(covariance(time_s)), residuals.T).T
    assert_allclose(whitening(time_s).apply(residuals), dense, atol=1e-10)


def test_residuals_of_the_assumed_kind_become_white() -> None:
    rng = np.random.default_rng(3)
    time_s = 60.0 * np.arange(200.0)
    residuals = rng.standard_normal((2000, 200)) @ np.linalg.cholesky(covariance(time_s)).T
    white = whitening(time_s).apply(residuals)
    assert_allclose(white.T @ white / 2000, np.eye(200), atol=0.12)


def test_one_row_and_failed_members() -> None:
    assert whitening(np.array([5.0])).apply(np.array([[0.35]]))[0, 0] == pytest.approx(1.0)
    white = whitening(60.0 * np.arange(4.0)).apply(np.array([[1.0] * 4, [np.nan] * 4]))
    assert np.all(np.isfinite(white[0]))
    assert np.all(np.isnan(white[1]))


@pytest.mark.parametrize("loss", ["linear", "soft_l1", "huber", "cauchy"])
@pytest.mark.parametrize("error", [0.1, 0.5, 3.0, 40.0])
def test_a_residual_costs_what_scipys_loss_says(loss: Loss, error: float) -> None:
    filtered = whitening(np.array([0.0]), 1.0, 1e-12, 1800.0, 1e-12, loss=loss)
    found = filtered.apply(np.array([-error]))[0]
    expected = least_squares(
        lambda x: np.array([error]), [0.0], jac=lambda x: np.zeros((1, 1)), loss=loss,
        f_scale=LOSS_SCALE, max_nfev=1,
    ).cost  # fmt: skip
    assert found < 0.0
    assert found**2 == pytest.approx(2.0 * expected, rel=1e-9)
    weight = filtered.weights(np.array([error]))[0]
    assert 0.0 < weight <= 1.0
    if loss == "linear" or error < 0.2:
        assert weight == pytest.approx(1.0, abs=0.01)
    elif error > 10.0:
        assert weight < 0.1


@pytest.mark.parametrize("loss", ["linear", "soft_l1", "huber", "cauchy"])
def test_slopes_are_those_of_the_filter(loss: Loss) -> None:
    rng = np.random.default_rng(5)
    filtered = whitening(60.0 * np.arange(80.0), loss=loss)
    residuals = 0.3 * rng.standard_normal(80)
    residuals[[20, 41]] += 5.0, -3.0
    tangents = rng.standard_normal((2, 80))
    slopes = filtered.slopes(residuals, tangents)
    for tangent, slope in zip(tangents, slopes, strict=True):
        ends = filtered.apply(np.stack([residuals + 1e-6 * tangent, residuals - 1e-6 * tangent]))
        assert_allclose(slope, (ends[0] - ends[1]) / 2e-6, atol=1e-6)


def test_an_outlier_does_not_pass_for_a_slow_deviation() -> None:
    residuals = np.zeros(60)
    residuals[20] = 8.0
    squared = whitening(60.0 * np.arange(60.0)).apply(residuals)
    robust = whitening(60.0 * np.arange(60.0), loss="cauchy").apply(residuals)
    assert np.abs(squared[21:]).max() > 5.0
    assert np.abs(robust[21:]).max() < 0.3


def test_an_unknown_loss_is_named() -> None:
    with pytest.raises(ValueError, match="loss is 'l3', expected one of linear, soft_l1, huber"):
        whitening(np.arange(3.0), loss="l3")  # type: ignore[arg-type]
