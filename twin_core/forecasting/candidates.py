"""Steps that advice compares, all inside the low-risk region, and those that teach the wrong thing.

One thing a linear prediction cannot see is product behaviour here: a step never changes speed
and load at once against what the data hold. Offline, on random virtual benches, such a step booked
the error of the speed law on the load law and made the forecast far worse than no step (7.9 K
against 0.7 K at 4000 N, coverage 77 %), though it looked informative.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from twin_core.forecasting.design import Level
from twin_core.operating_points import (
    NEW_LOAD,
    NEW_SPEED,
    OperatingPoint,
    alike,
    distinct_values,
)
from twin_core.windows import MEASURED_TOLERANCE, LowRiskRegion

LOAD_FRACTIONS = (0.4, 0.6, 0.8, 1.0)
SPEED_FRACTIONS = (0.6, 1.0)
SINGLE_DURATIONS_S = (2700.0, 5400.0)
PAIR_DURATIONS_S = (2700.0, 3600.0)
_ROUND_LOAD_N = 50.0
_ROUND_SPEED_RPM = 50.0
_LEAST_LOAD_RATIO = 1.15
_TAUGHT_S = 1200.0


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


def _within(value: float, highest: float) -> float:
    """A measured set-point: without its noise, which may have led it out of the region."""
    tidy = float(round(value, -1))
    return highest if highest < tidy <= (1.0 + MEASURED_TOLERANCE) * highest else tidy


def _rounded(value: float, to: float) -> float:
    return float(np.floor(value / to) * to)
