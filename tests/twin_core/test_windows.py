"""Low-risk windows: what belongs to one, what ends one, what it says about itself."""

import json
from collections.abc import Sequence

import numpy as np
import pytest

from twin_core.windows import (
    MEASURED_TOLERANCE,
    LowRiskRegion,
    MinuteData,
    Window,
    find_windows,
    is_at_rest,
    varied,
    window_of,
)

REGION = LowRiskRegion(speed_rpm_max=4200.0, load_n_max=3300.0)
AMBIENT_C = 22.0
Stage = tuple[int, float, float]


def minutes(stages: Sequence[Stage], *, ring_c: float = 40.0, start_s: float = 600.0) -> MinuteData:
    """One row per minute through stages of (minutes, rpm, N), with measurement noise."""
    rng = np.random.default_rng(0)
    speed = np.concatenate([np.full(count, rpm) for count, rpm, _ in stages])
    load = np.concatenate([np.full(count, newton) for count, _, newton in stages])
    n = speed.size
    return MinuteData(
        time_s=start_s + 60.0 * np.arange(n, dtype=np.float64),
        speed_rpm=np.where(speed > 0, speed + rng.normal(0, 3, n), 0.0),
        load_n=load + rng.normal(0, 10, n),
        ambient_c=np.full(n, AMBIENT_C),
        temperatures_c={
            "t_inner_ring_c": np.full(n, ring_c),
            "t_outer_ring_c": np.full(n, ring_c - 8),
        },
        good=np.ones(n, dtype=np.bool_),
    )


def without(data: MinuteData, rows: Sequence[int]) -> MinuteData:
    keep = np.ones(data.size, dtype=np.bool_)
    keep[list(rows)] = False
    return data.take(keep)


def spoilt(data: MinuteData, rows: Sequence[int]) -> MinuteData:
    good = data.good.copy()
    good[list(rows)] = False
    speed = data.speed_rpm.copy()
    speed[list(rows)] = np.nan
    return MinuteData(data.time_s, speed, data.load_n, data.ambient_c, data.temperatures_c, good)


def spans(found: Sequence[Window]) -> list[tuple[float, float]]:
    """Windows as first and last minute counted from the first row."""
    return [((w.start_s - 600.0) / 60.0, (w.end_s - 600.0) / 60.0) for w in found]


def test_staircase_into_the_high_risk_region_ends_the_window() -> None:
    data = minutes([(45, 1500, 2650), (45, 4200, 2650), (60, 6200, 2650), (40, 2400, 2650)])
    first, second = find_windows(data, REGION)
    assert spans([first, second]) == [(0, 89), (150, 189)]
    assert [round(p.speed_rpm, -1) for p in first.operating_points] == [1500, 4200]
    assert [p.duration_s for p in first.operating_points] == [2700.0, 2700.0]
    assert first.speed_rpm_max == pytest.approx(4200, abs=3)
    assert first.load_n_max == pytest.approx(2650, abs=5)
    assert not first.at_rest


def test_set_point_at_the_edge_of_the_region_is_inside_despite_its_noise() -> None:
    assert spans(find_windows(minutes([(60, 4200, 3300)]), REGION)) == [(0, 59)]
    assert find_windows(minutes([(60, 4400, 2650)]), REGION) == []
    assert find_windows(minutes([(60, 3000, 3500)]), REGION) == []


def test_one_high_risk_minute_splits_where_a_bad_one_does_not() -> None:
    data = minutes([(40, 1500, 2650), (1, 6200, 2650), (40, 1500, 2650)])
    assert spans(find_windows(data, REGION)) == [(0, 39), (41, 80)]
    assert spans(find_windows(spoilt(minutes([(81, 1500, 2650)]), [40]), REGION)) == [(0, 80)]


