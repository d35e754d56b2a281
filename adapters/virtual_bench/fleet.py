"""Many benches in one: every quantity has one row per bench, and all are advanced together.

The physics of each bench are those of `plant`. Duty, sensors and registers are arrays over the
benches. Benches are advanced in groups, some each second, so that no second has more to do than
another.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.network import INNER_BORE, OUTER_SURFACE
from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.plant import Condition, Plant
from adapters.virtual_bench.sensors import SensorParameters

FloatArray = NDArray[np.float64]

#: Seconds that a group of benches is advanced at once, and so the number of groups.
BLOCK_S = 10
TRUTH_PERIOD_S = 60
BEARING = "6311"
REGISTERS = 7
TEMPERATURE_STEP_K, SPEED_STEP_RPM, LOAD_STEP_N = 0.1, 0.25, 0.25
TRUTH_COLUMNS = (
    "time_s",
    "bench",
    "speed_rpm",
    "load_n",
    "ambient_c",
    "t_inner_ring_c",
    "t_outer_ring_c",
    *(f"t_node_{number}_c" for number in range(1, 14)),
)

_STEPS = 6
_SHORTEST_STEP_S, _LONGEST_STEP_S = 1200.0, 3600.0
_SPEEDS_RPM, _LOADS_N = (1500.0, 4200.0), (2000.0, 3300.0)  # low-risk for this bearing
_RAMP_RPM_PER_S, _RAMP_N_PER_S = 100.0, 200.0
_SWING_PERIOD_S = 7200.0


class Duty:
    """What every bench does: its own six low-risk steps, again and again."""

    def __init__(self, seed: int, benches: int) -> None:
        rng = np.random.default_rng([seed, 0xD07])
        shape = benches, _STEPS
        self._speed = rng.uniform(*_SPEEDS_RPM, shape)
        self._load = rng.uniform(*_LOADS_N, shape)
        self._ends = np.cumsum(rng.uniform(_SHORTEST_STEP_S, _LONGEST_STEP_S, shape), axis=1)

    def true_point(
        self, benches: NDArray[np.intp], time_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Speed in rpm and load in N (benches, times), at times since all stood still."""
        ends = self._ends[benches]
        period = ends[:, -1:]
        inside_period = time_s[np.newaxis, :] % period
        step = (ends[:, np.newaxis, :] <= inside_period[:, :, np.newaxis]).sum(axis=2)
        rows = np.arange(len(benches))[:, np.newaxis]
        begin = np.where(step > 0, ends[rows, step - 1], 0.0)
        first = (time_s[np.newaxis, :] < period) & (step == 0)
        reach_s = inside_period - begin
        speed, load = self._speed[benches], self._load[benches]
        before_rpm = np.where(first, 0.0, speed[rows, step - 1])
        before_n = np.where(first, load[rows, step], load[rows, step - 1])
        return (
            _along(before_rpm, speed[rows, step], reach_s * _RAMP_RPM_PER_S),
            _along(before_n, load[rows, step], reach_s * _RAMP_N_PER_S),
        )


def _along(start: FloatArray, end: FloatArray, reach: FloatArray) -> FloatArray:
    return np.asarray(start + np.clip(end - start, -reach, reach))


@dataclass(frozen=True, slots=True)
class _Block:
    """What a group of benches truly did in some seconds: (benches, seconds) each."""

    speed_rpm: FloatArray
    load_n: FloatArray
    ambient_c: FloatArray
    temperatures_c: FloatArray
    """(benches, seconds, nodes) at the end of every second."""


