"""Products on vector registers against numpy."""

import numpy as np
import pytest
from numba import njit

from twin_core.simulation.vectors import LANES, STRIDE, advance, combine


@njit
def _combine(out, weights, rows):  # type: ignore[no-untyped-def]
    combine(out, weights, rows)


@njit
def _advance(out, factor, weights, rows):  # type: ignore[no-untyped-def]
    advance(out, factor, out, weights, rows)


@pytest.mark.parametrize("count", [0, STRIDE, 5 * STRIDE])
@pytest.mark.parametrize("width", [LANES, 3 * LANES])
def test_sums_of_weighted_rows(count: int, width: int) -> None:
    rng = np.random.default_rng(width + count)
    weights, rows = rng.normal(size=count), rng.normal(size=(count, width))
    start, factor = rng.normal(size=(2, width))
    out = np.full(width, np.nan)
    _combine(out, weights, rows)
    assert out == pytest.approx(weights @ rows, abs=1e-13)
    out = start.copy()
    _advance(out, factor, weights, rows)
    assert out == pytest.approx(factor * start + weights @ rows, abs=1e-13)


def test_what_is_not_finite_is_not_lost() -> None:
    out = np.zeros(LANES)
    _combine(out, np.array([0.0, np.nan, 0.0, 0.0]), np.ones((STRIDE, LANES)))
    assert np.isnan(out).all()
