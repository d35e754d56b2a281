"""Minute rows: what was measured, brought to the spacing that the twin works at.

A row has the mean operating point over the step that begins at its time, its mark, and the mean
temperatures over the step around it. A caller has the means, from a store, a file or a virtual
bench, makes his rows here. A bearing needs one row per minute; a network of one's own may have a
body that is faster.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MINUTE_S = 60.0
# Steps there are, and how many of them a time constant should have at least.
ROW_STEPS_S = (60.0, 30.0, 20.0, 15.0, 10.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0)
_STEPS_PER_TIME_CONSTANT = 5.0
# More rows than this take a longer step: time and memory grow with them.
MOST_ROWS = 20_000
_OPERATING_POINT = ("speed_rpm", "load_n", "ambient_c")


@dataclass(frozen=True, slots=True, eq=False)
class StepMeans:
    """Means of channels over steps of equal length."""

    #: (n,) the mark that each step belongs to, ascending; a step without any sample is absent.
    time_s: FloatArray
    mean: Mapping[str, FloatArray]  # (n,) by channel; NaN where the channel has none
    #: (n,) by channel: whether the mean stands for the step. A channel left out is sound wherever
    #: it has a mean.
    is_sound: Mapping[str, BoolArray] = field(default_factory=dict)


def minute_rows(
    operating: StepMeans, temperatures: StepMeans, needed: Collection[str] = ()
) -> MinuteData:
    """Rows of an operating point and of temperatures, each with its own missing steps.

    `operating`: over the step from each mark: ``speed_rpm``, ``load_n``, ``ambient_c``, then the
    inputs of a network of one's own in its order; `temperatures`: over the step around each mark,
    by sensor. `needed`: sensors without which a row is not good; those that are not among the
    temperatures are ignored. The operating point is always needed.
    """
    time_s = np.union1d(operating.time_s, temperatures.time_s)
    good = np.ones(time_s.size, dtype=np.bool_)
    columns: dict[str, FloatArray] = {}
    for means, names in ((operating, operating.mean), (temperatures, needed)):
        at = np.searchsorted(time_s, means.time_s)
        for name, values in means.mean.items():
            columns[name] = np.full(time_s.size, np.nan)
            columns[name][at] = values
            if name in names:
                good &= np.isfinite(columns[name])
                good[at] &= means.is_sound.get(name, True)
    return MinuteData(
        time_s,
        columns["speed_rpm"],
        columns["load_n"],
        columns["ambient_c"],
        {name: columns[name] for name in temperatures.mean},
        good,
        {name: columns[name] for name in operating.mean if name not in _OPERATING_POINT},
    )


def rows_of_samples(
    time_s: FloatArray,
    operating: Mapping[str, FloatArray],
    temperatures: Mapping[str, FloatArray],
    step_s: float = MINUTE_S,
) -> MinuteData:
    """Rows of samples that come evenly: every sample of a step counts alike, as in the store.

    `time_s` (n,) ascending, from 0 on; marks are the multiples of a step; `operating`,
    `temperatures` (n,) by channel; see `minute_rows`.
    """
    return minute_rows(
        _means(time_s, operating, 0.0, step_s), _means(time_s, temperatures, step_s / 2.0, step_s)
    )


def _means(
    time_s: FloatArray, channels: Mapping[str, FloatArray], lead_s: float, step_s: float
) -> StepMeans:
    """Means over steps that begin so much before their marks."""
    marks, first, count = np.unique(
        np.floor((time_s + lead_s) / step_s), return_index=True, return_counts=True
    )
    return StepMeans(
        step_s * marks,
        {name: np.add.reduceat(values, first) / count for name, values in channels.items()},
    )


def row_step_s(fastest_s: float, spacing_s: float, duration_s: float) -> float:
    """Choose the step that data are averaged to, in s.

    The longest of `ROW_STEPS_S` of which a time constant has five, but no shorter one than the
    data's own spacing, and none that makes more than `MOST_ROWS` rows.

    `fastest_s`: shortest time constant that matters; `spacing_s`: usual time between two rows of
    the data; `duration_s`: from the first row to the last.
    """
    least_s = max(spacing_s, duration_s / MOST_ROWS)
    fitting = [step for step in ROW_STEPS_S if step * _STEPS_PER_TIME_CONSTANT <= fastest_s]
    wanted_s = fitting[0] if fitting else ROW_STEPS_S[-1]
    return min((step for step in ROW_STEPS_S if step >= max(wanted_s, least_s)), default=MINUTE_S)
