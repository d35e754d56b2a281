"""What a machine is asked to do over time, and what comes out of simulating it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core import TwinCoreError
from twin_core.profiles import Point
from twin_core.simulation.compiling import kernel_array


@dataclass(frozen=True, slots=True, eq=False)
class OperatingProfile:
    """Operating point over time; row k holds from ``time_s[k]`` until ``time_s[k + 1]``.

    The last row therefore only marks the end: simulated temperatures are instantaneous values at
    ``time_s``, the first of them being the initial state.

    Raises `ValueError` if shapes differ, a value is not finite or time does not increase.
    """

    time_s: NDArray[np.float64]  # shape (n,), strictly increasing, any spacing
    #: Shape (n,) each. The sense of rotation does not matter; a negative load counts as zero.
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
    #: Shape (n, k): the inputs of a network that has any, in its order; by default k is 0.
    inputs: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        given = self.inputs if self.inputs.size else np.empty((len(self.time_s), 0))
        object.__setattr__(self, "inputs", kernel_array(given))
        if self.inputs.shape[0] != len(self.time_s) or not np.isfinite(self.inputs).all():
            raise ValueError(
                f"profile: inputs has shape {self.inputs.shape}, expected finite numbers in one "
                f"row for each of {len(self.time_s)} times"
            )
        for name in ("time_s", "speed_rpm", "load_n", "ambient_c"):
            array = kernel_array(getattr(self, name))
            object.__setattr__(self, name, array)
            if array.ndim != 1 or array.shape != self.time_s.shape or array.size == 0:
                raise ValueError(
                    f"profile: {name} has shape {array.shape}, expected a non-empty "
                    f"one-dimensional array as long as time_s {self.time_s.shape}"
                )
            if not np.isfinite(array).all():
                row = int(np.flatnonzero(~np.isfinite(array))[0])
                raise ValueError(
                    f"profile: {name}[{row}] is {array[row]}, expected a finite number"
                )
        steps = np.diff(self.time_s)
        if (steps <= 0.0).any():
            row = int(np.flatnonzero(steps <= 0.0)[0])
            raise ValueError(
                f"profile: time_s[{row + 1}] = {self.time_s[row + 1]} does not come after "
                f"time_s[{row}] = {self.time_s[row]}"
            )

    @property
    def size(self) -> int:
        """Number of rows, n."""
        return int(self.time_s.size)

    def point(self, row: int) -> Point:
        """Return the operating point of a row."""
        return Point(
            float(self.speed_rpm[row]),
            float(self.load_n[row]),
            float(self.ambient_c[row]),
            tuple(self.inputs[row].tolist()),
        )

    def steps(self) -> Iterator[tuple[Point, float]]:
        """Yield the operating point of every row but the last, and for how many s it holds."""
        for row, step_s in enumerate(np.diff(self.time_s).tolist()):
            yield self.point(row), step_s

    def rows(self, chosen: slice) -> "OperatingProfile":
        """Return the chosen rows."""
        return OperatingProfile(
            self.time_s[chosen],
            self.speed_rpm[chosen],
            self.load_n[chosen],
            self.ambient_c[chosen],
            self.inputs[chosen],
        )


class OperatingProfiles(NamedTuple):
    """Profiles of many machines: every array has one row of rows per machine.

    Nothing is checked here: a machine without finite numbers has no result, and harms no other.
    """

    #: (machines, n) as in `OperatingProfile`.
    time_s: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
    inputs: NDArray[np.float64]  # (machines, n, k) the inputs of a network that has any
    #: (machines,) how many of the rows are the machine's; what follows them does not count.
    rows: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Number of machines."""
        return int(self.rows.size)

    @classmethod
    def of(cls, profiles: Sequence[OperatingProfile]) -> "OperatingProfiles":
        """Put profiles together, of any lengths, all with the same inputs.

        Raises `ValueError` if there is none, or their numbers of inputs differ.
        """
        if len(profiles) == 1:
            one = profiles[0]
            return cls(
                one.time_s[np.newaxis],
                one.speed_rpm[np.newaxis],
                one.load_n[np.newaxis],
                one.ambient_c[np.newaxis],
                one.inputs[np.newaxis],
                np.array([one.size]),
            )
        counts = {profile.inputs.shape[1] for profile in profiles}
        if len(counts) != 1:
            raise ValueError(
                f"profiles: there are {len(profiles)}, their numbers of inputs are "
                f"{sorted(counts)}; expected at least one, all with the same inputs"
            )
        rows = np.array([profile.size for profile in profiles], np.int64)
        shape = rows.size, int(rows.max())
        time_s, speed_rpm, load_n, ambient_c = np.full((4, *shape), np.nan)
        result = cls(time_s, speed_rpm, load_n, ambient_c, np.zeros((*shape, *counts)), rows)
        for machine, profile in enumerate(profiles):
            here = machine, slice(profile.size)
            result.time_s[here], result.speed_rpm[here] = profile.time_s, profile.speed_rpm
            result.load_n[here], result.ambient_c[here] = profile.load_n, profile.ambient_c
            result.inputs[here] = profile.inputs
        return result

    @classmethod
    def held(
        cls,
        speed_rpm: ArrayLike,
        load_n: ArrayLike,
        ambient_c: ArrayLike,
        inputs: ArrayLike | None = None,
        *,
        horizon_s: float,
        row_s: float = 60.0,
    ) -> "OperatingProfiles":
        """Hold the operating point of every machine over a horizon.

        `speed_rpm`, `load_n`, `ambient_c` (machines,) each; `inputs` (machines, k) the network's
        inputs, if it has any; `horizon_s`, `row_s`: how long, and the spacing of the rows in s; the
        last row is the end of the horizon.
        """
        points = np.stack([np.asarray(part, np.float64) for part in (speed_rpm, load_n, ambient_c)])
        time_s = np.append(np.arange(0.0, horizon_s, row_s), horizon_s)
        machines, size = points.shape[1], time_s.size
        speeds, loads, ambients = np.repeat(points[:, :, np.newaxis], size, axis=2)
        drives = np.empty((machines, 0)) if inputs is None else np.asarray(inputs, np.float64)
        return cls(
            np.tile(time_s, (machines, 1)),
            speeds,
            loads,
            ambients,
            np.repeat(drives[:, np.newaxis], size, axis=1),
            np.full(machines, size, np.int64),
        )

    def chosen(self, machines: slice) -> "OperatingProfiles":
        """Return the profiles of some machines."""
        return OperatingProfiles(
            self.time_s[machines],
            self.speed_rpm[machines],
            self.load_n[machines],
            self.ambient_c[machines],
            self.inputs[machines],
            self.rows[machines],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Simulated temperatures of all state nodes."""

    time_s: NDArray[np.float64]  # shape (n,), as in the profile
    #: Shape (n, nodes): instantaneous temperatures at ``time_s``.
    temperatures_c: NDArray[np.float64]
    #: Shape (n,): revolutions of the shaft since the bearing was last greased.
    revolutions: NDArray[np.float64]


class SimulationError(TwinCoreError, ValueError):
    """A simulation did not stay finite: the model ran away or its parameters are unusable."""


def total_revolutions(
    profile: OperatingProfile, start: float | NDArray[np.float64] = 0.0
) -> NDArray[np.float64]:
    """Revolutions (n,) or (B, n) counted at each row of a profile, from `start`, scalar or (B,)."""
    turned = np.zeros(profile.size)
    steps = profile.time_s[1:] - profile.time_s[:-1]
    np.cumsum(np.abs(profile.speed_rpm[:-1]) * steps / 60.0, out=turned[1:])
    if isinstance(start, float):
        return start + turned
    result: NDArray[np.float64] = np.asarray(start, dtype=np.float64)[..., None] + turned
    return result


def hold_operating_point(
    profile: OperatingProfile,
    *,
    speed_fraction: float = 0.005,
    speed_tolerance_rpm: float = 5.0,
    load_fraction: float = 0.015,
    load_tolerance_n: float = 20.0,
) -> OperatingProfile:
    """Replace measurement noise of speed and load by the mean over runs of like rows.

    Simulating decomposes the network again for every new (speed, load). Measured minute averages
    differ in the last digits all the time; this joins neighbouring rows whose speed and load lie
    within the tolerance of the run's time-weighted mean. As this holds for *every* row of a run,
    no value moves by more than the tolerance: steps stay where they are and a ramp becomes a
    staircase of steps no higher than twice the tolerance.

    `profile`: n rows; `speed_fraction`, `speed_tolerance_rpm`: tolerance of speed: fraction of the
    mean plus a constant; `load_fraction`, `load_tolerance_n`: tolerance of load also. Returns n
    rows at the same times, ambient and inputs unchanged.
    """
    speed, load = np.abs(profile.speed_rpm), np.maximum(profile.load_n, 0.0)
    if (speed == speed[0]).all() and (load == load[0]).all():
        return OperatingProfile(profile.time_s, speed, load, profile.ambient_c, profile.inputs)
    # The last row marks the end and has no duration; any weight serves it.
    weight = np.append(np.diff(profile.time_s), 1.0)
    held_speed, held_load = speed.copy(), load.copy()
    speeds, loads, weights = speed.tolist(), load.tolist(), weight.tolist()
    first = 0
    speed_run, load_run = _Run(speeds[0], weights[0]), _Run(loads[0], weights[0])
    for row in range(1, profile.size + 1):
        if row < profile.size:
            if speed_run.is_only(speeds[row]) and load_run.is_only(loads[row]):
                speed_run.weight += weights[row]
                load_run.weight += weights[row]
                continue
            with_speed = speed_run.extended(speeds[row], weights[row])
            with_load = load_run.extended(loads[row], weights[row])
            if with_speed.is_within(speed_fraction, speed_tolerance_rpm) and with_load.is_within(
                load_fraction, load_tolerance_n
            ):
                speed_run, load_run = with_speed, with_load
                continue
        held_speed[first:row] = speed_run.mean
        held_load[first:row] = load_run.mean
        if row < profile.size:
            first = row
            speed_run = _Run(speeds[row], weights[row])
            load_run = _Run(loads[row], weights[row])
    return OperatingProfile(
        profile.time_s, held_speed, held_load, profile.ambient_c, profile.inputs
    )


class _Run:
    """Weighted mean and range of a run of values."""

    __slots__ = ("high", "low", "mean", "weight")

    def __init__(
        self, mean: float, weight: float, low: float | None = None, high: float | None = None
    ) -> None:
        self.mean = mean
        self.weight = weight
        self.low = mean if low is None else low
        self.high = mean if high is None else high

    def extended(self, value: float, weight: float) -> "_Run":
        total = self.weight + weight
        mean = self.mean + (value - self.mean) * weight / total
        return _Run(mean, total, min(self.low, value), max(self.high, value))

    def is_only(self, value: float) -> bool:
        """Whether the run has held nothing but this value, as planned profiles do."""
        return self.low == self.high == value

    def is_within(self, fraction: float, constant: float) -> bool:
        tolerance = fraction * self.mean + constant
        return self.high - self.mean <= tolerance and self.mean - self.low <= tolerance