class BenchFleet:
    """Benches in motion; what they show depends on seed and process time only.

    Every bench is another one: other oil, fits, joints and air, see `BenchParameters.random`.
    """

    def __init__(self, benches: int, seed: int) -> None:
        parameters = [BenchParameters.random(seed * 100_003 + n, BEARING) for n in range(benches)]
        rng = np.random.default_rng([seed, 0xA1B])
        self.size = benches
        self._registers = np.zeros((benches, BLOCK_S, REGISTERS), ">u2")
        self._seed = seed
        self._sensors = sensors = SensorParameters()
        self._duty = Duty(seed, benches)
        self._ambient_c = np.array([one.ambient_c for one in parameters])
        self._swing_k = np.array([one.ambient_swing_k for one in parameters])
        self._phase = rng.uniform(0.0, 2.0 * math.pi, benches)
        start_c = self._ambient(np.arange(benches), np.zeros(1))[:, 0]
        self._plants = [
            Plant(one, float(at_c)) for one, at_c in zip(parameters, start_c, strict=True)
        ]
        # Of three sensors: inner ring, outer ring, ambient.
        self._offset_k = sensors.offset_sd_k * rng.standard_normal((benches, 3))
        self._drift_k = sensors.drift_sd_k * rng.standard_normal((benches, 3))
        self._lagged_c = np.repeat(start_c[:, np.newaxis], 3, axis=1)
        self._first = np.zeros((benches, REGISTERS), ">u2")
        self._first[:, :3] = np.rint(self._lagged_c / TEMPERATURE_STEP_K)
        # The last second that is over, counted from 0.
        self._second = -1
        self._truth: list[tuple[float, ...]] = []

    def advance(self, time_s: float) -> None:
        """Move on to a process time in seconds since the start; never backwards."""
        while self._second < int(time_s) - 1:
            self._second += 1
            group = np.arange(self._second % BLOCK_S, self.size, BLOCK_S)
            if self._second == 0:  # at the start all are advanced, some by less than a block
                for late in range(1, min(BLOCK_S, self.size)):
                    self._advance(np.arange(late, self.size, BLOCK_S), 0, late)
            if group.size:
                self._advance(group, self._second, BLOCK_S)

    def row(self, bench: int) -> bytes:
        """Present registers of a bench, big-endian."""
        if self._second < 0:
            return bytes(self._first[bench])
        return bytes(self._registers[bench, self._second % BLOCK_S])

    def take_truth(self) -> list[tuple[float, ...]]:
        """Rows of truth (`TRUTH_COLUMNS`) since the last call; benches are counted from 0."""
        rows, self._truth = self._truth, []
        return rows

    def _ambient(self, benches: NDArray[np.intp], time_s: FloatArray) -> FloatArray:
        """Air temperature in degC, shape (benches, times): a level and a slow swing."""
        swing = np.sin(
            2.0 * math.pi / _SWING_PERIOD_S * time_s[np.newaxis, :]
            + self._phase[benches][:, np.newaxis]
        )
        level, amplitude = self._ambient_c[benches], self._swing_k[benches]
        return np.asarray(level[:, np.newaxis] + amplitude[:, np.newaxis] * swing)

    def _advance(self, benches: NDArray[np.intp], second: int, count: int) -> None:
        """Run some benches through the seconds from ``second``, and convert every one of them."""
        begin_s = np.arange(second, second + count, dtype=np.float64)
        speed, load = self._duty.true_point(benches, begin_s + 0.5)
        ambient = self._ambient(benches, begin_s)
        ones, unchanged = np.ones(count), Condition.unchanged(count)
        temperatures = np.stack(
            [
                self._plants[bench]
                .advance(ones, speed[row], load[row], ambient[row], unchanged)
                .temperatures_c
                for row, bench in enumerate(benches)
            ]
        )
        block = _Block(speed, load, ambient, temperatures)
        self._convert(benches, second, block)
        end_s = second + count
        if (end_s - int(benches[0]) % BLOCK_S) % TRUTH_PERIOD_S == 0:
            self._note_truth(benches, end_s, block)

    def _convert(self, benches: NDArray[np.intp], second: int, block: _Block) -> None:
        """Put the measuring chains behind the truth: lag, offset, drift, noise, resolution."""
        sensors = self._sensors
        count = block.speed_rpm.shape[1]
        rng = np.random.default_rng([self._seed, int(benches[0]), second])
        noise = rng.standard_normal((count, 8, benches.size))
        follow = 1.0 - math.exp(-1.0 / sensors.lag_s)
        keep = math.exp(-1.0 / sensors.drift_time_s)
        shock_k = sensors.drift_sd_k * math.sqrt(1.0 - keep**2)
        true_c = np.stack(
            [
                block.temperatures_c[:, :, INNER_BORE],
                block.temperatures_c[:, :, OUTER_SURFACE],
                block.ambient_c,
            ],
            axis=2,
        )
        lagged, drift, offset = (
            self._lagged_c[benches],
            self._drift_k[benches],
            self._offset_k[benches],
        )
        rows = np.empty((benches.size, count, REGISTERS))
        for k in range(count):
            lagged = lagged + follow * (true_c[:, k] - lagged)
            drift = keep * drift + shock_k * noise[k, :3].T
            measured = lagged + drift + offset + sensors.white_sd_k * noise[k, 3:6].T
            rows[:, k, :3] = measured / TEMPERATURE_STEP_K
        self._lagged_c[benches], self._drift_k[benches] = lagged, drift
        for column, true, sd, step in (
            (3, block.speed_rpm, sensors.speed_sd_rpm, SPEED_STEP_RPM),
            (4, block.load_n, sensors.load_sd_n, LOAD_STEP_N),
        ):
            read = true + sd * noise[:, column + 3].T
            rows[:, :, column] = np.where(true > 0.0, np.maximum(read, 0.0), 0.0) / step
        end_s = np.arange(second + 1, second + 1 + count)
        rows[:, :, 5], rows[:, :, 6] = end_s >> 16, end_s & 0xFFFF
        at = (np.arange(second, second + count)) % BLOCK_S
        # A negative temperature is sent in two's complement.
        words = np.rint(rows).astype(np.int64) & 0xFFFF
        self._registers[benches[:, np.newaxis], at[np.newaxis, :]] = words

    def _note_truth(self, benches: NDArray[np.intp], end_s: int, block: _Block) -> None:
        for row, bench in enumerate(benches):
            nodes = block.temperatures_c[row, -1]
            self._truth.append(
                (
                    float(end_s),
                    float(bench),
                    float(block.speed_rpm[row, -1]),
                    float(block.load_n[row, -1]),
                    float(block.ambient_c[row, -1]),
                    float(nodes[INNER_BORE]),
                    float(nodes[OUTER_SURFACE]),
                    *(self._plants[bench].weights @ nodes).tolist(),
                )
            )
