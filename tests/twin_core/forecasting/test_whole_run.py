"""Bands of whole runs against paths whose law is known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from twin_core.forecasting.whole_run import shares_of_band, whole_run_band, whole_run_factor
from twin_core.scores import QUANTILE_LEVELS, WHOLE_RUN_LEVEL

ROWS = 240


def level(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Paths that differ by one number each, and more so the later it is."""
    return rng.standard_normal((count, 1)) * np.linspace(0.1, 3.0, ROWS)


def noise(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return rng.standard_normal((count, ROWS))


def skewed(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return np.exp(level(rng, count) / 2.0) + 0.05 * noise(rng, count)


def factor_of(members: NDArray[np.float64]) -> NDArray[np.float64]:
    return whole_run_factor(members, np.sort(members.transpose(1, 2, 0), axis=-1))


@pytest.mark.parametrize(
    ("law", "least", "most"),
    [(level, 0.8, 1.0), (noise, 1.7, 2.2), (skewed, 1.0, 1.6)],
    ids=["one number", "noise alone", "skewed"],
)
def test_nine_of_ten_further_runs_stay_inside(law, least: float, most: float) -> None:  # type: ignore[no-untyped-def]
    inside, factors = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        members = law(rng, 200)[:, :, None]
        quantiles = np.quantile(members, QUANTILE_LEVELS, axis=0)
        factor = factor_of(members)
        low, high = whole_run_band(quantiles, factor)[:, :, 0]
        further = law(rng, 500)
        inside.append(np.mean(np.all((further >= low) & (further <= high), axis=1)))
        factors.append(factor[0])
    assert np.mean(inside) == pytest.approx(WHOLE_RUN_LEVEL, abs=0.025)
    assert least < np.mean(factors) < most


def test_a_share_counts_from_the_median_to_the_edge_of_its_side() -> None:
    quantiles = np.array([[8.0], [9.0], [10.0], [12.0], [14.0]])
    shares = [float(shares_of_band(quantiles, [value])[0]) for value in (8, 9, 10, 12, 14, 22)]
    assert_allclose(shares, [1.0, 0.5, 0.0, 0.5, 1.0, 3.0])
    assert np.isnan(shares_of_band(quantiles, [np.nan])[0])
    assert_allclose(whole_run_band(quantiles, [1.5])[:, 0], [7.0, 16.0])


def test_a_few_members_that_run_away_do_not_blow_up_the_band() -> None:
    rng = np.random.default_rng(1)
    calm = level(rng, 200)[:, :, None]
    lost = calm.copy()
    lost[:4] = 500.0  # 2 %, as failed simulations count
    factors = [factor_of(paths)[0] for paths in (calm, lost)]
    assert factors[1] == pytest.approx(factors[0], rel=0.15)
