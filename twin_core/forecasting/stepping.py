"""The stop rule: how to approach a high-risk point in small steps, and when to turn back.

About one random virtual bench in thirty runs away thermally under heavy load though a moderate
load looks normal, and no forecast from low-risk data shows which. What is left is caution: small
steps of one quantity at a time, each held until steady, and a stop as soon as the machine is
hotter than the forecast said it could be, or could be too hot on the next level.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twin_core.forecasting.envelope import envelope
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import NEW_SPEED, alike
from twin_core.profiles import Step

LARGEST_RATIO = 1.25
STEADY_K = 0.2
STEADY_WITHIN_S = 600.0
SHORTEST_HOLD_S = 1800.0
RULES = (
    f"Change one quantity at a time, by a factor of at most {LARGEST_RATIO:g} per level.",
    f"Hold each level for {SHORTEST_HOLD_S / 60:g} min at least, and until no temperature moves by "
    f"more than {STEADY_K:g} K in {STEADY_WITHIN_S / 60:g} min.",
    "Go back to the level before as soon as a measured temperature exceeds stop_above_c, the upper "
    "edge of the forecast: the machine is not the one that the twin knows.",
    "Do not go on to a level that is not allowed: its upper edge reaches the limit.",
    "Identify again with the levels that were held before asking for the next ones.",
)


@dataclass(frozen=True, slots=True)
class SteppingLevel:
    """One level on the way to a high-risk point."""

    speed_rpm: float
    load_n: float
    #: Per sensor, median and upper edge (97.5 %) of its steady reading.
    expected_c: Mapping[str, float]
    stop_above_c: Mapping[str, float]
    runaway_not_excluded: bool  # verdict for the level, from what is known now
    #: Whether the upper edge of every sensor stays below its limit, on this level and on all before
    #: it.
    allowed: bool
    reason: str  # why it is not allowed; empty when it is


def stepping_plan(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    target: Step,
    limits: Mapping[str, float],
) -> tuple[SteppingLevel, ...]:
    """Levels from the data's heaviest point to the target: first the speed, then the load.

    `limits` in degC: what no upper edge may reach, per sensor.
    """
    steps: list[SteppingLevel] = []
    barred = ""
    for speed_rpm, load_n in levels_towards(posterior, target.speed_rpm, target.load_n):
        found = envelope(model, posterior, state, [speed_rpm], [load_n], {})
        expected = {name: float(found.steady_c[name][1, 0, 0]) for name in found.sensors}
        upper = {name: float(found.steady_c[name][2, 0, 0]) for name in found.sensors}
        for name, limit_c in limits.items():
            if not barred and upper.get(name, -np.inf) >= limit_c:
                barred = (
                    f"{speed_rpm:.0f} rpm, {load_n:.0f} N: the upper edge of {name} is "
                    f"{upper[name]:.0f} °C, its limit {limit_c:g} °C"
                )
        steps.append(
            SteppingLevel(
                speed_rpm,
                load_n,
                expected,
                upper,
                bool(found.runaway_not_excluded[0, 0]),
                not barred,
                barred,
            )
        )
    return tuple(steps)


def levels_towards(
    posterior: Posterior, speed_rpm: float, load_n: float
) -> list[tuple[float, float]]:
    """Speeds in rpm and loads in N on the way from the data to a point, the point last.

    The way begins at the data's heaviest point near that speed, or else at its fastest point,
    which is left by speed first. Both move by equal factors of at most 1.25.
    """
    points = posterior.trained.points
    near = [p for p in points if alike(p.speed_rpm, speed_rpm, NEW_SPEED)]
    begin = (
        max(near, key=lambda p: p.load_n)
        if near
        else max(points, key=lambda p: (p.speed_rpm, p.load_n), default=None)
    )
    if begin is None:
        return [(speed_rpm, load_n)]
    way = [(speed, begin.load_n) for speed in _between(begin.speed_rpm, speed_rpm)]
    way += [(speed_rpm, load) for load in _between(begin.load_n, load_n)]
    return way or [(speed_rpm, load_n)]


def _between(start: float, end: float) -> list[float]:
    """Values after ``start`` up to ``end``, by equal factors; downwards in one go."""
    if alike(start, end, 0.02):
        return []
    if start <= 0.0 or end < start:
        return [end]
    count = int(np.ceil(np.log(end / start) / np.log(LARGEST_RATIO) - 1e-9))
    ratio = (end / start) ** (1.0 / count)
    return [start * ratio**k for k in range(1, count)] + [end]
