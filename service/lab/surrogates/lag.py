"""How temperatures approach their steady values: the linear part that all surrogates share.

With E the sensors' excesses over ambient (a row vector), the machine is taken as

    dE/dt = (E - S(speed, load)) M

where M, of one row and column per sensor, is the same at every operating point and S is what a
surrogate maps. Both are estimated in integral form, over spans of ten minutes:

    (E(t + h) - E(t)) / h = mean of E over the span times M + f,     f = -S M

with one free f per operating point, so that no assumption on S enters M. The mean over a span
carries a tenth of the noise of a reading; one-minute differences would not. As M is stable by
construction, no surrogate can run away, however long it runs free.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

_SPAN_S = 600.0
_LONGEST_SPAN_S = 1500.0
# Spans belong to one operating point when speed and load are within this share of their maxima.
_SAME_POINT = 0.04
# A point must have been held for this many spans to be one.
_FEWEST_SPANS = 5
# Of data that wander about, the points held longest are enough: methods get slow with more.
_MOST_POINTS = 40
# Weight of "every sensor for itself, one hour" in the estimate of M, as a share of its information.
_RIDGE = 0.01
_PRIOR_S = 3600.0
_SLOWEST_S = 12.0 * 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class LaggedPoints:
    """The common lag, and the steady values of the operating points that were seen.

    Attributes
    ----------
    sensors
        Names, s of them.
    points
        (g, 2) speed in krpm and load in kN.
    steady_k
        (g, s) steady excess over ambient at each point.
    spans
        (g,) number of spans that each rests on.
    generator_per_s
        (s, s) M; every eigenvalue's real part is negative.
    """

    sensors: tuple[str, ...]
    points: FloatArray
    steady_k: FloatArray
    spans: NDArray[np.int64]
    generator_per_s: FloatArray


def fit_lag(windows: Sequence[MinuteData]) -> LaggedPoints:
    """Estimate the lag and the steady values of the operating points.

    Raises
    ------
    ValueError
        Without windows, where they differ in their sensors, or where no operating point was held
        for a quarter of an hour with all sensors known.
    """
    if not windows:
        raise ValueError("no windows, expected at least one")
    sensors = windows[0].sensors
    if any(window.sensors != sensors for window in windows):
        raise ValueError("the windows differ in their sensors")
    spans = [span for window in windows for span in _spans(window)]
    if not spans:
        raise ValueError("no ten minutes in a row with all sensors known, expected some")
    table = np.array(spans)
    inputs, level, slope = np.split(table, [2, 2 + len(sensors)], axis=1)
    group = _groups(inputs)
    count = np.bincount(group)
    longest = np.sort(np.argsort(-count, kind="stable")[:_MOST_POINTS])
    lasting = longest[count[longest] >= _FEWEST_SPANS]
    if lasting.size == 0:
        raise ValueError("no operating point was held for a quarter of an hour, expected one")

    def mean(values: FloatArray) -> FloatArray:
        return np.stack([values[group == number].mean(axis=0) for number in lasting])

    points, levels, slopes = mean(inputs), mean(level), mean(slope)
    row_of = np.full(count.size, -1)
    row_of[lasting] = np.arange(lasting.size)
    used = row_of[group] >= 0
    own = row_of[group[used]]
    generator = _generator(level[used] - levels[own], slope[used] - slopes[own])
    steady = levels - slopes @ np.linalg.inv(generator)
    return LaggedPoints(sensors, points, steady, count[lasting], generator)


def _generator(level: FloatArray, slope: FloatArray) -> FloatArray:
    """Regress slopes on levels, both (n, s) about the means of their operating points."""
    sensors = level.shape[1]
    information = level.T @ level
    ridge = _RIDGE * np.trace(information) / sensors + 1e-12
    prior = -np.eye(sensors) / _PRIOR_S
    generator = prior + np.linalg.solve(
        information + ridge * np.eye(sensors), level.T @ (slope - level @ prior)
    )
    fastest_growth = float(np.max(np.linalg.eigvals(generator).real))
    shift = max(fastest_growth + 1.0 / _SLOWEST_S, 0.0)
    return np.asarray(generator - shift * np.eye(sensors))


def _spans(window: MinuteData) -> list[FloatArray]:
    """Rows (2 + 2 s): mean speed, mean load, mean excesses and their slopes over each span."""
    rows = window.take(window.good)
    excess = np.stack([rows.temperatures_c[name] - rows.ambient_c for name in rows.sensors], axis=1)
    rows = rows.take(np.all(np.isfinite(excess), axis=1))
    excess = excess[np.all(np.isfinite(excess), axis=1)]
    if rows.size < 2:
        return []
    step_s = np.diff(rows.time_s)
    inputs = np.stack([np.abs(rows.speed_rpm), np.maximum(rows.load_n, 0.0)], axis=1) / 1e3
    # A row's operating point holds to the next row, its temperatures are those of its time.
    held = np.cumsum(np.vstack([np.zeros(2), inputs[:-1] * step_s[:, None]]), axis=0)
    trapezoid = 0.5 * (excess[1:] + excess[:-1]) * step_s[:, None]
    area = np.cumsum(np.vstack([np.zeros(excess.shape[1]), trapezoid]), axis=0)
    ends = np.searchsorted(rows.time_s, rows.time_s + _SPAN_S - 1e-6)
    found = []
    for first, end in enumerate(ends):
        if end == rows.size:
            break
        length_s = rows.time_s[end] - rows.time_s[first]
        if length_s > _LONGEST_SPAN_S:
            continue
        found.append(
            np.concatenate(
                [
                    (held[end] - held[first]) / length_s,
                    (area[end] - area[first]) / length_s,
                    (excess[end] - excess[first]) / length_s,
                ]
            )
        )
    return found


def _groups(inputs: FloatArray) -> NDArray[np.int64]:
    """Number (n,) of the operating point of every span: that of the first span like it."""
    scaled = inputs / np.maximum(inputs.max(axis=0), 1e-9)
    leaders = np.empty_like(scaled)
    group = np.empty(len(scaled), dtype=np.int64)
    count = 0
    for row, values in enumerate(scaled):
        apart = np.max(np.abs(leaders[:count] - values), axis=1)
        near = np.flatnonzero(apart <= _SAME_POINT)
        if near.size:
            group[row] = near[0]
        else:
            leaders[count], group[row] = values, count
            count += 1
    return group


def approach(
    profile: OperatingProfile, start_k: FloatArray, steady_k: FloatArray, generator: FloatArray
) -> FloatArray:
    """Run excesses from ``start_k`` (s,) towards ``steady_k`` (n, s) along a profile: (n, s)."""
    path = np.empty_like(steady_k)
    path[0] = start_k
    keep: dict[float, FloatArray] = {}
    for row, (now_s, then_s) in enumerate(pairwise(profile.time_s.tolist())):
        step_s = round(then_s - now_s, 6)
        if step_s not in keep:
            keep[step_s] = expm(step_s * generator)
        path[row + 1] = steady_k[row] + (path[row] - steady_k[row]) @ keep[step_s]
    return path


def inputs_of(profile: OperatingProfile) -> FloatArray:
    """Speed in krpm and load in kN, (n, 2)."""
    speed = np.abs(profile.speed_rpm)
    load = np.maximum(profile.load_n, 0.0)
    return np.stack([speed, load], axis=1) / 1e3
