"""Duty of machines that are held nowhere: where they ran and for how long."""

from itertools import pairwise

import numpy as np
import pytest

from twin_core.operating_points import (
    HELD_S,
    OperatingSpan,
    split,
    taught_values,
    usual_levels,
    varying_duty,
)
from twin_core.windows import MinuteData, varied, variety_score, window_of


def ridden(
    minutes: int, seed: int = 4, spacing_s: float = 60.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed and load at random every two minutes."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, minutes * 60.0, spacing_s)
    block = (time_s // 120.0).astype(int)
    speed = rng.uniform(1000.0, 4000.0, block[-1] + 1)[block]
    load = rng.uniform(1000.0, 3000.0, block[-1] + 1)[block]
    return time_s, speed, load


def duty_of(time_s: np.ndarray, speed: np.ndarray, load: np.ndarray) -> tuple[OperatingSpan, ...]:
    spacing_s = float(np.median(np.diff(time_s)))
    return varying_duty(time_s, speed, load, split(time_s, speed, load, spacing_s), spacing_s)


def test_a_machine_that_is_held_nowhere_has_run_over_a_range() -> None:
    time_s, speed, load = ridden(240)
    assert max((point.load_n for point in split(time_s, speed, load)), default=0.0) < 2900.0
    duty = duty_of(time_s, speed, load)
    assert sum(point.duration_s for point in duty) == pytest.approx(240 * 60.0, rel=0.05)
    assert 2700.0 < max(point.load_n for point in duty) < 3000.0
    assert len(taught_values((), duty, "load_n", 0.08)) >= 3


def test_what_changes_within_a_minute_leaves_one_mean() -> None:
    time_s = np.arange(0.0, 7200.0, 5.0)
    load = np.where((time_s // 30.0) % 2 == 0, 1000.0, 3000.0)
    duty = duty_of(time_s, np.full(time_s.size, 3000.0), load)
    assert {round(point.load_n, -1) for point in duty} == {2000.0}
    assert len(taught_values((), duty, "load_n", 0.08)) == 1


@pytest.mark.parametrize("ramp_min", [2, 8])
def test_stages_with_ramps_between_them_are_no_varying_duty(ramp_min: int) -> None:
    stages = [1500.0, 2400.0, 3300.0]
    parts = [np.full(60, stages[0])]
    for before, after in pairwise(stages):
        parts += [np.linspace(before, after, ramp_min), np.full(60, after)]
    load = np.concatenate(parts)
    assert duty_of(np.arange(load.size) * 60.0, np.full(load.size, 3000.0), load) == ()


def test_standstill_is_no_duty_and_a_pause_joins_nothing() -> None:
    time_s, speed, load = ridden(120)
    speed[40:80] = 0.0
    duty = duty_of(time_s, speed, load)
    assert all(point.speed_rpm >= 1000.0 for point in duty)
    assert sum(point.duration_s for point in duty) <= 80 * 60.0
    assert duty_of(time_s[:18], speed[:18], load[:18]) == ()


def test_levels_are_the_thirds_of_the_time() -> None:
    points = [OperatingSpan(1000.0, load, HELD_S, 0.0) for load in (3000.0, 1000.0, 2000.0)]
    assert usual_levels(points) == ((1000.0, 1000.0), (1000.0, 2000.0), (1000.0, 3000.0))
    assert usual_levels(points[:1]) == ((1000.0, 3000.0),)
    assert usual_levels([]) == ()


def minutes(time_s: np.ndarray, speed: np.ndarray, load: np.ndarray) -> MinuteData:
    n = time_s.size
    return MinuteData(
        time_s, speed, load, np.full(n, 22.0), {"t_a_c": np.full(n, 40.0)}, np.ones(n, np.bool_)
    )


def test_varying_duty_is_worth_identifying_once_it_has_lasted_and_again_where_it_is_new() -> None:
    short, long = (window_of(minutes(*ridden(length))) for length in (40, 90))
    assert not varied([], [short])
    assert varied([], [long])
    assert not varied([long], [long])
    time_s, speed, load = ridden(90, seed=5)
    faster = window_of(minutes(time_s + 1e5, speed + 4000.0, load))
    assert varied([long], [long, faster])
    assert long.load_n_max > 2500.0
    assert variety_score(long) > variety_score(short) > 0.0
    assert type(long).from_dict(long.to_dict()) == long
    old = {key: value for key, value in long.to_dict().items() if key != "duty"}
    assert type(long).from_dict(old).duty == ()
