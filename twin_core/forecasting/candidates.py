"""Steps that advice compares, all inside the low-risk region, and those that teach the wrong thing.

One thing a linear prediction cannot see is product behaviour here: a step never changes speed
and load at once against what the data hold. Offline, on random virtual benches, such a step booked
the error of the speed law on the load law and made the forecast far worse than no step (7.9 K
against 0.7 K at 4000 N, coverage 77 %), though it looked informative.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np

from twin_core.operating_points import (
    HELD_S,
    NEW_LOAD,
    NEW_SPEED,
    OperatingSpan,
    alike,
    distinct_values,
)
from twin_core.profiles import Step
from twin_core.windows import MEASURED_TOLERANCE, LowRiskRegion

DURATIONS_S = (600.0, 900.0, 1200.0, 2700.0, 3600.0)
"""How long a step may hold each of its levels."""
_FRACTIONS = (0.4, 0.6, 0.8, 1.0)
_ROUND_TO = 50.0  # rpm, N
_LEAST_RATIO = 1.15


def candidates(
    trained: Sequence[OperatingSpan], target: Step, region: LowRiskRegion
) -> Iterator[tuple[Step, ...]]:
    """Steps worth comparing, all inside the region; those with both changed at once too.

    Speeds: that of the target if the region has it, those of the data, four levels of the region's
    highest. Loads: four levels of the region's highest, and those of the data. Each as a single
    level, in pairs of loads at one speed, and in pairs of speeds at a load of the data; a pair
    differs by 15 % or more. Each level lasts `DURATIONS_S`; what must not be run is named once.
    """
    for points in _paths(trained, target, region):
        longest = tuple(Step(speed, load, DURATIONS_S[-1]) for speed, load in points)
        for duration_s in DURATIONS_S if why_not(longest, trained) is None else DURATIONS_S[-1:]:
            yield tuple(Step(speed, load, duration_s) for speed, load in points)


def _paths(
    trained: Sequence[OperatingSpan], target: Step, region: LowRiskRegion
) -> Iterator[tuple[tuple[float, float], ...]]:
    """Speeds and loads of the levels of each step, in time order."""
    lasting = [point for point in trained if point.duration_s >= HELD_S]
    known_speeds = [_within(point.speed_rpm, region.speed_rpm_max) for point in lasting]
    known_loads = [_within(point.load_n, region.load_n_max) for point in lasting]
    fastest = [_rounded(part * region.speed_rpm_max) for part in _FRACTIONS]
    speeds = sorted(
        distinct_values(
            [
                speed
                for speed in (target.speed_rpm, *known_speeds, *reversed(fastest))
                if 0.0 < speed <= region.speed_rpm_max
            ],
            NEW_SPEED,
        )
    )
    heaviest = [_rounded(part * region.load_n_max) for part in _FRACTIONS]
    loads = sorted(
        distinct_values(
            [load for load in (*known_loads, *heaviest) if 0.0 < load <= region.load_n_max],
            NEW_LOAD,
        )
    )
    for speed in speeds:
        yield from (((speed, load),) for load in loads)
        untried = not any(alike(speed, known, NEW_SPEED) for known in known_speeds)
        for low, high in _pairs(loads):
            # At an untried speed the first load must be one that the data know.
            known_first = any(alike(low, known, NEW_LOAD) for known in known_loads)
            first, second = (high, low) if untried and not known_first else (low, high)
            yield (speed, first), (speed, second)
    for load in loads:
        if any(alike(load, known, NEW_LOAD) for known in known_loads):
            yield from (((low, load), (high, load)) for low, high in _pairs(speeds))


def _pairs(values: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Pairs of ascending values that differ enough."""
    return ((low, high) for low, high in combinations(values, 2) if high >= _LEAST_RATIO * low)


def why_not(levels: Sequence[Step], trained: Sequence[OperatingSpan]) -> str | None:
    """Say why a step must not be run for learning: speed and load changed at once; None if not.

    The first level must share its speed or its load with an operating point of the data; after
    it only one of the two may change from level to level.
    """
    known = [point for point in trained if point.duration_s >= HELD_S] or list(trained)
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


def _within(value: float, highest: float) -> float:
    """A measured set-point: without its noise, which may have led it out of the region."""
    tidy = float(round(value, -1))
    return highest if highest < tidy <= (1.0 + MEASURED_TOLERANCE) * highest else tidy


def _rounded(value: float) -> float:
    return float(np.floor(value / _ROUND_TO) * _ROUND_TO)
