"""Excitation advice: which low-risk step to run next, so that a high-risk forecast narrows most.

Steps are constant levels of speed and load inside the low-risk region, one or two per step. They
are ranked by the 95 % interval that the forecast at the named point would have after them
(`twin_core.forecasting.design`), on the cautious assumption that the friction of a machine is not
quite the same from one stage to the next. That is what makes a pair of loads better than one load
for as long: the difference of the pair stays when both are shifted.

Where a thermal runaway at the point is not excluded, the probability of one that would be left
comes first: it follows from the same prediction, of the difference between the rings.

Of all steps one is the next: what brings most within twenty minutes. With an asked half-width it is
the shortest that reaches it, and none once the forecast is as narrow as that.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core import TwinCoreError
from twin_core.forecasting.candidates import candidates, why_not
from twin_core.forecasting.design import Design, held_profile
from twin_core.forecasting.ensemble import forecast
from twin_core.forecasting.envelope import Envelope, envelope
from twin_core.forecasting.labels import RUNAWAY, runaway_likely
from twin_core.forecasting.margins import heaviest_margin
from twin_core.forecasting.runaway import RunawayDistance, log_odds, runaway_probability
from twin_core.forecasting.stepping import SteppingLevel, stepping_plan
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.network_model import RunawayLimits
from twin_core.operating_points import (
    NEW_SPEED,
    OperatingSpan,
    alike,
    alike_points,
)
from twin_core.profiles import Step
from twin_core.windows import LowRiskRegion

FloatArray = NDArray[np.float64]

# Steps whose intervals differ by less than this are distinguished by how long they take.
_ALIKE_WIDTHS = 1.03
# Steps whose odds of a runaway differ by less than this are distinguished by their intervals.
_ALIKE_ODDS = 1.25
_WORTH_WHILE = 0.10
# The ensemble's band beyond the fastest speed that was run is wider than a linear prediction has it
# by this part for each factor of e; on benches 100 to 117.
_SPEED_TAIL = 0.6
NEXT_S = 1200.0
"""A longer step is the next one only where no shorter one is worth while."""


class NothingIdentifiedError(TwinCoreError, ValueError):
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
class Recommendation:
    """A feasible step and what it is expected to bring."""

    levels: tuple[Step, ...]  # in time order
    #: Per sensor, half the 95 % interval at the target expected after the step.
    half_width_k: Mapping[str, float]
    #: The same if the friction during the step is shifted; steps are ranked by it.
    cautious_half_width_k: Mapping[str, float]
    #: Of a runaway at the target, expected after the step on the same assumption if the machine is
    #: what it is taken for; None where it was not tested (`RunawayLimits`).
    runaway_probability: float | None
    #: By which part `cautious_half_width_k` of the decisive sensor is narrower than now.
    narrower_by: float
    #: Per sensor, the highest upper edge (97.5 %) of its forecast during the step, once a machine
    #: that is too hot at present has cooled down.
    peak_c: Mapping[str, float]
    why: str

    @property
    def duration_s(self) -> float:
        """Length of the whole step."""
        return sum(level.duration_s for level in self.levels)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A step inside the low-risk region that must not, or need not, be run, and why."""

    levels: tuple[Step, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Advice:
    """What to run next, what not, and how to approach the target itself."""

    target: Step
    sensor: str  # the decisive sensor: the one with the widest interval at the target
    now: Mapping[str, TargetForecast]  # present forecast at the end of the target, per sensor
    labels: tuple[str, ...]  # what must be said with it; see `twin_core.forecasting.labels`
    #: How far the machine is from a thermal runaway at the target, held for hours; None for a
    #: machine that has no limits of one.
    margin: RunawayDistance | None
    #: Whether steps are ranked by the probability of a runaway that they leave, and then by the
    #: interval; else by the interval alone.
    by_runaway: bool
    steps: tuple[Recommendation, ...]  # feasible steps, best first
    excluded: tuple[Exclusion, ...]
    asked_k: float | None  # half-width at which the forecast is narrow enough; None: not asked
    #: Levels towards the target with what to look at on each: the stop rule.
    stepping: tuple[SteppingLevel, ...]

    @property
    def reached(self) -> bool:
        """Whether the forecast is as narrow as was asked: nothing more is needed for it."""
        return self.asked_k is not None and self.now[self.sensor].half_width_k <= self.asked_k

    @property
    def worth_while(self) -> bool:
        """Whether the best step narrows the interval by a tenth or more."""
        return bool(self.steps) and self.steps[0].narrower_by >= _WORTH_WHILE

    @property
    def next_step(self) -> Recommendation | None:
        """What to run now: the best step within `NEXT_S`, a longer one where none is worth while.

        None where the asked half-width is reached, or no step is worth while.
        """
        soon = [step for step in self.steps if step.duration_s <= NEXT_S]
        worth = (step for step in (*soon, *self.steps) if step.narrower_by >= _WORTH_WHILE)
        return None if self.reached else next(worth, None)


def advise(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    target: Step,
    region: LowRiskRegion,
    limits: Mapping[str, float],
    *,
    alarm_limits: Mapping[str, float] | None = None,
    measured: Collection[str] | None = None,
    half_width_k: float | None = None,
    members: int = 200,
) -> Advice:
    """Rank low-risk steps by how much they would narrow the forecast at a point, and name the next.

    Steps and target begin at `state`, the machine now. `limits` in degC, per sensor, are what no
    upper edge of a step may reach (warnings); `alarm_limits` those on the way to the target, by
    default the same. `measured` are the sensors and nodes at which the machine has a sensor, by
    default the model's standard sensors; `half_width_k` is how narrow the forecast is to become:
    steps that reach it are alike but for how long they take; `members` are those of the ensemble
    that gives the present interval.

    Raises `NothingIdentifiedError` before the first identification, `ValueError` if posterior and
    model do not belong together, or the target is not a running machine.
    """
    posterior.check(model)
    model = model.holding(state.inputs)
    _check(posterior, target, half_width_k)
    sensors = model.sensor_names
    ahead = held_profile((target,), state.ambient_c, state.inputs)
    made = forecast(model, posterior, state, ahead, members=members)
    now = {name: _at_end(made.quantile(name)) for name in sensors}
    decisive = max(sensors, key=lambda name: now[name].half_width_k)
    margin = heaviest_margin(model, posterior, state, ahead)
    by_runaway = RUNAWAY in made.labels and bool(model.runaway and model.runaway.tested)
    all_steps = list(candidates(posterior.trained.operating_points, target, region))
    comparison = _Comparison(
        model,
        posterior,
        Design(model, posterior, state, sensors, sensors if measured is None else measured, target),
        now,
        decisive,
        envelope(model, posterior, state, [target.speed_rpm], [target.load_n], {}),
        _running_away(model, posterior, state, all_steps),
        limits,
        margin.probability if by_runaway and margin is not None else None,
    )
    ranked, excluded = comparison.ranked(all_steps, by_runaway, half_width_k or 0.0)
    return Advice(
        target=target,
        sensor=decisive,
        now=now,
        labels=made.labels,
        margin=margin,
        by_runaway=by_runaway,
        steps=ranked,
        excluded=excluded,
        asked_k=half_width_k,
        stepping=stepping_plan(
            model, posterior, state, target, limits if alarm_limits is None else alarm_limits
        ),
    )


def _at_end(quantiles_c: FloatArray) -> TargetForecast:
    return TargetForecast(*(float(quantiles_c[row, -1]) for row in (0, 2, 4)))


def _check(posterior: Posterior, target: Step, half_width_k: float | None) -> None:
    if not posterior.identified:
        raise NothingIdentifiedError(
            "no identified model yet: run low-risk windows and identify first"
        )
    if target.speed_rpm <= 0.0 or target.load_n < 0.0 or target.duration_s <= 0.0:
        raise ValueError(
            f"target is {target}, expected a positive speed and duration and a load from 0 up"
        )
    if half_width_k is not None and not half_width_k > 0.0:
        raise ValueError(f"half_width_k is {half_width_k}, expected more than 0 K")


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """What every step is compared with."""

    model: ThermalModel
    posterior: Posterior
    design: Design
    now: Mapping[str, TargetForecast]
    decisive: str  # the sensor with the widest interval at the target
    at_target: Envelope
    lost: Mapping[tuple[float, float], float]  # see `_running_away`
    limits: Mapping[str, float]
    runaway_probability: float | None  # at the target now, where steps are ranked by it

    def ranked(
        self, steps: Sequence[tuple[Step, ...]], by_runaway: bool, wanted_k: float
    ) -> tuple[tuple[Recommendation, ...], tuple[Exclusion, ...]]:
        """Return the steps that may be run, best first, and the others."""
        judged = [self.of(levels) for levels in steps]
        found = (step for step in judged if isinstance(step, Recommendation))
        return (
            tuple(sorted(found, key=lambda one: _rank(one, self.decisive, by_runaway, wanted_k))),
            tuple(step for step in judged if isinstance(step, Exclusion)),
        )

    def of(self, levels: tuple[Step, ...]) -> Recommendation | Exclusion:
        """Say what a step brings, or why it must not be run."""
        trained, sensors = self.posterior.trained.operating_points, self.model.sensor_names
        if reason := why_not(levels, trained):
            return Exclusion(levels, reason)
        after, design, limits = self.design.after(levels), self.design, self.model.runaway
        peaks = _peak_c(after.upper_c, sensors, self.limits).tolist()
        peak = dict(zip(sensors, peaks, strict=True))
        if reason := _too_hot(peak, self.limits) or _own_runaway(levels, self.lost):
            return Exclusion(levels, reason)
        left = None
        if limits is not None and limits.tested:
            kept = after.shifted_difference_std_k / design.difference_std_k
            left = _probability_left(self.posterior, limits, self.at_target, kept)
        target, run = design.target, self.posterior.trained.speed_rpm_max
        fastest = max(run, *(level.speed_rpm for level in levels))
        beyond = float(np.log(max(target.speed_rpm / fastest, 1.0)))
        plain, cautious = (
            _narrowed(self.now, std_k, design.std_k, beyond)
            for std_k in (after.std_k, after.shifted_std_k)
        )
        narrower = 1.0 - cautious[self.decisive] / self.now[self.decisive].half_width_k
        why = _why(levels, trained, narrower)
        if self.runaway_probability is not None and left is not None:
            now_percent, left_percent = 100.0 * self.runaway_probability, 100.0 * left
            why += f"; runaway there {now_percent:.1f} % now, {left_percent:.1f} % expected after"
        return Recommendation(levels, plain, cautious, left, narrower, peak, why)


def _probability_left(
    posterior: Posterior, limits: RunawayLimits | None, at_target: Envelope, kept: float
) -> float:
    """Probability of a runaway once the spread of the rings' difference has shrunk to a part."""
    median_k, upper_k = at_target.ring_difference_k[:, 0, 0]
    left_k = median_k + kept * (upper_k - median_k) if np.isfinite(upper_k) else upper_k
    return float(runaway_probability(posterior, left_k, at_target.runaway_share[0, 0], limits))


def _rank_of_odds(probability: float | None) -> int:
    """Number of the class of odds that are alike."""
    return 0 if probability is None else round(float(log_odds(probability)) / np.log(_ALIKE_ODDS))


def _running_away(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    steps: Sequence[Sequence[Step]],
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


def _own_runaway(levels: Sequence[Step], lost: Mapping[tuple[float, float], float]) -> str | None:
    """Say at which level of a step itself the machine may run away; None if at none."""
    for level in levels:
        probability = lost.get((level.speed_rpm, level.load_n))
        if probability is not None:
            return (
                f"thermal runaway not excluded at {level.speed_rpm:.0f} rpm, {level.load_n:.0f} N "
                f"itself: {100.0 * probability:.0f} %"
            )
    return None


def _narrowed(
    now: Mapping[str, TargetForecast], after_k: FloatArray, now_k: FloatArray, beyond: float
) -> dict[str, float]:
    """Half-widths after a step, by sensor, from linear deviations after it and now.

    By what part the ensemble's interval is wider than the linear one shrinks as the deviation does:
    it comes from the curvature. That of the speed law, `beyond` (logarithm) the fastest speed that
    was run, stays.
    """
    found = {}
    for k, (name, present) in enumerate(now.items()):
        half_k = present.half_width_k
        curved = (half_k / (1.96 * now_k[k]) - 1.0) * after_k[k] / now_k[k]
        wider = 1.0 + max(curved, _SPEED_TAIL * beyond)
        found[name] = float(min(1.96 * after_k[k] * wider, half_k))
    return found


def _rank(
    step: Recommendation, decisive: str, by_runaway: bool, wanted_k: float
) -> tuple[float, ...]:
    """The lower, the better: odds of a runaway, interval, duration, temperature."""
    left_k = max(step.cautious_half_width_k[decisive], wanted_k)
    return (
        _rank_of_odds(step.runaway_probability) if by_runaway else 0,
        round(np.log(left_k) / np.log(_ALIKE_WIDTHS)),
        step.duration_s,
        step.peak_c[decisive],
    )


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


def _why(levels: Sequence[Step], trained: Sequence[OperatingSpan], narrower_by: float) -> str:
    first = levels[0]
    known_speed = any(alike(first.speed_rpm, p.speed_rpm, NEW_SPEED) for p in trained)
    moment = OperatingSpan(first.speed_rpm, first.load_n, first.duration_s, 0.0)
    if first.speed_rpm != levels[-1].speed_rpm:
        text = "two speeds at one load: their difference shows the speed law, not the load law"
    elif len(levels) > 1:
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
