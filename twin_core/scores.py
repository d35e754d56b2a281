"""Scores of point and interval forecasts. Temperatures in degC, errors and scores in K.

``fitness``, ``r_squared`` and ``euclidean_distance`` are those of Wang et al., Appl. Sci. 2025,
15(12), 6671: its equation (25), its figures 12 and 17, its tables 6 and 7. Fitness and distance
grow with the number of rows, and R2 with the spread of what was measured, so none of them compares
between runs of different lengths or stages; RMS, coverage, interval score and CRPS do.

Interval score and CRPS after Gneiting and Raftery, J. Am. Stat. Assoc. 102 (2007) 359,
doi 10.1198/016214506000001437: equations (43) and (21). Rows whose measurement is NaN are left out
everywhere.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

QUANTILE_LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)
"""At which forecasts give quantiles."""

WHOLE_RUN_LEVEL = 0.90
"""Share of runs that stay inside a forecast's band of the whole run with all of their readings."""


def _errors(forecast_c: ArrayLike, measured_c: ArrayLike) -> FloatArray:
    forecast, measured = np.asarray(forecast_c, float), np.asarray(measured_c, float)
    if forecast.shape != measured.shape:
        raise ValueError(f"forecast {forecast.shape} and measured {measured.shape} differ in shape")
    return np.asarray((forecast - measured)[~np.isnan(measured)])


def bias(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the mean of forecast minus measured, NaN without a measurement."""
    errors = _errors(forecast_c, measured_c)
    return float(np.mean(errors)) if errors.size else float("nan")


def mean_absolute_error(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the mean absolute error, NaN without a measurement.

    Of a forecast without a spread it is the CRPS as well.
    """
    errors = _errors(forecast_c, measured_c)
    return float(np.mean(np.abs(errors))) if errors.size else float("nan")


def rms(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the root mean square error, NaN without a measurement."""
    errors = _errors(forecast_c, measured_c)
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")


def fitness(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the sum of absolute errors in K over all rows and sensors, NaN without a measurement.

    Equation (25) of the paper, whose modulus bars got lost in print.
    """
    errors = _errors(forecast_c, measured_c)
    return float(np.sum(np.abs(errors))) if errors.size else float("nan")


def euclidean_distance(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the root of the sum of squared errors (n,) in K, NaN without a measurement.

    The paper's distance between two curves (its section 5.2.2): RMS times the root of their length.
    """
    errors = _errors(forecast_c, measured_c)
    return float(np.sqrt(np.sum(errors**2))) if errors.size else float("nan")


def r_squared(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return 1 minus squared errors over squared deviations of the measurements from their mean.

    Of one sensor, (n,). 1 is perfect, 0 no better than the measurements' own mean, and it has no
    lower limit. NaN for fewer than two measurements or constant ones.
    """
    errors = _errors(forecast_c, measured_c)
    measured = np.asarray(measured_c, float)
    measured = measured[~np.isnan(measured)]
    if measured.size < 2 or np.ptp(measured) == 0.0:
        return float("nan")
    return float(1.0 - np.sum(errors**2) / np.sum((measured - np.mean(measured)) ** 2))


def max_error(forecast_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the largest absolute error, NaN without a measurement."""
    errors = _errors(forecast_c, measured_c)
    return float(np.max(np.abs(errors))) if errors.size else float("nan")


def coverage(lower_c: ArrayLike, upper_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the share of the measurements inside [lower, upper], NaN without a measurement."""
    lower, upper = np.asarray(lower_c, float), np.asarray(upper_c, float)
    measured = np.asarray(measured_c, float)
    known = ~np.isnan(measured)
    if not np.any(known):
        return float("nan")
    inside = (measured >= lower) & (measured <= upper)
    return float(np.mean(inside[known]))


def interval_score(
    lower_c: ArrayLike, upper_c: ArrayLike, measured_c: ArrayLike, level: float = 0.95
) -> float:
    """Return the mean interval score of a central ``level`` band: width plus penalty outside."""
    lower, upper = np.asarray(lower_c, float), np.asarray(upper_c, float)
    measured = np.asarray(measured_c, float)
    penalty = 2.0 / (1.0 - level)
    below = np.maximum(lower - measured, 0.0)
    above = np.maximum(measured - upper, 0.0)
    score = upper - lower + penalty * (below + above)
    known = ~np.isnan(measured)
    return float(np.mean(score[known])) if np.any(known) else float("nan")


def crps_from_members(members_c: ArrayLike, measured_c: ArrayLike) -> float:
    """Return the mean continuous ranked probability score of an ensemble (m, n), finite, in K.

    CRPS = E|X - y| - E|X - X'| / 2, both X over the members; `measured_c` (n,).
    """
    members = np.sort(np.asarray(members_c, float), axis=0)
    measured = np.asarray(measured_c, float)
    count = len(members)
    distance = np.mean(np.abs(members - measured), axis=0)
    weights = 2.0 * np.arange(1, count + 1) - count - 1.0
    spread = np.asarray(weights @ members) / count**2
    score = distance - spread
    known = ~np.isnan(measured)
    return float(np.mean(score[known])) if np.any(known) else float("nan")


def crps_from_quantiles(
    quantiles_c: ArrayLike, levels: Sequence[float], measured_c: ArrayLike
) -> float:
    """Return the mean CRPS approximated from quantiles (q, n), as the weighted pinball loss.

    `levels` (q,) ascending in (0, 1); each stands for the levels nearest to it. `measured_c` (n,).
    """
    quantiles, measured = np.asarray(quantiles_c, float), np.asarray(measured_c, float)
    level = np.asarray(levels, float)
    edges = np.concatenate([[0.0], (level[1:] + level[:-1]) / 2.0, [1.0]])
    errors = measured - quantiles
    pinball = np.maximum(level[:, None] * errors, (level[:, None] - 1.0) * errors)
    score = 2.0 * np.asarray(np.diff(edges) @ pinball)
    known = ~np.isnan(measured)
    return float(np.mean(score[known])) if np.any(known) else float("nan")
