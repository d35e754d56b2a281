"""Sensors of the virtual bench: PT100 transmitters, speed encoder and load cell.

All noise is a function of seed, channel and process time, never of how often someone asks.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.compiling import compiled
from adapters.virtual_bench.plant import BenchProfile, Truth

PT100_CHANNELS = ("t_inner_ring_c", "t_outer_ring_c", "ambient_c")
CAN_TICK_S = 0.05
_BLOCK = 1024


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """Errors of the measuring chains."""

    lag_s: float = 20.0  # time constant of a PT100 in its bore, seconds
    offset_sd_k: float = 0.1  # spread of the constant offset of a chain
    white_sd_k: float = 0.05  # white noise of one conversion (one per second)
    #: Spread and correlation time of a slow AR(1) drift.
    drift_sd_k: float = 0.05
    drift_time_s: float = 1800.0
    resolution_k: float = 0.1  # step of the transmitter's output
    #: White noise of encoder and load cell, per reading (every 0.05 s).
    speed_sd_rpm: float = 1.0
    load_sd_n: float = 6.0


class Noise:
    """Standard normal noise by tick number; the same for a seed and a stream."""

    def __init__(self, seed: int, stream: int) -> None:
        self._key = (seed, stream)
        self._number = -1
        self._block: NDArray[np.float64] = np.empty(0)

    def value(self, tick: int) -> float:
        """Noise of one tick."""
        return float(self.values(tick, 1)[0])

    def values(self, first: int, count: int) -> NDArray[np.float64]:
        """Noise of `count` ticks from `first`, shape (count,)."""
        out = np.empty(count)
        done = 0
        while done < count:
            number, offset = divmod(first + done, _BLOCK)
            if number != self._number:
                rng = np.random.default_rng([*self._key, number])
                self._number, self._block = number, rng.standard_normal(_BLOCK)
            part = min(_BLOCK - offset, count - done)
            out[done : done + part] = self._block[offset : offset + part]
            done += part
        return out


@compiled
def _chain(
    true_c: NDArray[np.float64],
    shocks: NDArray[np.float64],
    lagged: float,
    drift: float,
    follow: float,
    keep: float,
    out: NDArray[np.float64],
) -> tuple[float, float]:
    for k in range(true_c.size):
        lagged += follow * (true_c[k] - lagged)
        drift = keep * drift + shocks[k]
        out[k] = lagged + drift
    return lagged, drift


class Pt100:
    """One temperature chain of `PT100_CHANNELS`: lag, offset, drift, white noise, resolution."""

    def __init__(
        self,
        seed: int,
        channel: int,
        start_c: float,
        parameters: SensorParameters,
        step_s: float = 1.0,
    ) -> None:
        self._parameters = parameters
        self._white = Noise(seed, 10 + channel)
        self._shock = Noise(seed, 20 + channel)
        start = np.random.default_rng([seed, 30 + channel]).standard_normal(2)
        self._offset = parameters.offset_sd_k * float(start[0])
        self._drift = parameters.drift_sd_k * float(start[1])
        self._lagged = start_c
        self._tick = 0
        self._follow = 1.0 - math.exp(-step_s / parameters.lag_s)
        self._keep = math.exp(-step_s / parameters.drift_time_s)

    def convert(self, true_c: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measure the next temperatures, one per conversion; shape (n,) in and out, degC."""
        parameters = self._parameters
        count = true_c.size
        out = np.empty(count)
        scale = parameters.drift_sd_k * math.sqrt(1.0 - self._keep**2)
        self._lagged, self._drift = _chain(
            np.ascontiguousarray(true_c),
            scale * self._shock.values(self._tick, count),
            self._lagged,
            self._drift,
            self._follow,
            self._keep,
            out,
        )
        out += self._offset + parameters.white_sd_k * self._white.values(self._tick, count)
        self._tick += count
        return np.round(out / parameters.resolution_k) * parameters.resolution_k


class LineSensor:
    """Encoder or load cell on the CAN bus: white noise `sd`, no negative values."""

    def __init__(self, seed: int, stream: int, sd: float) -> None:
        self._noise = Noise(seed, stream)
        self._sd = sd

    def read(self, true_value: float, time_s: float) -> float:
        """Read at a process time; what stands still reads exactly zero."""
        if true_value <= 0.0:
            return 0.0
        return max(true_value + self._sd * self._noise.value(int(time_s / CAN_TICK_S)), 0.0)


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """What the sensors would have shown on a run, at the times of its profile, shape (n,) each."""

    time_s: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
    t_inner_ring_c: NDArray[np.float64]
    t_outer_ring_c: NDArray[np.float64]


def measure(
    profile: BenchProfile,
    truth: Truth,
    seed: int,
    parameters: SensorParameters | None = None,
) -> MeasuredRun:
    """Put the measuring chains behind an offline simulation: one conversion per row."""
    sensors = parameters or SensorParameters()
    steps = np.diff(profile.time_s)
    if steps.size and not np.allclose(steps, steps[0]):
        raise ValueError("profile times: expected an even spacing")
    step_s = float(steps[0]) if steps.size else 1.0
    true = (truth.t_inner_ring_c, truth.t_outer_ring_c, profile.ambient_c)
    inner, outer, ambient = (
        Pt100(seed, channel, float(values[0]), sensors, step_s).convert(values)
        for channel, values in enumerate(true)
    )
    count = profile.time_s.size
    speed = profile.speed_rpm + sensors.speed_sd_rpm * Noise(seed, 1).values(0, count)
    load = profile.load_n + sensors.load_sd_n * Noise(seed, 2).values(0, count)
    return MeasuredRun(
        time_s=profile.time_s,
        speed_rpm=np.where(profile.speed_rpm > 0.0, np.maximum(speed, 0.0), 0.0),
        load_n=np.maximum(load, 0.0),
        ambient_c=ambient,
        t_inner_ring_c=inner,
        t_outer_ring_c=outer,
    )
