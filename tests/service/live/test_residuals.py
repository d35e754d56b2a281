"""The sequential test of the residuals, the rate of rise, and the model alone."""

import numpy as np
import pytest

from service.live.rates import RatesOfRise
from service.live.residuals import MOST_BLOCKS, Residuals, residual_threshold
from twin_core.observer import Innovation

STEP_S = 5.0
PER_BLOCK = 120
RING = "t_inner_ring_c"


def add(residuals: Residuals, values: np.ndarray, low_risk: bool = True) -> None:
    for value in values.tolist():
        residuals.add({RING: Innovation(0.3 * value, 0.3)}, STEP_S, low_risk)


def test_the_threshold_follows_the_stated_rate_and_the_number_of_channels() -> None:
    usual = residual_threshold(0.5, 2)
    assert usual == pytest.approx(8.93, abs=0.02)
    assert residual_threshold(0.05, 2) > usual
    assert residual_threshold(0.5, 13) > usual
    assert residual_threshold(0.5, 0) == residual_threshold(0.5, 1)


def test_blocks_are_standard_normal_whatever_the_step() -> None:
    rng = np.random.default_rng(1)
    residuals = Residuals(9.0)
    add(residuals, rng.standard_normal(40 * PER_BLOCK))
    sizes = residuals.charts[RING].usual
    assert len(sizes) == 40
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(1.0, abs=0.3)
    assert residuals.charts[RING].cusum.value < 9.0


def test_a_lasting_shift_is_found_and_an_outlier_is_not() -> None:
    rng = np.random.default_rng(2)
    residuals = Residuals(9.0)
    quiet = 0.1 * rng.standard_normal(MOST_BLOCKS * PER_BLOCK)
    add(residuals, quiet)
    chart = residuals.charts[RING]
    assert len(chart.usual) == MOST_BLOCKS
    assert chart.cusum.value < 1.0
    add(residuals, np.full(PER_BLOCK, 50.0))  # a start, or a stop
    assert chart.cusum.value <= 3.5
    add(residuals, quiet[: 20 * PER_BLOCK] + 0.1)
    assert chart.cusum.value > 9.0, "0.1 of the expected spread is much for this machine"
    add(residuals, quiet[: 60 * PER_BLOCK])
    assert chart.cusum.value < 4.5, "it returns when the shift has gone"
    assert len(chart.usual) == MOST_BLOCKS, "what is usual is not learnt from a fault"


def test_outside_the_low_risk_region_the_model_is_believed_less() -> None:
    rng = np.random.default_rng(3)
    inside, outside = Residuals(9.0), Residuals(9.0)
    for residuals in (inside, outside):
        add(residuals, 0.1 * rng.standard_normal(60 * PER_BLOCK))
    shifted = 0.1 * rng.standard_normal(40 * PER_BLOCK) + 0.04
    add(inside, shifted)
    add(outside, shifted, low_risk=False)
    assert inside.charts[RING].cusum.value > 9.0
    assert outside.charts[RING].cusum.value < 9.0
    assert len(outside.charts[RING].usual) == 60


def test_residuals_survive_a_restart_and_begin_anew_with_another_model() -> None:
    rng = np.random.default_rng(4)
    residuals = Residuals(9.0)
    add(residuals, rng.standard_normal(50 * PER_BLOCK) + 0.2)
    kept = residuals.to_dict()
    taken_up = Residuals(9.0)
    taken_up.restore(kept)
    assert taken_up.to_dict() == kept
    assert taken_up.charts[RING].cusum.value == residuals.charts[RING].cusum.value > 0.0
    taken_up.restart()
    assert taken_up.to_dict() == {RING: {"high": 0.0, "low": 0.0, "usual": []}}
    broken = Residuals(9.0)
    broken.restore({RING: {"high": "x"}, "t_outer_ring_c": None, "a": {"high": 1, "low": 2}})
    assert broken.charts == {}


# ---------------------------------------------------------------------------- rate of rise
def test_the_rate_is_the_slope_over_the_window() -> None:
    courses = RatesOfRise(300.0)
    rng = np.random.default_rng(5)
    assert courses.rate_k_per_min(RING) is None
    for second in range(0, 901, 5):
        noise = round(0.05 * float(rng.standard_normal()), 1)
        courses.add(second * 1_000_000, {RING: 20.0 + 3.0 * second / 60.0 + noise})
        if second < 200:
            assert courses.rate_k_per_min(RING) is None, "too little is known yet"
    assert courses.rate_k_per_min(RING) == pytest.approx(3.0, abs=0.05)


def test_nothing_stays_of_what_has_left_the_window() -> None:
    """Its sums are exact: after days and a nonsense value the slope is that of the points."""
    courses = RatesOfRise(300.0)
    rng = np.random.default_rng(6)
    times_us = np.cumsum(rng.integers(900_000, 1_100_000, 20_000))
    values = 40.0 + np.cumsum(rng.normal(0.0, 0.01, times_us.size))
    values[9_000] = 1e300
    for time_us, value in zip(times_us.tolist(), values.tolist(), strict=True):
        courses.add(time_us, {RING: value})
    inside = times_us >= times_us[-1] - 300_000_000
    minutes = (times_us[inside] - times_us[-1]) / 60e6
    assert courses.rate_k_per_min(RING) == round(np.polyfit(minutes, values[inside], 1)[0], 3)


def test_a_gap_or_a_clock_set_back_gives_no_rate() -> None:
    courses = RatesOfRise(300.0)
    for second in range(0, 600, 5):
        courses.add(second * 1_000_000, {RING: 20.0})
    assert courses.rate_k_per_min(RING) == pytest.approx(0.0, abs=1e-9)
    courses.add(900_000_000, {})
    assert courses.rate_k_per_min(RING) is None
    courses.add(1_000_000_000, {RING: 60.0})
    assert courses.rate_k_per_min(RING) is None, "a jump across a gap is no rate"
    courses.add(10_000_000, {RING: 20.0})
    assert courses.rate_k_per_min(RING) is None