@pytest.mark.parametrize("spoil", [without, spoilt])
def test_gaps_of_two_minutes_are_bridged_but_not_filled_longer_ones_are_not(spoil) -> None:  # type: ignore[no-untyped-def]
    bridged = spoil(minutes([(90, 1500, 2650)]), [40, 41])
    (window,) = find_windows(bridged, REGION)
    assert spans([window]) == [(0, 89)]
    rows = bridged.between(window.start_s, window.end_s)
    assert int(rows.good.sum()) == 88
    split = spoil(minutes([(90, 1500, 2650)]), [40, 41, 42])
    assert spans(find_windows(split, REGION)) == [(0, 39), (43, 89)]


def test_too_short_a_run_is_no_window() -> None:
    assert find_windows(minutes([(30, 1500, 2650)]), REGION) == []
    assert len(find_windows(minutes([(31, 1500, 2650)]), REGION)) == 1
    assert len(find_windows(minutes([(21, 1500, 2650)]), REGION, 1200.0)) == 1
    assert find_windows(minutes([(1, 1500, 2650)]), REGION) == []


def test_rest_before_the_start_belongs_to_the_window_and_shows_the_initial_state() -> None:
    data = minutes([(30, 0, 0), (40, 1500, 2650), (30, 0, 0), (40, 1500, 2650)], ring_c=AMBIENT_C)
    data.temperatures_c["t_outer_ring_c"][:] = AMBIENT_C + 1.0
    data.temperatures_c["t_inner_ring_c"][90:] = AMBIENT_C + 20.0
    first, second = find_windows(data, REGION)
    assert spans([first, second]) == [(20, 69), (90, 139)]
    assert first.at_rest
    assert not second.at_rest
    assert [p.duration_s for p in first.operating_points] == [2400.0]


def test_at_rest_needs_standing_still_and_sensors_at_ambient() -> None:
    assert is_at_rest(minutes([(3, 0, 0)], ring_c=AMBIENT_C + 1.4)) is False  # outer: -6.6 K
    data = minutes([(3, 0, 0)])
    data.temperatures_c["t_inner_ring_c"][:] = AMBIENT_C + 1.4
    data.temperatures_c["t_outer_ring_c"][:] = np.nan
    assert is_at_rest(data)
    data.temperatures_c["t_inner_ring_c"][:] = np.nan
    assert not is_at_rest(data)
    turning = minutes([(3, 300, 0)], ring_c=AMBIENT_C)
    turning.temperatures_c["t_outer_ring_c"][:] = AMBIENT_C
    assert not is_at_rest(turning)


def test_rows_without_any_temperature_are_a_gap() -> None:
    data = minutes([(90, 1500, 2650)])
    data.temperatures_c["t_inner_ring_c"][40:50] = np.nan
    assert spans(find_windows(data, REGION)) == [(0, 89)]
    data.temperatures_c["t_outer_ring_c"][40:50] = np.nan
    assert spans(find_windows(data, REGION)) == [(0, 39), (50, 89)]


def test_ramps_are_no_operating_points_and_a_short_disturbance_does_not_split_one() -> None:
    data = minutes(
        [
            (20, 1500, 2650),
            (1, 2000, 2650),
            (1, 2300, 2650),
            (20, 2400, 2650),
            (1, 3000, 2650),
            (19, 2400, 2650),
        ]
    )
    points = window_of(data).operating_points
    assert [round(p.speed_rpm, -2) for p in points] == [1500, 2400]
    assert points[1].duration_s == 2400.0
    assert points[1].speed_rpm == pytest.approx(2400, abs=3)


def test_load_steps_are_operating_points_of_their_own() -> None:
    points = window_of(minutes([(30, 4200, 3300), (30, 4200, 2000)])).operating_points
    assert [round(p.load_n, -1) for p in points] == [3300, 2000]


