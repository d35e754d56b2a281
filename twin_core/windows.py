"""Spans of measured data that parameters may be identified from: the low-risk windows.

All times are seconds on one axis that the caller chooses; a row's operating point holds from its
time to the next row's time, its temperatures are instantaneous at its time.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.operating_points import (
    NEW_LOAD,
    NEW_SPEED,
    STANDING_RPM,
    OperatingSpan,
    alike,
    new_points,
    split,
    taught_values,
    varying_duty,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MEASURED_TOLERANCE = 0.02
"""A set-point at the edge of the low-risk region is measured with noise and gain errors."""

# Rest minutes before the start of the machine that are kept: they show the initial state.
_REST_ROWS = 10
_AT_REST_K = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class MinuteData:
    """Measured rows, as a rule one per minute.

    Raises `ValueError` if shapes differ, time does not increase or a good row has no operating
    point.
    """

    time_s: FloatArray  # shape (n,), strictly increasing
    #: Shape (n,). May be NaN where not `good`.
    speed_rpm: FloatArray
    load_n: FloatArray
    ambient_c: FloatArray
    #: Shape (n,) for every sensor; NaN where the sensor had no good value.
    temperatures_c: Mapping[str, FloatArray]
    good: BoolArray  # shape (n,): speed, load, ambient and inputs of the row can be relied upon
    #: Shape (n,) for every input of a network of one's own, in its order; default none.
    inputs: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "inputs",
            {name: np.ascontiguousarray(of, np.float64) for name, of in self.inputs.items()},
        )
        for name in ("time_s", "speed_rpm", "load_n", "ambient_c"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), np.float64))
        object.__setattr__(self, "good", np.ascontiguousarray(self.good, np.bool_))
        object.__setattr__(
            self,
            "temperatures_c",
            {
                name: np.ascontiguousarray(values, np.float64)
                for name, values in self.temperatures_c.items()
            },
        )
        columns = {
            "speed_rpm": self.speed_rpm,
            "load_n": self.load_n,
            "ambient_c": self.ambient_c,
            **self.inputs,
            **self.temperatures_c,
        }
        for name, column in [*columns.items(), ("good", self.good)]:
            if column.shape != self.time_s.shape or column.ndim != 1:
                raise ValueError(
                    f"minutes: {name} has shape {column.shape}, expected {self.time_s.shape}"
                )
        if np.any(np.diff(self.time_s) <= 0.0):
            row = int(np.flatnonzero(np.diff(self.time_s) <= 0.0)[0])
            raise ValueError(
                f"minutes: time_s[{row + 1}] = {self.time_s[row + 1]} does not come after "
                f"time_s[{row}] = {self.time_s[row]}"
            )
        for name in ("speed_rpm", "load_n", "ambient_c", *self.inputs):
            missing = self.good & ~np.isfinite(columns[name])
            if np.any(missing):
                row = int(np.flatnonzero(missing)[0])
                raise ValueError(f"minutes: {name}[{row}] is not a number in a row called good")

    @property
    def size(self) -> int:
        """Number of rows, n."""
        return int(self.time_s.size)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the temperature sensors."""
        return tuple(self.temperatures_c)

    def take(self, rows: slice | BoolArray) -> "MinuteData":
        """Return the chosen rows."""
        return MinuteData(
            self.time_s[rows],
            self.speed_rpm[rows],
            self.load_n[rows],
            self.ambient_c[rows],
            {name: values[rows] for name, values in self.temperatures_c.items()},
            self.good[rows],
            {name: values[rows] for name, values in self.inputs.items()},
        )

    def readings(self, row: int) -> dict[str, float]:
        """Return the temperatures of a row in degC by sensor, without those that are missing."""
        found = {name: float(values[row]) for name, values in self.temperatures_c.items()}
        return {name: value for name, value in found.items() if np.isfinite(value)}

    def inputs_at(self, row: int) -> tuple[float, ...]:
        """Return the inputs of a row, in order."""
        return tuple(float(values[row]) for values in self.inputs.values())

    def input_table(self) -> FloatArray:
        """Return the inputs as one array, (n, k)."""
        return np.array(list(self.inputs.values())).reshape(-1, self.size).T

    def between(self, start_s: float, end_s: float) -> "MinuteData":
        """Return the rows from ``start_s`` to ``end_s``, both inclusive."""
        return self.take((self.time_s >= start_s) & (self.time_s <= end_s))


