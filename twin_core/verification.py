"""Verification of kept forecasts: did the machine follow their plan, and how good were they.

A forecast is compared with what came only as far as the machine did what it assumed. Whether it did
is judged minute by minute from the measured speed and load.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.scores import (
    QUANTILE_LEVELS,
    bias,
    coverage,
    crps_from_quantiles,
    interval_score,
    mean_absolute_error,
)

FloatArray = NDArray[np.float64]
Course = Literal["followed", "left", "unknown"]

LEAD_TIMES_S = (300, 600, 1800, 3600, 7200, 14400)
"""How far ahead forecasts are compared with what came."""
MINUTE_S = 60.0
SHIFT_S = 120.0
"""By so much a step may begin earlier or later than was assumed."""
FOLLOWED_PART, FOLLOWED_RPM, FOLLOWED_N = 0.05, 30.0, 50.0
"""How far from the assumed speed and load a machine still follows: a part of it, or so much."""
LEFT_SHARE = 0.05
"""Share of the minutes that may lie elsewhere: a spike, a ramp, a short stop."""
LAST_S = 1800.0
"""The last part of a span, in which the machine must have followed the plan as well."""
UNKNOWN_SHARE = 0.10
"""Share of the minutes whose speed or load may be unknown."""
_HELD_ROWS = 5


@dataclass(frozen=True, slots=True)
class MinuteCourse:
    """What a machine did in each whole minute of a span, against what was assumed.

    Attributes
    ----------
    time_s
        (n,) beginnings of the minutes.
    left
        (n,) whether speed or load lay elsewhere.
    unknown
        (n,) whether speed or load is not known.
    """

    time_s: FloatArray
    left: NDArray[np.bool_]
    unknown: NDArray[np.bool_]

    def until(self, end_s: float) -> Course:
        """Say whether the machine followed the plan from time 0 to a time.

        It did where it did over the whole span and over its last half hour: what came just before
        counts most. Whole minutes count; a span without one counts as followed.
        """
        verdict: Course = "followed"
        for start_s in (0.0, max(end_s - LAST_S, 0.0)):
            inside = (self.time_s >= start_s) & (self.time_s + MINUTE_S <= end_s)
            count = int(np.count_nonzero(inside))
            if int(np.count_nonzero(self.left & inside)) > LEFT_SHARE * count:
                return "left"
            if int(np.count_nonzero(self.unknown & inside)) > UNKNOWN_SHARE * count:
                verdict = "unknown"
        return verdict


def minute_course(
    duration_s: ArrayLike,
    speed_rpm: ArrayLike,
    load_n: ArrayLike,
    minute_s: ArrayLike,
    measured_rpm: ArrayLike,
    measured_n: ArrayLike,
) -> MinuteCourse:
    """Compare measured speed and load with the plan that a forecast assumed.

    A minute follows where its means lie within 5 % (or 30 rpm, 50 N) of what was assumed at any
    time within two minutes before and after it. A minute without a mean takes that of one of the
    five minutes before it: speed and load then stay what they were, as for the twin.

    Parameters
    ----------
    duration_s, speed_rpm, load_n
        (k,) steps that were assumed, from time 0 on.
    minute_s
        (n,) beginnings of minutes that follow each other without a gap, on the same time axis.
    measured_rpm, measured_n
        (n,) means of the good values of each; NaN where there is none.
    """
    begin_s = np.asarray(minute_s, np.float64)
    ends_s = np.cumsum(np.asarray(duration_s, np.float64))
    starts_s = np.concatenate(([-np.inf], ends_s[:-1]))
    ends_s = np.concatenate((ends_s[:-1], [np.inf]))
    meant = (starts_s < begin_s[:, None] + MINUTE_S + SHIFT_S) & (
        ends_s > begin_s[:, None] - SHIFT_S
    )
    left = np.zeros(begin_s.size, np.bool_)
    unknown = np.zeros(begin_s.size, np.bool_)
    for assumed, measured, least in (
        (speed_rpm, measured_rpm, FOLLOWED_RPM),
        (load_n, measured_n, FOLLOWED_N),
    ):
        levels = np.asarray(assumed, np.float64)
        # Friction does not ask for the direction of rotation, and no load is negative.
        values = _held(np.abs(np.asarray(measured, np.float64)))
        low = np.min(np.where(meant, levels, np.inf), axis=1, initial=np.inf)
        high = np.max(np.where(meant, levels, -np.inf), axis=1, initial=-np.inf)
        unknown |= np.isnan(values)
        with np.errstate(invalid="ignore"):
            left |= values < low - np.maximum(FOLLOWED_PART * low, least)
            left |= values > high + np.maximum(FOLLOWED_PART * high, least)
    return MinuteCourse(begin_s, left, unknown)


def _held(values: FloatArray) -> FloatArray:
    """Values with NaN replaced by the last known one of a few rows before."""
    rows = np.arange(values.size)
    known = np.maximum.accumulate(np.where(np.isnan(values), -_HELD_ROWS - 1, rows))
    near = rows - known <= _HELD_ROWS
    return np.where(near, values[np.maximum(known, 0)], np.nan)


def value_at(means: ArrayLike, minute: float) -> float | None:
    """Value at a time, linear between the means of the minutes around it.

    Parameters
    ----------
    means
        (n,) means of minutes that follow each other without a gap; NaN where there is none.
    minute
        The time, in minutes from the beginning of the first.

    Returns
    -------
    float or None
        None where the minute that the time lies in has no mean. Where only the other one has none,
        the mean of this one.
    """
    values = np.asarray(means, np.float64)
    own = int(np.floor(minute))
    if not 0 <= own < values.size or not np.isfinite(values[own]):
        return None
    off = minute - own - 0.5
    other = own + (1 if off > 0.0 else -1)
    if not 0 <= other < values.size or not np.isfinite(values[other]):
        return float(values[own])
    return float(values[own] + abs(off) * (values[other] - values[own]))


@dataclass(frozen=True, slots=True)
class ForecastScores:
    """How good forecasts of one kind were; K where it is not a share.

    Attributes
    ----------
    n
        How many there are.
    coverage_50, coverage_95
        Shares of the measurements inside the 50 % and the 95 % band.
    bias_k, mae_k
        Mean error and mean absolute error of the median; forecast minus measured.
    crps_k
        Continuous ranked probability score, from the quantiles.
    interval_score_k
        Of the 95 % band.
    below
        (5,) shares of the measurements at or below each quantile: those of a reliability diagram.
    """

    n: int
    coverage_50: float
    coverage_95: float
    bias_k: float
    mae_k: float
    crps_k: float
    interval_score_k: float
    below: tuple[float, ...]


def verify(quantiles_c: ArrayLike, measured_c: ArrayLike) -> ForecastScores:
    """Score forecasts against what was measured; see `twin_core.scores`.

    Parameters
    ----------
    quantiles_c
        (n, 5) at `twin_core.scores.QUANTILE_LEVELS`.
    measured_c
        (n,) measurements; those that are NaN are left out.

    Raises
    ------
    ValueError
        If the shapes do not belong together.
    """
    quantiles, measured = np.asarray(quantiles_c, float), np.asarray(measured_c, float)
    if quantiles.shape != (measured.size, len(QUANTILE_LEVELS)):
        raise ValueError(
            f"quantiles {quantiles.shape}, expected {(measured.size, len(QUANTILE_LEVELS))}"
        )
    low, lower, median, upper, high = quantiles.T
    return ForecastScores(
        n=int(np.count_nonzero(~np.isnan(measured))),
        coverage_50=coverage(lower, upper, measured),
        coverage_95=coverage(low, high, measured),
        bias_k=bias(median, measured),
        mae_k=mean_absolute_error(median, measured),
        crps_k=crps_from_quantiles(quantiles.T, QUANTILE_LEVELS, measured),
        interval_score_k=interval_score(low, high, measured),
        below=tuple(coverage(np.full(edge.shape, -np.inf), edge, measured) for edge in quantiles.T),
    )
