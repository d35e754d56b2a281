"""Runs of virtual benches as the twin sees them: minute rows, identification, forecast, scores.

The data come from the virtual bench's physics, which share nothing with the twin's. A bench starts
cold and at standstill; the twin is identified from the first rows, its observer follows the
machine to the present and forecasts the rest.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench import (
    BenchParameters,
    Scenario,
    SensorParameters,
    measure,
    scenario_profile,
    simulate,
)
from adapters.virtual_bench.scenarios import BenchPhase
from adapters.virtual_bench.sensors import Pt100
from service.domain import channels
from twin_core.bearings import bearing
from twin_core.filtering import begin, run_filter
from twin_core.forecasting import Forecast, forecast
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationResult,
    IdentificationWindow,
    Posterior,
    identify,
)
from twin_core.minute_rows import rows_of_samples
from twin_core.models import ThermalModel, build_model
from twin_core.observer import Observer
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile, hold_operating_point
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

RINGS = channels.RING_SENSORS
NODES = channels.NODES
MINUTE_S = 60.0
SECONDS = 60
STEADY_ROWS = 30
"""The steady phase of a stage is its last half hour; what comes before is its rise."""
RAN_AWAY_C = 110.0
"""A bench whose inner ring passes this temperature has run away thermally."""

_FIRST_NODE_CHANNEL = 100


class Stage(NamedTuple):
    """An operating point held for some minutes, the ramp towards it included."""

    minutes: int
    speed_rpm: float
    load_n: float


@dataclass(frozen=True, slots=True, eq=False)
class BenchRun:
    """What one bench did over a plan.

    - ``minutes``: (n,) rows: speed, load and ambient averaged over the minute that begins at the
      row's time, temperatures over the 60 s around it, as the service makes them.
    - ``truth_c``: (n,) noise-free temperatures at the rows' times, of both rings and the paper's 13
      nodes.
    """

    bearing: str
    stages: tuple[Stage, ...]
    minutes: MinuteData
    truth_c: dict[str, FloatArray]

    def first_row(self, stage: int) -> int:
        """Row at which a stage begins; the number of stages gives the end."""
        return sum(one.minutes for one in self.stages[:stage])

    def _stage_of(self, first: int, end: int) -> NDArray[np.intp]:
        ends = np.cumsum([one.minutes for one in self.stages])
        return np.searchsorted(ends, np.arange(first, end), side="right")

    def steady(self, first: int, end: int) -> NDArray[np.bool_]:
        """Which of the rows from ``first`` to before ``end`` belong to a steady phase."""
        ends = np.cumsum([one.minutes for one in self.stages])[self._stage_of(first, end)]
        return np.asarray(np.minimum(ends, end) - np.arange(first, end) <= STEADY_ROWS)

    def ran_away(self, first: int, end: int) -> bool:
        """Whether the inner ring truly passed 110 degC within rows, or was on its way at the end.

        That is, it climbed by more than 1 K in the last ten minutes of a stage, faster than before.
        """
        inner = self.truth_c["t_inner_ring_c"][first:end]
        before, last = inner[-11] - inner[-21], inner[-1] - inner[-11]
        held = np.ptp(self._stage_of(end - 21, end)) == 0
        return bool(np.any(inner > RAN_AWAY_C) or (held and last > max(before, 1.0)))

    def planned(self, first: int, end: int) -> OperatingProfile:
        """The plan from a row on, as known at that row: set-points, and the ambient of now."""
        rows = slice(first, end)
        stage = self._stage_of(first, end)
        ambient = np.full(end - first, self.minutes.ambient_c[first])
        return OperatingProfile(
            self.minutes.time_s[rows] - self.minutes.time_s[first],
            np.array([one.speed_rpm for one in self.stages])[stage],
            np.array([one.load_n for one in self.stages])[stage],
            ambient,
        )

    def measured(self, first: int, end: int) -> OperatingProfile:
        """Speed, load and ambient as they were measured, from a row on."""
        rows = slice(first, end)
        return hold_operating_point(
            OperatingProfile(
                self.minutes.time_s[rows] - self.minutes.time_s[first],
                self.minutes.speed_rpm[rows],
                self.minutes.load_n[rows],
                self.minutes.ambient_c[rows],
            )
        )


def run_bench(
    parameters: BenchParameters,
    stages: Sequence[Stage],
    seed: int,
    *,
    speed_ramp_rpm_per_s: float = 100.0,
    node_sensors: bool = False,
) -> BenchRun:
    """Run a bench from cold and measure it.

    - ``stages``: what it runs, one after the other.
    - ``seed``: of ambient and sensors.
    - ``speed_ramp_rpm_per_s``: how fast the drive follows a new set-point.
    - ``node_sensors``: whether temperature sensors of the same kind sit in the paper's 13 nodes as
      well.
    """
    steps = tuple(
        BenchPhase(
            f"{one.speed_rpm:g} rpm {one.load_n:g} N", 60.0 * one.minutes, *one[1:], risk="high"
        )
        for one in stages
    )
    scenario = Scenario(
        "study", "", parameters.bearing, steps, speed_ramp_rpm_per_s=speed_ramp_rpm_per_s
    )
    profile = scenario_profile(scenario, parameters, seed)
    run = simulate(profile, parameters)
    seen = measure(profile, run, seed)
    truth = {
        "t_inner_ring_c": run.t_inner_ring_c,
        "t_outer_ring_c": run.t_outer_ring_c,
        **dict(zip(NODES, run.paper_nodes_c.T, strict=True)),
    }
    readings = {name: getattr(seen, name) for name in RINGS}
    if node_sensors:
        for channel, name in enumerate(NODES, start=_FIRST_NODE_CHANNEL):
            chain = Pt100(seed, channel, float(truth[name][0]), SensorParameters())
            readings[name] = chain.convert(truth[name])
    count = sum(one.minutes for one in stages)
    operating = {name: getattr(seen, name) for name in ("speed_rpm", "load_n", "ambient_c")}
    minutes = rows_of_samples(seen.time_s, operating, readings).take(slice(0, count))
    rows = slice(0, SECONDS * count, SECONDS)
    return BenchRun(
        parameters.bearing,
        tuple(stages),
        minutes,
        {name: values[rows].copy() for name, values in truth.items()},
    )


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """A twin identified from the first rows of a run.

    - ``model``, ``result``: the model and what was found.
    - ``rows``: how many rows were used.
    - ``sensors``: the temperature sensors that were used.
    - ``seconds``: how long the identification took.
    """

    model: ThermalModel
    result: IdentificationResult
    rows: int
    sensors: tuple[str, ...]
    seconds: float

    @property
    def may_forecast(self) -> bool:
        """Whether the fit is good enough for its forecasts to be shown."""
        return self.result.status == "converged"

    @property
    def posterior(self) -> Posterior:
        """What is known of the parameters."""
        return self.result.posterior


def identify_twin(
    run: BenchRun,
    rows: int,
    *,
    model_name: str = "default",
    sensors: tuple[str, ...] = RINGS,
    seed: int = 0,
) -> Twin:
    """Identify a twin from the first rows of a run, with the default method.

    - ``run``: a bench that started cold.
    - ``rows``: how many rows are used.
    - ``model_name``: see `twin_core.models.build_model`.
    - ``sensors``: names of the temperatures that are used.
    """
    model = build_model(model_name, bearing=bearing(run.bearing))
    low = with_sensors(run.minutes.take(slice(0, rows)), sensors)
    data = IdentificationData((IdentificationWindow(low, at_rest=True),))
    begun = time.perf_counter()
    result = identify(model, data, FitSettings(seed=seed))
    return Twin(model, result, rows, sensors, time.perf_counter() - begun)


def with_sensors(minutes: MinuteData, sensors: Sequence[str]) -> MinuteData:
    """The same rows with some of the temperature sensors only."""
    return MinuteData(
        minutes.time_s,
        minutes.speed_rpm,
        minutes.load_n,
        minutes.ambient_c,
        {name: minutes.temperatures_c[name] for name in sensors},
        minutes.good,
    )


def forecast_from(twin: Twin, run: BenchRun, first: int, ahead: OperatingProfile) -> Forecast:
    """Forecast from a row of a run, its observer having followed the machine up to there.

    - ``twin``: identified from rows up to ``first``.
    - ``first``: the present row; 0 for a forecast of a cold start.
    - ``ahead``: n rows; the first is the present one.
    """
    state = follow(twin, run, first).state(float(ahead.ambient_c[0]))
    return forecast(twin.model, twin.posterior, state, ahead)


def follow(twin: Twin, run: BenchRun, last: int) -> Observer:
    """The observer after the readings of row ``last``."""
    values = twin.model.parameters.values_from_z(twin.posterior.z)
    rows = run.measured(0, last + 1)
    columns = [run.minutes.temperatures_c[name].tolist() for name in twin.sensors]
    readings = [dict(zip(twin.sensors, row, strict=True)) for row in zip(*columns, strict=True)]
    cold = Point(0.0, 0.0, float(rows.ambient_c[0]))
    return run_filter(begin(twin.model, values, readings[0], cold, at_rest=True), rows, readings)
