"""What a machine is asked to do over time, and what comes out of simulating it."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_core.profiles import OperatingPoint
from twin_core.simulation.compiling import kernel_array


@dataclass(frozen=True, slots=True, eq=False)
class OperatingProfile:
    """Operating point over time; row k holds from ``time_s[k]`` until ``time_s[k + 1]``.

    The last row therefore only marks the end: simulated temperatures are instantaneous values at
    ``time_s``, the first of them being the initial state.

    Parameters
    ----------
    time_s
        Shape (n,), strictly increasing, any spacing.
    speed_rpm, load_n, ambient_c
        Shape (n,) each. The sense of rotation does not matter; a negative load counts as zero.
    inputs
        Shape (n, k): the inputs of a network that has any, in its order; by default k is 0.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite or time does not increase.
    """

    time_s: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
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

    def point(self, row: int) -> OperatingPoint:
        """Return the operating point of a row."""
        return OperatingPoint(
            float(self.speed_rpm[row]),
            float(self.load_n[row]),
            float(self.ambient_c[row]),
            tuple(self.inputs[row].tolist()),
        )

    def steps(self) -> Iterator[tuple[OperatingPoint, float]]:
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


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Simulated temperatures of all state nodes.

    Parameters
    ----------
    time_s
        Shape (n,), as in the profile.
    temperatures_c
        Shape (n, nodes): instantaneous temperatures at ``time_s``.
    revolutions
        Shape (n,): revolutions of the shaft since the bearing was last greased.
    """

    time_s: NDArray[np.float64]
    temperatures_c: NDArray[np.float64]
    revolutions: NDArray[np.float64]


class SimulationError(ValueError):
    """A simulation did not stay finite: the model ran away or its parameters are unusable."""


def total_revolutions(
    profile: OperatingProfile, start: float | NDArray[np.float64] = 0.0
) -> NDArray[np.float64]:
    """Return the revolutions counted at each row of *profile*.

    Parameters
    ----------
    profile
        n rows.
    start
        Revolutions at the first row, scalar or shape (B,).

    Returns
    -------
    ndarray
        Shape (n,) or (B, n).
    """
    turned = np.zeros(profile.size)
    steps = profile.time_s[1:] - profile.time_s[:-1]
    np.cumsum(np.abs(profile.speed_rpm[:-1]) * steps / 60.0, out=turned[1:])
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

    Parameters
    ----------
    profile
        n rows.
    speed_fraction, speed_tolerance_rpm
        Tolerance of speed: fraction of the mean plus a constant.
    load_fraction, load_tolerance_n
        Tolerance of load also.

    Returns
    -------
    OperatingProfile
        n rows at the same times, ambient and inputs unchanged.
    """
    speed, load = np.abs(profile.speed_rpm), np.maximum(profile.load_n, 0.0)
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
