"""How much wider bands must be so that they hold over whole runs, learned from past forecasts.

Conformal prediction with runs as the exchangeable units (Vovk, Gammerman and Shafer, Algorithmic
Learning in a Random World, 2005; split form): the errors within a run hang together, so that a
thousand minutes of one run are one observation, not a thousand. For every past run the factor is
computed that its band would have needed to hold all but a few of its rows; with n runs the
ceil(level (n + 1))-th smallest of them holds a further run with at least the probability `level`.

The factor is only ever used in the range where the past runs lie. Where the load goes beyond the
trained ones it never narrows a band: past runs of machines that share a friction law would tell
about that law, not about the next machine's.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

HELD = 0.95
"""Share of a run's rows that its band shall hold."""
LEAST_FACTOR = 0.8
"""No calibration narrows a band by more than a fifth: a few dozen runs cannot tell more."""


def run_score(
    quantiles_c: ArrayLike, truth_c: ArrayLike, *, held: float = HELD, rows: slice | None = None
) -> float:
    """Return the factor on the band with which a run would have been held.

    Parameters
    ----------
    quantiles_c
        (3, n): lower edge, median and upper edge of a sensor's forecast in degC.
    truth_c
        (n,) what came; NaN where unknown.
    held
        Share of the rows that the widened band holds.
    rows
        Which rows count, such as those of one regime (rise or steady); default all.

    Raises
    ------
    ValueError
        If shapes differ, a band has no width, or no row is known.
    """
    lower, median, upper = np.asarray(quantiles_c, dtype=np.float64)
    truth = np.asarray(truth_c, dtype=np.float64)
    if truth.shape != median.shape:
        raise ValueError(f"truth_c has shape {truth.shape}, expected {median.shape}")
    known = np.zeros(truth.shape, dtype=np.bool_)
    known[slice(None) if rows is None else rows] = True
    known &= np.isfinite(truth)
    if not np.any(known):
        raise ValueError("truth_c: no known row, expected at least one")
    error = truth - median
    side = np.where(error >= 0.0, upper - median, median - lower)[known]
    if not np.all(side > 0.0):
        raise ValueError("quantiles_c: a band without width, expected lower < median < upper")
    needed = np.sort(np.abs(error[known]) / side)
    return float(needed[max(int(np.ceil(held * needed.size)) - 1, 0)])


def conformal_factor(run_scores: Sequence[float], *, level: float = 0.9) -> float:
    """Return the factor that holds a further run with probability ``level``; infinite if too few.

    Parameters
    ----------
    run_scores
        Of past runs, each from `run_score`, all of one sensor and one regime.
    level
        Probability, below 1.

    Raises
    ------
    ValueError
        If ``level`` does not lie between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"level is {level}, expected a number between 0 and 1")
    rank = int(np.ceil(level * (len(run_scores) + 1)))
    return float(sorted(run_scores)[rank - 1]) if rank <= len(run_scores) else float("inf")


def calibrated(quantiles_c: ArrayLike, factor: float, *, beyond_trained_load: bool) -> FloatArray:
    """Return a forecast's quantiles (q, n), stretched about the median in their middle row.

    Parameters
    ----------
    quantiles_c
        (q, n), q odd, ascending.
    factor
        From `conformal_factor`. An infinite one, from too few runs, changes nothing.
    beyond_trained_load
        Whether loads beyond the trained ones lie ahead; the band is then never narrowed.

    Raises
    ------
    ValueError
        If q is even or the factor is not positive.
    """
    quantiles = np.asarray(quantiles_c, dtype=np.float64)
    if len(quantiles) % 2 == 0:
        raise ValueError(f"quantiles_c has {len(quantiles)} rows, expected an odd number")
    if not factor > 0.0:
        raise ValueError(f"factor is {factor}, expected a positive number")
    if not np.isfinite(factor):
        return quantiles
    median = quantiles[len(quantiles) // 2]
    stretch = max(factor, 1.0 if beyond_trained_load else LEAST_FACTOR)
    return np.asarray(median + stretch * (quantiles - median))
