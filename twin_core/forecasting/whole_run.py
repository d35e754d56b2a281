"""Bands that a whole run stays inside, beside those that hold moment by moment.

A 95 % band of each moment is left now and then: of many runs that all its readings lie inside, far
fewer than 95 % do. What an operator means by "it stays inside" is the whole run. The band for that
is the one of each moment, made wider (or narrower) by one factor about its median, so that 90 % of
the ensemble's members stay inside with all of their readings, noise included.
"""

from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.scores import QUANTILE_LEVELS, WHOLE_RUN_LEVEL

FloatArray = NDArray[np.float64]

_LEAST_K = 1e-6


def shares_of_band(quantiles_c: FloatArray, values_c: ArrayLike) -> FloatArray:
    """How far values lie from the median, as parts of the 95 % band's width on their side.

    `quantiles_c` (5, ...) at `twin_core.scores.QUANTILE_LEVELS`; `values_c`: readings of the
    quantiles' last axes, or members of such in front of them. Returns 1 on the edge of the band;
    NaN where there is no reading.
    """
    low, _, median, _, high = quantiles_c
    return _shares(median, low, high, np.asarray(values_c, np.float64))


def whole_run_factor(members_c: FloatArray, ordered_c: FloatArray) -> FloatArray:
    """Factor on the 95 % band of each moment with which it holds 90 % of the members wholly.

    `members_c` (members, n, sensors) readings, with their noise; `ordered_c` (n, sensors, members)
    the same, sorted along the last axis. Returns (sensors,). Of so many members that of further
    ones 90 % stay inside, as in conformal prediction.
    """
    # A member beyond an edge has helped to put it there: that of the others is one further in.
    count = len(members_c)
    low, high = (round(level * (count - 1)) for level in (QUANTILE_LEVELS[0], QUANTILE_LEVELS[-1]))
    centre = 0.5 * (ordered_c[..., (count - 1) // 2] + ordered_c[..., count // 2])
    low, high = min(low + 1, (count - 1) // 2), max(high - 1, count // 2)
    of_others = centre, ordered_c[..., low], ordered_c[..., high]
    worst = np.max(_shares(*of_others, members_c), axis=1)
    rank = min(ceil(WHOLE_RUN_LEVEL * (len(worst) + 1) - 1e-9), len(worst))
    return np.asarray(np.partition(worst, rank - 1, axis=0)[rank - 1])


def whole_run_band(quantiles_c: FloatArray, factor: ArrayLike) -> FloatArray:
    """Lower and upper edge (2, ...) of the band of the whole run, degC.

    `quantiles_c` (5, ...) of each moment; `factor`: on the distance of the 95 % band's edges from
    the median; of the quantiles' last axes.
    """
    low, _, median, _, high = quantiles_c
    wide = np.asarray(factor, np.float64)
    return np.stack((median - wide * (median - low), median + wide * (high - median)))


def _shares(
    median: FloatArray, low: FloatArray, high: FloatArray, values: FloatArray
) -> FloatArray:
    below = values - median
    above = below * (1.0 / np.maximum(high - median, _LEAST_K))
    below *= -1.0 / np.maximum(median - low, _LEAST_K)
    return np.asarray(np.maximum(above, below, out=above))
