"""The whitening filter against a dense Cholesky factor."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.identification.whitening import whitening


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