@dataclass(frozen=True, slots=True)
class LowRiskRegion:
    """Where a machine may always run: up to a speed in rpm and a radial load in newtons."""

    speed_rpm_max: float
    load_n_max: float

    def contains(
        self, speed_rpm: ArrayLike, load_n: ArrayLike, tolerance: float = 0.0
    ) -> BoolArray:
        """Return which operating points lie inside.

        `speed_rpm`, `load_n`: speeds and loads of one shape; the sense of rotation does not matter;
        `tolerance`: relative excess that still counts as inside: `MEASURED_TOLERANCE` for what has
        been measured, 0 for what is asked for. Returns boolean, of that shape; False where a number
        is missing.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(
                (np.abs(speed_rpm) <= self.speed_rpm_max * (1.0 + tolerance))
                & (np.asarray(load_n) <= self.load_n_max * (1.0 + tolerance))
            )


@dataclass(frozen=True, slots=True)
class Window:
    """A contiguous low-risk span of good data."""

    #: Times of the first and the last row, both part of the window.
    start_s: float
    end_s: float
    #: In time order, without transitions; standing is not one.
    operating_points: tuple[OperatingSpan, ...]
    at_rest: bool  # whether the machine stood at ambient temperature at the first row
    score: float  # how much the window can teach, 0 to 1; see `variety_score`
    #: Where the machine ran while it was held nowhere; see `varying_duty`.
    duty: tuple[OperatingSpan, ...] = ()

    @property
    def points(self) -> tuple[OperatingSpan, ...]:
        """Where the machine ran: operating points and varying duty."""
        return (*self.operating_points, *self.duty)

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.end_s - self.start_s

    @property
    def speed_rpm_max(self) -> float:
        """Highest speed of the operating points and the duty, 0 without any."""
        return max((point.speed_rpm for point in self.points), default=0.0)

    @property
    def load_n_max(self) -> float:
        """Highest load of the operating points and the duty, 0 without any."""
        return max((point.load_n for point in self.points), default=0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "start_s": self.start_s,
            "end_s": self.end_s,
            "operating_points": [point.to_dict() for point in self.operating_points],
            "at_rest": self.at_rest,
            "score": self.score,
            "duty": [point.to_dict() for point in self.duty],
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "Window":
        """Take back what `to_dict` gave."""
        return cls(
            float(document["start_s"]),
            float(document["end_s"]),
            tuple(OperatingSpan.from_dict(point) for point in document["operating_points"]),
            bool(document["at_rest"]),
            float(document["score"]),
            tuple(OperatingSpan.from_dict(point) for point in document.get("duty", ())),
        )


def find_windows(
    minutes: MinuteData,
    region: LowRiskRegion,
    min_duration_s: float = 1800.0,
    max_gap_rows: int = 2,
) -> list[Window]:
    """Find the low-risk windows in time order.

    A window is a run of good rows inside the region, with at least one good temperature each, on a
    running machine, together with up to ten rest rows just before it. It may miss up to
    ``max_gap_rows`` rows at a time (they are not filled); a longer gap, a row outside the region
    or a longer standstill ends it.

    `minutes`: rows at a constant spacing, some of them possibly absent or bad; `region`: low-risk
    speeds and loads, met with 2 % tolerance for measurement noise; `min_duration_s`: shortest time
    on the running machine; `max_gap_rows`: longest gap inside a window, in rows.
    """
    if minutes.size < 2:
        return []
    spacing_s = float(np.median(np.diff(minutes.time_s)))
    known = np.zeros(minutes.size, dtype=np.bool_)
    for values in minutes.temperatures_c.values():
        known |= np.isfinite(values)
    usable = minutes.good & known
    speed, load = np.abs(minutes.speed_rpm), minutes.load_n
    inside = region.contains(speed, load, MEASURED_TOLERANCE)
    with np.errstate(invalid="ignore"):
        standing = usable & (speed < STANDING_RPM)
    # A good row outside the region ends a window at once; a bad one is a gap.
    barrier = minutes.good & ~inside
    windows = []
    for first, last in _runs(
        minutes.time_s,
        usable & inside & ~standing,
        barrier | standing,
        (max_gap_rows + 1.5) * spacing_s,
    ):
        if minutes.time_s[last] - minutes.time_s[first] < min_duration_s:
            continue
        start = first
        while (
            start > 0
            and first - start < _REST_ROWS
            and standing[start - 1]
            and minutes.time_s[start] - minutes.time_s[start - 1] < 1.5 * spacing_s
        ):
            start -= 1
        chosen = minutes.take(slice(start, last + 1))
        windows.append(_describe(chosen, spacing_s))
    return windows


def window_of(minutes: MinuteData) -> Window:
    """Describe rows that were chosen by other means as a window, whatever their region."""
    if minutes.size == 0:
        raise ValueError("minutes: no rows, expected at least one")
    spacing_s = float(np.median(np.diff(minutes.time_s))) if minutes.size > 1 else 60.0
    return _describe(minutes, spacing_s)


def _runs(
    time_s: FloatArray, wanted: BoolArray, barrier: BoolArray, longest_step_s: float
) -> list[tuple[int, int]]:
    """First and last row of every run of wanted rows that no barrier and no gap interrupts."""
    rows = np.flatnonzero(wanted)
    if rows.size == 0:
        return []
    barriers = np.concatenate(([0], np.cumsum(barrier)))
    broken = (np.diff(time_s[rows]) > longest_step_s) | (
        barriers[rows[1:]] != barriers[rows[:-1] + 1]
    )
    ends = np.flatnonzero(broken)
    firsts = np.concatenate(([0], ends + 1))
    lasts = np.concatenate((ends, [rows.size - 1]))
    return [(int(rows[a]), int(rows[b])) for a, b in zip(firsts, lasts, strict=True)]


def _describe(chosen: MinuteData, spacing_s: float) -> Window:
    good = chosen.take(chosen.good)
    points = split(good.time_s, good.speed_rpm, good.load_n, spacing_s)
    window = Window(
        start_s=float(chosen.time_s[0]),
        end_s=float(chosen.time_s[-1]),
        operating_points=points,
        at_rest=is_at_rest(chosen),
        score=0.0,
        duty=varying_duty(good.time_s, good.speed_rpm, good.load_n, points, spacing_s),
    )
    return replace(window, score=variety_score(window))


def is_at_rest(minutes: MinuteData) -> bool:
    """Return whether the machine stood at ambient temperature at the first row.

    It did when the shaft did not turn and every known sensor was within 1.5 K of ambient.
    """
    if minutes.size == 0 or not minutes.good[0]:
        return False
    first = [float(values[0]) for values in minutes.temperatures_c.values()]
    return stands_at_ambient(float(minutes.speed_rpm[0]), float(minutes.ambient_c[0]), first)


def stands_at_ambient(speed_rpm: float, ambient_c: float, temperatures_c: Iterable[float]) -> bool:
    """Return whether a machine stands, every known sensor (not NaN) within 1.5 K of ambient."""
    known = [value for value in temperatures_c if np.isfinite(value)]
    cold = all(abs(value - ambient_c) <= _AT_REST_K for value in known)
    return abs(speed_rpm) < STANDING_RPM and bool(known) and cold


def variety_score(window: Window) -> float:
    """Return how much a window can teach, 0 to 1.

    A quarter each for: a start at standstill (it fixes the initial state and the temperature
    feedback of the friction); length up to six hours; up to three distinct speeds; up to two
    distinct loads.
    Distinct speeds are counted at any load, distinct loads only at one and the same speed: a load
    that changes together with the speed is not separable. Where the duty varies, each counts
    from 20 min in all on.
    """
    speeds = taught_values(window.operating_points, window.duty, "speed_rpm", NEW_SPEED)

    def near(points: Sequence[OperatingSpan], speed: float) -> list[OperatingSpan]:
        return [point for point in points if alike(point.speed_rpm, speed, NEW_SPEED)]

    loads = max(
        (
            len(
                taught_values(
                    near(window.operating_points, speed),
                    near(window.duty, speed),
                    "load_n",
                    NEW_LOAD,
                )
            )
            for speed in speeds
        ),
        default=0,
    )
    length = min(window.duration_s / 21600.0, 1.0)
    return 0.25 * (float(window.at_rest) + length + min(len(speeds), 3) / 3 + min(loads, 2) / 2)


def varied(
    old: Sequence[Window],
    new: Sequence[Window],
    min_duration_s: float = 1800.0,
    required: int = 1,
) -> bool:
    """Return whether enough new operating points have come to identify again.

    `old`: the windows that the last identification used; empty before the first; `new`: all windows
    there are now, the old ones included; `min_duration_s`: shortest total time at a new operating
    point that counts. `required`: how many new points there must be. Before the first
    identification at least two whatever this says: one point teaches neither a speed law nor a load
    law. Of a duty that varies, each ``min_duration_s`` at points that are new, however short each,
    count as one.
    """
    known = [point for window in old for point in window.points]
    points = [point for window in new for point in window.operating_points]
    found = new_points(known, points, min_duration_s)
    duty = [point for window in new for point in window.duty]
    passed_s = sum(point.duration_s for point in new_points([*known, *found], duty, 0.0))
    count = len(found) + int(passed_s // min_duration_s)
    return count >= (required if known else max(required, 2))


__all__ = [
    "MEASURED_TOLERANCE",
    "STANDING_RPM",
    "LowRiskRegion",
    "MinuteData",
    "OperatingSpan",
    "Window",
    "find_windows",
    "is_at_rest",
    "stands_at_ambient",
    "varied",
    "variety_score",
    "window_of",
]
