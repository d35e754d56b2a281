"""The time to respond, from forecasts whose answer is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_core.response_time import crossing_times_s, time_between, time_to
from twin_core.scores import QUANTILE_LEVELS

LEADS = (300.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0)
SPREAD = np.array([-2.0, -0.5, 0.0, 0.5, 2.0])


def line(
    start_c: float, k_per_h: float, spread: float = 1.0
) -> tuple[tuple[float, ...], np.ndarray]:
    """A forecast that rises along a straight line."""
    median = start_c + k_per_h * np.array(LEADS) / 3600.0
    return LEADS, median[:, None] + spread * SPREAD


def test_on_a_straight_line_the_time_is_that_of_the_line() -> None:
    found = time_between([line(60.0, 10.0)], 65.0, 80.0)
    assert found is not None
    # 15 K at 10 K/h, the same for every rank.
    assert (found.p05_s, found.p50_s) == pytest.approx((5400.0, 5400.0))
    assert (found.never_share, found.forecasts, found.looked_at) == (0.0, 1, 1)


def test_what_comes_not_so_far_is_said_and_not_made_up() -> None:
    assert time_between([], 65.0, 80.0) is None
    far = time_between([line(40.0, 0.0)] * 3, 65.0, 80.0)
    assert far is not None
    assert (far.forecasts, far.looked_at, far.p05_s, far.never_share) == (0, 3, np.inf, 1.0)
    mixed = time_between([line(60.0, 10.0), line(66.0, 0.5), line(66.0, 0.5)], 65.0, 80.0)
    assert mixed is not None
    assert mixed.forecasts == 3
    assert mixed.p05_s == pytest.approx(5400.0)
    assert (mixed.p50_s, mixed.never_share) == (np.inf, pytest.approx(2 / 3, abs=0.05))


def test_a_forecast_that_begins_over_the_limit_leaves_no_time() -> None:
    found = time_to([line(90.0, 10.0)], 80.0, 0.2)
    assert found is not None
    assert (found.p05_s, found.p50_s) == (0.0, 0.0)
    between = time_between([line(90.0, 0.0)], 65.0, 80.0)
    assert between is not None
    assert between.p50_s == 0.0


def test_hot_ranks_come_first() -> None:
    found = time_to([line(60.0, 10.0)], 80.0, 0.2)
    assert found is not None
    # 5 % of the normal distribution of which SPREAD holds the quantiles are 1.6 K hotter.
    assert found.p50_s == pytest.approx(7200.0, rel=0.02)
    assert found.p05_s == pytest.approx((80.0 - 60.0 - 1.6) * 360.0, rel=0.03)
    assert time_to([line(60.0, 10.0)], 200.0, 0.2).forecasts == 0  # type: ignore[union-attr]


@settings(max_examples=50, deadline=None)
@given(st.floats(30, 70), st.floats(0, 30), st.floats(0.1, 5), st.floats(0, 20))
def test_a_higher_limit_is_never_reached_sooner(
    start_c: float, k_per_h: float, spread: float, more_k: float
) -> None:
    leads, quantiles = line(start_c, k_per_h, spread)
    low = crossing_times_s(leads, quantiles, 75.0, 0.0)
    high = crossing_times_s(leads, quantiles, 75.0 + more_k, 0.0)
    assert (high >= low - 1e-6).all()
    assert low.size == high.size > len(QUANTILE_LEVELS)
