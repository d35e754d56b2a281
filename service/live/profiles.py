"""The operating profile that lies ahead: the controller's plan, or the present point held."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from adapters.samples import PlannedProfile, PlanStep
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile

# A measured speed or load this close to the step's set-point says better what the machine does.
_NEAR_SETPOINT = 0.06


@dataclass(frozen=True, slots=True)
class StepAhead:
    """A span of constant operation ahead.

    `plan` is the row of the controller's plan that it follows, with the whole time that is left
    of it; None where nothing is planned.
    """

    duration_s: float
    speed_rpm: float
    load_n: float
    ambient_c: float
    plan: PlanStep | None = None


def held(present: Point, horizon_s: float) -> list[StepAhead]:
    """The present point, held over the horizon."""
    return [StepAhead(horizon_s, present.speed_rpm, present.load_n, present.ambient_c)]


def planned(plan: PlannedProfile, now_us: int, present: Point, horizon_s: float) -> list[StepAhead]:
    """What is left of a controller's plan, cut at the horizon; empty when it is over.

    The step under way follows the measured speed and load where these are near their set-points,
    the later ones follow the plan. Ambient stays as it is. A plan that was read a little after
    ``now_us`` (the estimate lags by up to a step) is stretched back to it.
    """
    elapsed_s = (now_us - plan.time_us) / 1e6
    steps: list[StepAhead] = []
    left_s = horizon_s
    for planned_step in plan.steps:
        duration_s = planned_step.duration_s - elapsed_s
        elapsed_s = max(-duration_s, 0.0)
        if duration_s <= 0:
            continue
        under_way = not steps
        row = planned_step._replace(duration_s=duration_s)
        steps.append(_step(row, min(duration_s, left_s), present, under_way))
        left_s -= steps[-1].duration_s
        if left_s <= 0:
            break
    return steps


def _step(planned: PlanStep, duration_s: float, present: Point, under_way: bool) -> StepAhead:
    speed_rpm, load_n = planned.speed_rpm, planned.load_n
    if under_way and abs(present.speed_rpm - speed_rpm) <= _NEAR_SETPOINT * speed_rpm:
        speed_rpm = present.speed_rpm
    if under_way and abs(present.load_n - load_n) <= _NEAR_SETPOINT * load_n:
        load_n = present.load_n
    return StepAhead(duration_s, speed_rpm, load_n, present.ambient_c, planned)


def operating_profile(
    steps: Sequence[StepAhead], row_s: float, inputs: Sequence[float] = ()
) -> OperatingProfile:
    """Rows every ``row_s`` seconds and at every change of step, counted from now.

    Parameters
    ----------
    steps : sequence of Step
        At least one step of positive duration.
    row_s : float
        Spacing of the rows in seconds.
    inputs : sequence of float
        Those of a network of one's own, which stay as they are.
    """
    time_s, index = _rows(tuple(step.duration_s for step in steps), row_s)
    return OperatingProfile(
        time_s=time_s,
        speed_rpm=np.array([step.speed_rpm for step in steps])[index],
        load_n=np.array([step.load_n for step in steps])[index],
        ambient_c=np.array([step.ambient_c for step in steps])[index],
        inputs=np.tile(np.array(inputs, dtype=np.float64), (time_s.size, 1)),
    )


@lru_cache(maxsize=64)
def _rows(
    durations_s: tuple[float, ...], row_s: float
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Times of the rows, and the step of each: of a point that is held always the same."""
    edges = np.concatenate(([0.0], np.cumsum(durations_s)))
    rows = np.arange(0.0, edges[-1], row_s)
    time_s = np.unique(np.round(np.concatenate((rows, edges)), 3))
    index = np.searchsorted(edges, time_s + 5e-4, side="right") - 1
    return time_s, np.clip(index, 0, len(durations_s) - 1)
