"""Verification of kept forecasts: did the machine follow their plan, and how good were they.

A forecast is compared with what came only as far as the machine did what it assumed. Whether it did
is judged minute by minute from the measured speed and load.

A plan is often left because the forecast was wrong: a controller stops a machine that becomes too
hot, a sensor fails of the heat. If such forecasts were left out, half of the misses would be. What
is interrupted is therefore compared where the plan was followed last.
"""

from collections.abc import Iterable
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
MEASURED_SHARE = 0.90
"""Share of a run's minutes that must be measured before it counts as inside its band."""
_HELD_ROWS = 5
_LOW, _HIGH, _RUN_LOW, _RUN_HIGH = range(4)


@dataclass(frozen=True, slots=True)
class MinuteCourse:
    """What a machine did in each whole minute of a span, against what was assumed."""

    time_s: FloatArray  # (n,) beginnings of the minutes
    left: NDArray[np.bool_]  # (n,) whether speed or load lay elsewhere
    unknown: NDArray[np.bool_]  # (n,) whether speed or load is not known

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

    @property
    def is_followed(self) -> NDArray[np.bool_]:
        """(n,) minutes in which speed and load are known and as assumed."""
        return ~(self.left | self.unknown)

    def last_followed(self, end_s: float) -> int | None:
        """Row of the last minute up to a time that ends a span over which the plan was followed."""
        ends_s = self.time_s + MINUTE_S
        for row in np.flatnonzero(self.is_followed & (ends_s <= end_s))[::-1]:
            if self.until(float(ends_s[row])) == "followed":
                return int(row)
        return None


@dataclass(frozen=True, slots=True)
class InterruptedReading:
    """A temperature when the plan was followed last, or its sensor measured last."""

    after_s: float  # since the forecast was made
    measured_c: float  # mean of that minute
    low_c: float  # edges of the 95 % band at that time
    high_c: float

    @property
    def is_inside(self) -> bool:
        """Whether it was measured inside the band."""
        return self.low_c <= self.measured_c <= self.high_c


@dataclass(frozen=True, slots=True)
class FollowedBand:
    """Bands of one temperature next to its means of the minutes of a course.

    - ``course``: what the machine did.
    - ``measured_c``: (n,) means of the minutes, NaN where there is none.
    - ``band_c``: (n, 4) edges of the 95 % band and of the band of the whole run, at the middle of
      each minute.
    """

    course: MinuteCourse
    measured_c: FloatArray
    band_c: FloatArray

    def left(self, end_s: float) -> InterruptedReading | None:
        """Of a plan that was left before a time: what the last followed minute was like.

        Where the sensor did not measure then, one of the five minutes before it stands for it.
        """
        last = self.course.last_followed(end_s)
        if last is None:
            return None
        rows = np.arange(max(last - _HELD_ROWS, 0), last + 1)
        return self._last_of(rows[self.course.is_followed[rows]])

    def lost_above(self, end_s: float) -> InterruptedReading | None:
        """Of a sensor that was lost before a time: its last reading, if that was above the band.

        What was lost inside of it does not come of the forecast.
        """
        last = self.course.last_followed(end_s)
        found = None
        if last is not None:
            found = self._last_of(np.flatnonzero(self.course.is_followed[: last + 1]))
        return found if found is not None and found.measured_c > found.high_c else None

    def run_inside(self, end_s: float) -> bool | None:
        """Whether all minutes up to a time lie in the band of the whole run.

        None where none does not, and fewer than nine in ten are measured.
        """
        rows = (self.course.time_s + MINUTE_S <= end_s) & ~self.course.left
        measured_c, band_c = self.measured_c[rows], self.band_c[rows]
        known = np.isfinite(measured_c)
        outside = (measured_c < band_c[:, _RUN_LOW]) | (measured_c > band_c[:, _RUN_HIGH])
        if np.any(outside & known):
            return False
        enough = measured_c.size > 0 and np.mean(known) >= MEASURED_SHARE
        return True if enough else None

    def _last_of(self, rows: NDArray[np.intp]) -> InterruptedReading | None:
        known = rows[np.isfinite(self.measured_c[rows])]
        if known.size == 0:
            return None
        row = known[-1]
        return InterruptedReading(
            float(self.course.time_s[row] + 0.5 * MINUTE_S),
            float(self.measured_c[row]),
            float(self.band_c[row, _LOW]),
            float(self.band_c[row, _HIGH]),
        )


def band_at(times_s: ArrayLike, bands_c: ArrayLike, at_s: FloatArray) -> FloatArray:
    """Bands (m, 4) that are kept at times (m,), linear between these, at times (n,): (n, 4)."""
    times, bands = np.asarray(times_s, np.float64), np.asarray(bands_c, np.float64)
    return np.stack([np.interp(at_s, times, edge) for edge in bands.T], axis=-1)


def kept_rows(time_s: ArrayLike, curves_c: ArrayLike, within_k: ArrayLike) -> list[int]:
    """Rows of curves (k, n) at times (n,) from which the others follow linearly, within (k,) K.

    After Douglas and Peucker: the row that departs most is kept, until none departs by more.
    """
    time = np.asarray(time_s, np.float64)
    curves = np.asarray(curves_c, np.float64) / np.asarray(within_k, np.float64)[:, None]
    kept, spans = {0, time.size - 1}, [(0, time.size - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = slice(first + 1, last)
        share = (time[inner] - time[first]) / (time[last] - time[first])
        ends = curves[:, [first]], curves[:, [last]]
        apart = np.max(np.abs(curves[:, inner] - ends[0] - share * (ends[1] - ends[0])), axis=0)
        worst = int(np.argmax(apart))
        if apart[worst] > 1.0:
            row = first + 1 + worst
            kept.add(row)
            spans += [(first, row), (row, last)]
    return sorted(kept)


def independent_runs(begin_s: Iterable[float], lead_s: float) -> int:
    """How many spans of one length, by their beginnings, can be chosen so that no two overlap.

    Readings of forecasts that overlap share most of their minutes, and are right or wrong together.
    """
    count, end_s = 0, -np.inf
    for one_s in sorted(begin_s):
        if one_s >= end_s:
            count, end_s = count + 1, one_s + lead_s
    return count


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

    `duration_s`, `speed_rpm`, `load_n` (k,) steps that were assumed, from time 0 on; `minute_s`
    (n,) beginnings of minutes that follow each other without a gap, on the same time axis;
    `measured_rpm`, `measured_n` (n,) means of the good values of each; NaN where there is none.
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
    """Value at a time in minutes since the first one began, linear between the means around it.

    `means` (n,) of minutes that follow each other without a gap; NaN where there is none. None
    where the minute that the time lies in has no mean. Where only the other one has none, the mean
    of this one.
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
    """How good forecasts of one kind were; K where it is not a share."""

    n: int
    #: Shares of the measurements inside the 50 % and the 95 % band.
    coverage_50: float
    coverage_95: float
    #: Mean error and mean absolute error of the median; forecast minus measured.
    bias_k: float
    mae_k: float
    crps_k: float  # continuous ranked probability score, from the quantiles
    interval_score_k: float  # of the 95 % band
    #: (5,) shares of the measurements at or below each quantile: those of a reliability diagram.
    below: tuple[float, ...]


def verify(quantiles_c: ArrayLike, measured_c: ArrayLike) -> ForecastScores:
    """Score forecasts against what was measured; see `twin_core.scores`.

    `quantiles_c` (n, 5) at `twin_core.scores.QUANTILE_LEVELS`; `measured_c` (n,) measurements;
    those that are NaN are left out. Raises `ValueError` if the shapes do not belong together.
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
