"""Excitation advice: which low-risk step to run next, so that a high-risk forecast narrows most.

Steps are constant levels of speed and load inside the low-risk region, one or two per step. They
are ranked by the 95 % interval that the forecast at the named point would have after them
(`twin_core.forecasting.design`), on the cautious assumption that the friction of a machine is not
quite the same from one stage to the next. That is what makes a pair of loads better than one load
for as long: the difference of the pair stays when both are shifted.

One thing the linear prediction cannot see is product behaviour here: a step never changes speed
and load at once against what the data hold. Offline, on random virtual benches, such a step booked
the error of the speed law on the load law and made the forecast far worse than no step (7.9 K
against 0.7 K at 4000 N, coverage 77 %), though it looked informative.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.design import Design, Level, held_profile
from twin_core.forecasting.ensemble import forecast
from twin_core.forecasting.stepping import LoadStep, stepping_plan
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import (
    NEW_LOAD,
    NEW_SPEED,
    OperatingPoint,
    alike,
    alike_points,
    distinct_values,
)
from twin_core.windows import MEASURED_TOLERANCE, LowRiskRegion

FloatArray = NDArray[np.float64]

LOAD_FRACTIONS = (0.4, 0.6, 0.8, 1.0)
SPEED_FRACTIONS = (0.6, 1.0)
SINGLE_DURATIONS_S = (2700.0, 5400.0)
PAIR_DURATIONS_S = (2700.0, 3600.0)
_ROUND_LOAD_N = 50.0
_ROUND_SPEED_RPM = 50.0
_LEAST_LOAD_RATIO = 1.15
# Steps whose intervals differ by less than this are distinguished by how long they take.
_ALIKE_WIDTHS = 1.03
_WORTH_WHILE = 0.10
_TAUGHT_S = 1200.0


class NothingIdentifiedError(ValueError):
    """There is no identified model yet that a step could improve."""


@dataclass(frozen=True, slots=True)
class TargetForecast:
    """The present forecast of one sensor at the end of the target: quantiles in degC."""

    q025: float
    q50: float
    q975: float

    @property
    def half_width_k(self) -> float:
        """Half the width of the 95 % interval."""
        return 0.5 * (self.q975 - self.q025)


@dataclass(frozen=True, slots=True)
class RankedStep:
    """A feasible step and what it is expected to bring.

    Attributes
    ----------
    levels
        In time order.
    half_width_k
        Per sensor, half the 95 % interval at the target expected after the step.
    cautious_half_width_k
        The same if the friction during the step is shifted; steps are ranked by it.
    narrower_by
        By which part `cautious_half_width_k` of the decisive sensor is narrower than now.
    peak_c
        Per sensor, the highest upper edge (97.5 %) of its forecast during the step, once a
        machine that is too hot at present has cooled down.
    why
        One line for people.
    """

    levels: tuple[Level, ...]
    half_width_k: Mapping[str, float]
    cautious_half_width_k: Mapping[str, float]
    narrower_by: float
    peak_c: Mapping[str, float]
    why: str

    @property
    def duration_s(self) -> float:
        """Length of the whole step."""
        return sum(level.duration_s for level in self.levels)


@dataclass(frozen=True, slots=True)
class ExcludedStep:
    """A step inside the low-risk region that must not, or need not, be run, and why."""

    levels: tuple[Level, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Advice:
    """What to run next, what not, and how to approach the target itself.

    Attributes
    ----------
    target
        The point asked for.
    sensor
        The decisive sensor: the one with the widest interval at the target.
    now
        Present forecast at the end of the target, per sensor.
    labels
        What must be said with it; see `twin_core.forecasting.labels`.
    steps
        Feasible steps, best first.
    excluded
        Steps that were left out, with reasons.
    worth_while
        Whether the best step narrows the interval by a tenth or more.
    stepping
        Levels towards the target with what to look at on each: the stop rule.
    """

    target: Level
    sensor: str
    now: Mapping[str, TargetForecast]
    labels: tuple[str, ...]
    steps: tuple[RankedStep, ...]
    excluded: tuple[ExcludedStep, ...]
    worth_while: bool
    stepping: tuple[LoadStep, ...]


def advise(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    target: Level,
    region: LowRiskRegion,
    limits: Mapping[str, float],
    *,
    alarm_limits: Mapping[str, float] | None = None,
    measured: Collection[str] | None = None,
    members: int = 200,
    seed: int = 0,
) -> Advice:
    """Rank low-risk steps by how much they would narrow the forecast at a point.

    Parameters
    ----------
    model, posterior
        What is known of the machine, identified from low-risk data.
    state
        The machine now; steps and target begin here.
    target
        The point that is to be forecast, and for how long it is to be held.
    region
        Where the machine may always run.
    limits
        Temperatures in degC that no upper edge of a step may reach, per sensor (warnings).
    alarm_limits
        Temperatures that no upper edge on the way to the target may reach; `limits` if not given.
    measured
        Names of the sensors and nodes at which the machine has a sensor; the model's standard
        sensors if not given.
    members, seed
        Of the ensemble that tells the present interval.

    Raises
    ------
    NothingIdentifiedError
        Before the first identification.
    ValueError
        If posterior and model do not belong together, or the target is not a running machine.
    """
    posterior.check(model)
    model = model.holding(state.inputs)
    if not posterior.identified:
        raise NothingIdentifiedError(
            "no identified model yet: run low-risk windows and identify first"
        )
    if target.speed_rpm <= 0.0 or target.load_n < 0.0 or target.duration_s <= 0.0:
        raise ValueError(
            f"target is {target}, expected a positive speed and duration and a load from 0 up"
        )
    sensors = model.sensor_names
    made = forecast(
        model,
        posterior,
        state,
        held_profile((target,), state.ambient_c, state.inputs),
        members=members,
        seed=seed,
    )
    now = {
        name: TargetForecast(*(float(made.quantile(name)[row, -1]) for row in (0, 2, 4)))
        for name in sensors
    }
    decisive = max(sensors, key=lambda name: now[name].half_width_k)
    has = sensors if measured is None else measured
    design = Design(model, posterior, state, sensors, has, target)
    trained = posterior.trained.operating_points
    ranked, excluded = [], []
    for levels in candidates(trained, target, region):
        reason = why_not(levels, trained)
        if reason is not None:
            excluded.append(ExcludedStep(levels, reason))
            continue
        std_k, cautious_std_k, upper_c = design.after(levels)
        # The ensemble's interval, narrowed as the linear prediction says.
        plain, cautious = (
            {
                name: now[name].half_width_k * float(after[k] / design.std_k[k])
                for k, name in enumerate(sensors)
            }
            for after in (std_k, cautious_std_k)
        )
        peak = dict(zip(sensors, _peak_c(upper_c, sensors, limits).tolist(), strict=True))
        if reason := _too_hot(peak, limits):
            excluded.append(ExcludedStep(levels, reason))
            continue
        narrower = 1.0 - cautious[decisive] / now[decisive].half_width_k
        ranked.append(
            RankedStep(levels, plain, cautious, narrower, peak, _why(levels, trained, narrower))
        )
    ranked.sort(
        key=lambda step: (
            round(np.log(step.cautious_half_width_k[decisive]) / np.log(_ALIKE_WIDTHS)),
            step.duration_s,
            step.peak_c[decisive],
        )
    )
    return Advice(
        target=target,
        sensor=decisive,
        now=now,
        labels=made.labels,
        steps=tuple(ranked),
        excluded=tuple(excluded),
        worth_while=bool(ranked) and ranked[0].narrower_by >= _WORTH_WHILE,
        stepping=stepping_plan(
            model, posterior, state, target, limits if alarm_limits is None else alarm_limits
        ),
    )


def candidates(
    trained: Sequence[OperatingPoint], target: Level, region: LowRiskRegion
) -> Iterator[tuple[Level, ...]]:
    """Steps worth comparing, all inside the region; those with both changed at once too.

    Speeds: that of the target if the region has it, those of the data, the region's highest and
    six tenths of it. Loads: four levels of the region's highest, and those of the data. Each as a
    single level, and in pairs of loads at one speed that differ by 15 % or more.
    """
    lasting = [point for point in trained if point.duration_s >= _TAUGHT_S]
    known_speeds = [_within(point.speed_rpm, region.speed_rpm_max) for point in lasting]
    known_loads = [_within(point.load_n, region.load_n_max) for point in lasting]
    highest = [_rounded(part * region.speed_rpm_max, _ROUND_SPEED_RPM) for part in SPEED_FRACTIONS]
    speeds = distinct_values(
        [
            speed
            for speed in (target.speed_rpm, *sorted(known_speeds, reverse=True), *highest)
            if 0.0 < speed <= region.speed_rpm_max
        ],
        NEW_SPEED,
    )
    heaviest = [_rounded(part * region.load_n_max, _ROUND_LOAD_N) for part in LOAD_FRACTIONS]
    loads = sorted(
        distinct_values(
            [load for load in (*known_loads, *heaviest) if 0.0 < load <= region.load_n_max],
            NEW_LOAD,
        )
    )
    for speed in speeds:
        untried = not any(alike(speed, known, NEW_SPEED) for known in known_speeds)
        for load in loads:
            for duration_s in SINGLE_DURATIONS_S:
                yield (Level(speed, load, duration_s),)
        for low in loads:
            for high in loads:
                if high < _LEAST_LOAD_RATIO * low:
                    continue
                # At an untried speed the first load must be one that the data know.
                first, second = low, high
                if untried and not any(alike(low, known, NEW_LOAD) for known in known_loads):
                    first, second = high, low
                for duration_s in PAIR_DURATIONS_S:
                    yield (Level(speed, first, duration_s), Level(speed, second, duration_s))


def why_not(levels: Sequence[Level], trained: Sequence[OperatingPoint]) -> str | None:
    """Say why a step must not be run for learning: speed and load changed at once; None if not.

    The first level must share its speed or its load with an operating point of the data; after
    it only one of the two may change from level to level.
    """
    known = [point for point in trained if point.duration_s >= _TAUGHT_S] or list(trained)
    first = levels[0]
    if not any(
        alike(first.speed_rpm, point.speed_rpm, NEW_SPEED)
        or alike(first.load_n, point.load_n, NEW_LOAD)
        for point in known
    ):
        nearest = min(
            known,
            key=lambda p: (
                abs(np.log(p.speed_rpm / first.speed_rpm))
                + abs(np.log(max(p.load_n, 1.0) / max(first.load_n, 1.0)))
            ),
            default=None,
        )
        against = (
            "" if nearest is None else f" ({nearest.speed_rpm:.0f} rpm, {nearest.load_n:.0f} N)"
        )
        return (
            f"changes speed and load at once against the data{against}: the error of the speed law "
            "would be attributed to the load law, and the forecast gets worse than without the step"
        )
    for before, after in pairwise(levels):
        if before.speed_rpm != after.speed_rpm and before.load_n != after.load_n:
            return "changes speed and load at once within the step"
    return None


def _peak_c(upper_c: FloatArray, sensors: Sequence[str], limits: Mapping[str, float]) -> FloatArray:
    """Highest upper edges (sensors,) of a step (rows, sensors).

    A machine that is over a limit at the beginning is given the time to cool down on the step: its
    peak counts from when all sensors are below their limits, if that ever happens.
    """
    below = np.all(upper_c < [limits.get(name, np.inf) for name in sensors], axis=1)
    return np.asarray(np.max(upper_c[int(np.argmax(below)) :], axis=0))


def _too_hot(peak_c: Mapping[str, float], limits: Mapping[str, float]) -> str | None:
    """Say which upper edge reaches a limit, or is not even finite; None if all stay below."""
    for name, upper_c in peak_c.items():
        if not np.isfinite(upper_c):
            return "too hot: thermal runaway of the twin there"
        if upper_c >= limits.get(name, np.inf):
            return (
                f"too hot: the upper edge of {name} reaches {upper_c:.0f} °C, its limit is "
                f"{limits[name]:g} °C"
            )
    return None


def _why(levels: Sequence[Level], trained: Sequence[OperatingPoint], narrower_by: float) -> str:
    first = levels[0]
    known_speed = any(alike(first.speed_rpm, p.speed_rpm, NEW_SPEED) for p in trained)
    moment = OperatingPoint(first.speed_rpm, first.load_n, first.duration_s, 0.0)
    if len(levels) > 1:
        text = (
            "two loads at one speed: their difference shows the load law, whatever else has shifted"
            if known_speed
            else "a new speed at a known load, then only the load moves"
        )
    elif any(alike_points(moment, point) for point in trained):
        text = "repeats a point of the data"
    elif known_speed:
        text = "only the load moves; a shift of the friction could be taken for the load law"
    else:
        text = "only the speed moves: shows the speed law, not the load law"
    return text if narrower_by >= _WORTH_WHILE else f"{text}; hardly anything new for this point"


def _within(value: float, highest: float) -> float:
    """A measured set-point: without its noise, which may have led it out of the region."""
    tidy = float(round(value, -1))
    return highest if highest < tidy <= (1.0 + MEASURED_TOLERANCE) * highest else tidy


def _rounded(value: float, to: float) -> float:
    return float(np.floor(value / to) * to)