def test_score_counts_rest_length_speeds_and_loads_at_one_speed() -> None:
    whole = minutes(
        [(5, 0, 0), (120, 1500, 2650), (120, 2400, 2650), (120, 4200, 2650), (60, 4200, 3300)],
        ring_c=AMBIENT_C,
    )
    whole.temperatures_c["t_outer_ring_c"][:] = AMBIENT_C
    assert window_of(whole).score == pytest.approx(1.0)
    one = window_of(minutes([(180, 1500, 2650)]))
    assert one.score == pytest.approx(0.25 * (179 / 360 + 1 / 3 + 1 / 2))
    together = window_of(minutes([(90, 1500, 2000), (90, 4200, 3300)]))
    assert together.score == pytest.approx(0.25 * (179 / 360 + 2 / 3 + 1 / 2))


def test_varied_asks_for_two_points_first_and_for_new_ones_later() -> None:
    one = [window_of(minutes([(60, 1500, 2650)]))]
    two = [window_of(minutes([(60, 1500, 2650), (40, 2400, 2650)]))]
    assert not varied([], one)
    assert varied([], two)
    assert not varied(two, two)
    assert not varied(two, [*two, window_of(minutes([(90, 1600, 2700)]))])
    assert varied(two, [*two, window_of(minutes([(40, 2400, 3300)]))])
    assert not varied(two, [*two, window_of(minutes([(25, 2400, 3300)]))])
    assert varied(two, [*two, window_of(minutes([(25, 2400, 3300)]))], 1500.0)
    twice = [window_of(minutes([(20, 2400, 3300)])), window_of(minutes([(20, 2450, 3350)]))]
    assert varied(two, twice)
    assert not varied(two, twice, required=2)


def test_window_survives_json() -> None:
    window = window_of(minutes([(60, 1500, 2650), (40, 2400, 2650)]))
    assert Window.from_dict(json.loads(json.dumps(window.to_dict()))) == window


def test_senseless_rows_are_refused() -> None:
    data = minutes([(3, 1500, 2650)])
    with pytest.raises(ValueError, match=r"time_s\[2\]"):
        MinuteData(
            np.array([0.0, 60.0, 60.0]), data.speed_rpm, data.load_n, data.ambient_c, {}, data.good
        )
    with pytest.raises(ValueError, match="load_n has shape"):
        MinuteData(data.time_s, data.speed_rpm, data.load_n[:2], data.ambient_c, {}, data.good)
    with pytest.raises(ValueError, match=r"ambient_c\[1\] is not a number"):
        MinuteData(
            data.time_s, data.speed_rpm, data.load_n, np.array([1.0, np.nan, 1.0]), {}, data.good
        )


@pytest.mark.parametrize(
    ("speed_rpm", "load_n", "asked", "measured"),
    [
        (4200.0, 3300.0, True, True),
        (-4200.0, 0.0, True, True),
        (4284.0, 3366.0, False, True),
        (4285.0, 3300.0, False, False),
        (4200.0, 3367.0, False, False),
        (np.nan, 3300.0, False, False),
        (4200.0, np.nan, False, False),
    ],
)
def test_a_point_inside_the_region(
    speed_rpm: float, load_n: float, asked: bool, measured: bool
) -> None:
    """What is asked for has no tolerance; what was measured at the edge is noisy."""
    assert bool(REGION.contains(speed_rpm, load_n)) is asked
    assert bool(REGION.contains(speed_rpm, load_n, MEASURED_TOLERANCE)) is measured


def test_points_inside_the_region_are_told_row_by_row() -> None:
    inside = REGION.contains(np.array([0.0, 4200.0, 4300.0]), np.array([3400.0, 3300.0, 0.0]))
    assert inside.tolist() == [False, True, False]


def test_a_rows_readings_are_those_that_are_known() -> None:
    column = np.array([20.0, np.nan])
    rows = MinuteData(
        np.array([0.0, 60.0]),
        *(np.full(2, value) for value in (0.0, 0.0, 22.0)),
        {"t_inner_ring_c": column, "t_outer_ring_c": column[::-1]},
        np.ones(2, dtype=np.bool_),
    )
    assert rows.readings(0) == {"t_inner_ring_c": 20.0}
    assert rows.readings(1) == {"t_outer_ring_c": 20.0}
