"""Excitation advice: which low-risk step to run next, so that a high-risk forecast narrows most.

Steps are constant levels of speed and load inside the low-risk region, one or two per step. They
are ranked by the 95 % interval that the forecast at the named point would have after them
(`twin_core.forecasting.design`), on the cautious assumption that the friction of a machine is not
quite the same from one stage to the next. That is what makes a pair of loads better than one load
for as long: the difference of the pair stays when both are shifted.

Where a thermal runaway at the point is not excluded, the probability of one that would be left
comes first: it follows from the same prediction, of the difference between the rings.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from twin_core.forecasting.candidates import candidates, why_not
from twin_core.forecasting.design import Design, Level, held_profile
from twin_core.forecasting.ensemble import forecast
from twin_core.forecasting.envelope import Envelope, envelope
from twin_core.forecasting.labels import RUNAWAY, runaway_likely
from twin_core.forecasting.margins import heaviest_margin
from twin_core.forecasting.runaway import RunawayMargin, runaway_probability
from twin_core.forecasting.stepping import LoadStep, stepping_plan
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.network_model import RunawayLimits
from twin_core.operating_points import (
    NEW_SPEED,
    OperatingPoint,
    alike,
    alike_points,
)
from twin_core.windows import LowRiskRegion

FloatArray = NDArray[np.float64]

# Steps whose intervals differ by less than this are distinguished by how long they take.
_ALIKE_WIDTHS = 1.03
# Steps whose odds of a runaway differ by less than this are distinguished by their intervals.
_ALIKE_ODDS = 1.25
_WORTH_WHILE = 0.10


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
    runaway_probability
        Of a runaway at the target, expected after the step on the same assumption if the machine
        is what it is taken for; None where it was not tested (`RunawayLimits`).
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
    runaway_probability: float | None
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
    margin
        How far the machine is from a thermal runaway at the target, held for hours; None for a
        machine that has no limits of one.
    by_runaway
        Whether steps are ranked by the probability of a runaway that they leave, and then by the
        interval; else by the interval alone.
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
    margin: RunawayMargin | None
    by_runaway: bool
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
    margin = heaviest_margin(
        model, posterior, state, held_profile((target,), state.ambient_c, state.inputs)
    )
    at_target = envelope(model, posterior, state, [target.speed_rpm], [target.load_n], {})
    tested = model.runaway is not None and model.runaway.tested
    by_runaway = tested and RUNAWAY in made.labels
    trained = posterior.trained.operating_points
    all_steps = list(candidates(trained, target, region))
    lost = _running_away(model, posterior, state, all_steps)
    ranked, excluded = [], []
    for levels in all_steps:
        reason = why_not(levels, trained)
        if reason is not None:
            excluded.append(ExcludedStep(levels, reason))
            continue
        std_k, cautious_std_k, difference_std_k, upper_c = design.after(levels)
        # The ensemble's interval, narrowed as the linear prediction says.
        plain, cautious = (
            {
                name: now[name].half_width_k * float(after[k] / design.std_k[k])
                for k, name in enumerate(sensors)
            }
            for after in (std_k, cautious_std_k)
        )
        peak = dict(zip(sensors, _peak_c(upper_c, sensors, limits).tolist(), strict=True))
        if reason := _too_hot(peak, limits) or _own_runaway(levels, lost):
            excluded.append(ExcludedStep(levels, reason))
            continue
        narrower = 1.0 - cautious[decisive] / now[decisive].half_width_k
        left = None
        if tested:
            kept = difference_std_k / design.difference_std_k
            left = _probability_left(posterior, model.runaway, at_target, kept)
        why = _why(levels, trained, narrower)
        if by_runaway and left is not None and margin is not None:
            now_percent, left_percent = 100.0 * margin.probability, 100.0 * left
            why += f"; runaway there {now_percent:.1f} % now, {left_percent:.1f} % expected after"
        ranked.append(RankedStep(levels, plain, cautious, left, narrower, peak, why))
    ranked.sort(
        key=lambda step: (
            _rank_of_odds(step.runaway_probability) if by_runaway else 0,
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
        margin=margin,
        by_runaway=by_runaway,
        steps=tuple(ranked),
        excluded=tuple(excluded),
        worth_while=bool(ranked) and ranked[0].narrower_by >= _WORTH_WHILE,
        stepping=stepping_plan(
            model, posterior, state, target, limits if alarm_limits is None else alarm_limits
        ),
    )


def _probability_left(
    posterior: Posterior, limits: RunawayLimits | None, at_target: Envelope, kept: float
) -> float:
    """Probability of a runaway once the spread of the rings' difference has shrunk to a part."""
    median_k, upper_k = at_target.ring_difference_k[:, 0, 0]
    left_k = median_k + kept * (upper_k - median_k) if np.isfinite(upper_k) else upper_k
    return float(runaway_probability(posterior, left_k, at_target.runaway_share[0, 0], limits))


def _rank_of_odds(probability: float | None) -> int:
    """Number of the class of odds that are alike."""
    return 0 if probability is None else round(float(logit(probability)) / np.log(_ALIKE_ODDS))


def _running_away(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    steps: Sequence[Sequence[Level]],
) -> Mapping[tuple[float, float], float]:
    """Levels, (rpm, N), at which a runaway is too probable for a low-risk step: how probable."""
    speeds = sorted({level.speed_rpm for levels in steps for level in levels})
    loads = sorted({level.load_n for levels in steps for level in levels})
    if not speeds:
        return {}
    found = envelope(model, posterior, state, speeds, loads, {})
    likely = runaway_likely(posterior, found.runaway_probability, model.runaway)
    return {
        (speeds[column], loads[row]): float(found.runaway_probability[row, column])
        for row, column in np.argwhere(likely)
    }


def _own_runaway(levels: Sequence[Level], lost: Mapping[tuple[float, float], float]) -> str | None:
    """Say at which level of a step itself the machine may run away; None if at none."""
    for level in levels:
        probability = lost.get((level.speed_rpm, level.load_n))
        if probability is not None:
            return (
                f"thermal runaway not excluded at {level.speed_rpm:.0f} rpm, {level.load_n:.0f} N "
                f"itself: {100.0 * probability:.0f} %"
            )
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
