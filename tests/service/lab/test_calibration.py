"""Conformal factors from whole runs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from service.lab.calibration import (
    LEAST_FACTOR,
    calibrated,
    conformal_factor,
    run_score,
)

BAND = np.array([np.full(20, -1.0), np.zeros(20), np.full(20, 2.0)])


def test_the_score_is_what_the_band_would_have_needed() -> None:
    truth = np.zeros(20)
    truth[:3] = 3.0  # 1.5 upper half-widths
    truth[3] = -5.0  # 5 lower ones; the one row in twenty that may lie outside
    assert run_score(BAND, truth) == pytest.approx(1.5)
    assert run_score(BAND, truth, held=1.0) == pytest.approx(5.0)
    assert run_score(BAND, truth, rows=slice(4, None)) == 0.0
    truth[3] = np.nan
    assert run_score(BAND, truth, held=1.0) == pytest.approx(1.5)


def test_senseless_scores_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        run_score(BAND, np.zeros(3))
    with pytest.raises(ValueError, match="no known row"):
        run_score(BAND, np.full(20, np.nan))
    with pytest.raises(ValueError, match="without width"):
        run_score(np.zeros((3, 20)), np.zeros(20))


def test_the_factor_by_hand() -> None:
    scores = [0.5, 2.0, 1.0, 0.7, 1.5, 0.9, 0.8, 1.1, 0.6]
    assert conformal_factor(scores, level=0.9) == 2.0  # the ceil(.9 x 10) = 9th of 9
    assert conformal_factor(scores, level=0.8) == 1.5
    assert conformal_factor(scores[:8], level=0.9) == np.inf
    assert conformal_factor([]) == np.inf
    with pytest.raises(ValueError, match="level"):
        conformal_factor(scores, level=1.0)


def test_further_runs_are_held_as_often_as_promised() -> None:
    """Runs whose errors hang together: bands for single rows hold whole runs too seldom."""
    rng = np.random.default_rng(4)
    rows, trials, runs = 60, 300, 19
    band = np.array([np.full(rows, -1.0), np.zeros(rows), np.full(rows, 1.0)])
    held = 0
    for _ in range(trials):
        truth = rng.normal(0.0, 1.0, (runs + 1, 1)) + rng.normal(0.0, 0.2, (runs + 1, rows))
        scores = [run_score(band, run) for run in truth]
        factor = conformal_factor(scores[:runs], level=0.9)
        lower, _, upper = calibrated(band, factor, beyond_trained_load=False)
        held += np.mean((truth[runs] >= lower) & (truth[runs] <= upper)) >= 0.95
    assert held / trials == pytest.approx(0.9, abs=0.04)


def test_bands_widen_about_the_median_and_narrow_only_within_the_trained_loads() -> None:
    assert_allclose(calibrated(BAND, 2.0, beyond_trained_load=True), 2.0 * BAND)
    assert_allclose(calibrated(BAND, 0.9, beyond_trained_load=False), 0.9 * BAND)
    assert_allclose(calibrated(BAND, 0.9, beyond_trained_load=True), BAND)
    assert_allclose(calibrated(BAND, 0.1, beyond_trained_load=False), LEAST_FACTOR * BAND)
    assert_allclose(calibrated(BAND, np.inf, beyond_trained_load=False), BAND)
    shifted = calibrated(BAND + 40.0, 3.0, beyond_trained_load=True)
    assert_allclose(shifted[1], 40.0)
    with pytest.raises(ValueError, match="odd"):
        calibrated(BAND[:2], 1.0, beyond_trained_load=False)
    with pytest.raises(ValueError, match="positive"):
        calibrated(BAND, 0.0, beyond_trained_load=False)
