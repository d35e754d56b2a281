"""The operating profile that lies ahead: the controller's plan, or the present point held."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adapters.samples import PlannedProfile, PlanStep
from twin_core.profiles import OperatingPoint
from twin_core.simulation import OperatingProfile

# A measured speed or load this close to the step's set-point says better what the machine does.
_NEAR_SETPOINT = 0.06


@dataclass(frozen=True, slots=True)
class Step:
    """A span of constant operation ahead."""

    duration_s: float
    speed_rpm: float
    load_n: float
    ambient_c: float


def held(present: OperatingPoint, horizon_s: float) -> list[Step]:
    """The present point, held over the horizon."""
    return [Step(horizon_s, present.speed_rpm, present.load_n, present.ambient_c)]


def planned(
    plan: PlannedProfile, now_us: int, present: OperatingPoint, horizon_s: float
) -> list[Step]:
    """What is left of a controller's plan, cut at the horizon; empty when it is over.

    The step under way follows the measured speed and load where these are near their set-points,
    the later ones follow the plan. Ambient stays as it is. A plan that was read a little after
    ``now_us`` (the estimate lags by up to a step) is stretched back to it.
    """
    elapsed_s = (now_us - plan.time_us) / 1e6
    steps: list[Step] = []
    left_s = horizon_s
    for planned_step in plan.steps:
        duration_s = planned_step.duration_s - elapsed_s
        elapsed_s = max(-duration_s, 0.0)
        if duration_s <= 0:
            continue
        under_way = not steps
        steps.append(_step(planned_step, min(duration_s, left_s), present, under_way))
        left_s -= steps[-1].duration_s
        if left_s <= 0:
            break
    return steps


def _step(planned: PlanStep, duration_s: float, present: OperatingPoint, under_way: bool) -> Step:
    speed_rpm, load_n = planned.speed_rpm, planned.load_n
    if under_way and abs(present.speed_rpm - speed_rpm) <= _NEAR_SETPOINT * speed_rpm:
        speed_rpm = present.speed_rpm
    if under_way and abs(present.load_n - load_n) <= _NEAR_SETPOINT * load_n:
        load_n = present.load_n
    return Step(duration_s, speed_rpm, load_n, present.ambient_c)


def operating_profile(
    steps: Sequence[Step], row_s: float, inputs: Sequence[float] = ()
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
    edges = np.concatenate(([0.0], np.cumsum([step.duration_s for step in steps])))
    rows = np.arange(0.0, edges[-1], row_s)
    time_s = np.unique(np.round(np.concatenate((rows, edges)), 3))
    index = np.clip(np.searchsorted(edges, time_s + 5e-4, side="right") - 1, 0, len(steps) - 1)
    return OperatingProfile(
        time_s=time_s,
        speed_rpm=np.array([step.speed_rpm for step in steps])[index],
        load_n=np.array([step.load_n for step in steps])[index],
        ambient_c=np.array([step.ambient_c for step in steps])[index],
        inputs=np.tile(np.array(inputs, dtype=np.float64), (time_s.size, 1)),
    )
