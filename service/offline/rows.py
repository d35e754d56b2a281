"""Recorded rows brought to the spacing that the twin works at, and cut where data are missing.

A row's operating point holds from its time to the next row's; its temperatures are instantaneous
at its time. Rows that come faster than the twin needs them are averaged accordingly: the operating
point over the step that begins at a mark, temperatures around the mark. A bearing needs one row per
minute; a network of one's own may have a body that is faster.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.offline.tables import FloatArray, Recording
from service.site.machines.machine import Machine
from twin_core.minute_rows import MINUTE_S, StepMeans, minute_rows, row_step_s
from twin_core.models import ThermalModel
from twin_core.time_constants import fastest_time_s
from twin_core.windows import MinuteData

# Rows that come faster than this part of a step are averaged; a little jitter is not faster.
_FAST = 50.0 / 60.0
# Readings further apart than this say nothing about the time between them.
_LONGEST_STEP_S = 3.0 * MINUTE_S
_LEAST_KNOWN = 0.5
_AMBIENT_GAP_S = 3600.0
_MISSING_ROWS = 3


def step_of(recording: Recording, machine: Machine, model: ThermalModel) -> float:
    """Step in s for a recording of a machine: a minute for a bearing, else as its network needs."""
    if machine.network is None or recording.time_s.size < 3:
        return MINUTE_S
    spacing_s = float(np.median(np.diff(recording.time_s)))
    duration_s = float(recording.time_s[-1] - recording.time_s[0])
    return row_step_s(fastest_time_s(model), spacing_s, duration_s)


def step_ahead(machine: Machine, model: ThermalModel) -> float:
    """Longest step in s of a forecast of a machine."""
    return MINUTE_S if machine.network is None else row_step_s(fastest_time_s(model), 0.0, 0.0)


def rows_of_recording(recording: Recording, step_s: float = MINUTE_S) -> MinuteData:
    """Rows of a recording at the twin's spacing; slow or irregular ones stay as they are.

    The last row is always that of the recording's last time.

    - ``step_s``: what faster rows are averaged to; see `step_of`.
    """
    time_s = recording.time_s
    fast = time_s.size > 2 and float(np.median(np.diff(time_s))) < _FAST * step_s
    operating = {
        "speed_rpm": recording.speed_rpm,
        "load_n": recording.load_n,
        "ambient_c": _bridged(time_s, recording.ambient_c),
        **recording.inputs,
    }
    temperatures = recording.temperatures_c
    if fast:
        marks = np.arange(time_s[0], time_s[-1] + 1e-6, step_s)
        if time_s[-1] - marks[-1] > 1.0:
            marks = np.append(marks, time_s[-1])
        marks[-1] = time_s[-1]
        operating = {
            name: mean_input(time_s, values, marks, name in recording.mean_square)
            for name, values in operating.items()
        }
        temperatures = {
            name: mean_around(time_s, values, marks, step_s / 2.0)
            for name, values in temperatures.items()
        }
        time_s = marks
    return minute_rows(StepMeans(time_s, operating), StepMeans(time_s, temperatures))


def mean_input(
    time_s: FloatArray,
    values: FloatArray,
    marks_s: FloatArray,
    mean_square: bool,
    longest_s: float = _LONGEST_STEP_S,
) -> FloatArray:
    """Mean over each step as `mean_from`; of a current (mean square) the one that heats as much."""
    if not mean_square:
        return mean_from(time_s, values, marks_s, longest_s)
    return np.asarray(np.sqrt(mean_from(time_s, values**2, marks_s, longest_s)))


def mean_from(
    time_s: FloatArray,
    values: FloatArray,
    marks_s: FloatArray,
    longest_s: float = _LONGEST_STEP_S,
) -> FloatArray:
    """Mean of a held quantity from each mark to the next; at the last mark its value there.

    Shape (m,); NaN where less than half of the time is known.

    - ``time_s``, ``values``: (n,) each value holds until the next time; NaN is unknown.
    - ``marks_s``: (m,) ascending, the last of them the last time.
    - ``longest_s``: how long a value holds at most; three minutes for what was measured.
    """
    held_s = np.append(np.minimum(np.diff(time_s), longest_s), 0.0)
    known = np.isfinite(values)
    # Both integrals rise while a value holds and stay constant between.
    corners = np.stack((time_s, time_s + held_s), axis=1).ravel()
    known_s = _integral(np.where(known, held_s, 0.0))
    total = _integral(np.where(known, np.nan_to_num(values) * held_s, 0.0))
    span_s = np.diff(np.interp(marks_s, corners, known_s))
    rise = np.diff(np.interp(marks_s, corners, total))
    enough = span_s >= _LEAST_KNOWN * np.diff(marks_s)
    means = np.full(marks_s.size, np.nan)
    means[:-1][enough] = rise[enough] / span_s[enough]
    means[-1] = values[-1]
    return means


def _integral(parts: FloatArray) -> FloatArray:
    """Values at the beginning and the end of every part, (2 n,)."""
    ends = np.cumsum(parts)
    return np.stack((ends - parts, ends), axis=1).ravel()


def mean_around(
    time_s: FloatArray, values: FloatArray, marks_s: FloatArray, half_window_s: float = 30.0
) -> FloatArray:
    """Mean of an instantaneous quantity over half a step before and after each mark.

    The mean is that of straight lines between the readings. Near the ends of the readings the span
    shrinks on both sides, so that a steady rise moves no mean. Shape (m,); NaN outside the
    readings, and between two that are more than three minutes apart.

    - ``time_s``, ``values``: (n,) readings; NaN is none.
    - ``marks_s``: (m,) ascending.
    - ``half_window_s``: half a step.
    """
    known = np.isfinite(values)
    means = np.full(marks_s.size, np.nan)
    at_s, level = time_s[known], values[known]
    if at_s.size == 0:
        return means
    if at_s.size == 1:
        means[marks_s == at_s[0]] = level[0]
        return means
    area = np.concatenate(([0.0], np.cumsum(0.5 * (level[1:] + level[:-1]) * np.diff(at_s))))

    def integral(until_s: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(at_s, until_s, side="right") - 1, 0, at_s.size - 1)
        return np.asarray(
            area[k] + 0.5 * (level[k] + np.interp(until_s, at_s, level)) * (until_s - at_s[k])
        )

    half_s = np.minimum(half_window_s, np.minimum(marks_s - at_s[0], at_s[-1] - marks_s))
    before = np.clip(np.searchsorted(at_s, marks_s, side="right") - 1, 0, at_s.size - 2)
    near = (at_s[before + 1] - at_s[before] <= _LONGEST_STEP_S) | np.isin(marks_s, at_s)
    wide = near & (half_s > 1e-3)
    point = near & (half_s >= 0.0) & ~wide
    low, high = marks_s[wide] - half_s[wide], marks_s[wide] + half_s[wide]
    means[wide] = (integral(high) - integral(low)) / (high - low)
    means[point] = np.interp(marks_s[point], at_s, level)
    return means


def _bridged(time_s: FloatArray, ambient_c: FloatArray) -> FloatArray:
    """Ambient with gaps of up to an hour filled: air indoors does not jump."""
    known = np.flatnonzero(np.isfinite(ambient_c))
    if known.size in (0, ambient_c.size):
        return ambient_c
    filled = np.interp(time_s, time_s[known], ambient_c[known])
    after = np.searchsorted(known, np.arange(time_s.size))
    left = known[np.maximum(after - 1, 0)]
    right = known[np.minimum(after, known.size - 1)]
    # At the ends there is a neighbour on one side only: from there on the hour counts.
    near = np.abs(time_s[right] - time_s[left]) <= _AMBIENT_GAP_S
    near &= np.minimum(np.abs(time_s - time_s[left]), np.abs(time_s - time_s[right])) <= (
        _AMBIENT_GAP_S
    )
    return np.where(np.isfinite(ambient_c) | near, filled, np.nan)


def longest_step_s(minutes: MinuteData) -> float:
    """Longest time between two good rows of one window: three rows may be missing.

    A row is what nine of ten steps do not exceed, so that rows that were written irregularly are
    not torn apart.
    """
    if minutes.size < 2:
        return _LONGEST_STEP_S
    usual_s = float(np.quantile(np.diff(minutes.time_s), 0.9))
    return (_MISSING_ROWS + 1.5) * max(usual_s, MINUTE_S)


def contiguous(minutes: MinuteData) -> list[MinuteData]:
    """Good rows, cut into windows where more than three rows in a row are missing or bad."""
    good = minutes.take(minutes.good)
    if good.size == 0:
        return []
    cuts = np.flatnonzero(np.diff(good.time_s) > longest_step_s(minutes)) + 1
    edges = [0, *(int(cut) for cut in cuts), good.size]
    return [good.take(slice(a, b)) for a, b in pairwise(edges)]


def revolutions_at(minutes: MinuteData) -> NDArray[np.float64]:
    """Revolutions of the shaft from the first row to every good row, (good rows,).

    What the shaft did while nothing was recorded is not counted.
    """
    good = minutes.take(minutes.good)
    held_s = np.minimum(np.diff(good.time_s), longest_step_s(minutes))
    turned = np.abs(good.speed_rpm[:-1]) * held_s / 60.0
    return np.concatenate(([0.0], np.cumsum(turned)))[: good.size]
