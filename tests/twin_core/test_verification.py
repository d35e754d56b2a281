"""Whether a plan was followed, and how good a forecast was, against plain reckoning."""

from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_core import scores
from twin_core.verification import (
    FOLLOWED_N,
    FOLLOWED_PART,
    FOLLOWED_RPM,
    LEAD_TIMES_S,
    SHIFT_S,
    FollowedBand,
    MinuteCourse,
    band_at,
    independent_runs,
    kept_rows,
    minute_course,
    value_at,
    verify,
)

SEEDS = st.integers(0, 2**32 - 1)
STEPS = st.lists(
    st.tuples(st.floats(120, 7200), st.floats(0, 7000), st.floats(0, 6000)), min_size=1, max_size=6
)


def course_of(
    steps: list[tuple[float, float, float]],
    minutes: int,
    shift_s: float = 0.0,
    factor: float = 1.0,
    offset_s: float = 0.0,
) -> MinuteCourse:
    """A machine that runs a plan, shifted by some seconds and by a factor off."""
    duration_s, speed_rpm, load_n = np.array(steps).T
    begin_s = offset_s + 60.0 * np.arange(minutes)
    ends_s = np.cumsum(duration_s)[:-1] + shift_s
    fine_s = begin_s[:, None] + np.linspace(0.0, 60.0, 120, endpoint=False)
    index = np.searchsorted(ends_s, fine_s, side="right")
    means = [factor * level[index].mean(axis=1) for level in (speed_rpm, load_n)]
    return minute_course(duration_s, speed_rpm, load_n, begin_s, *means)


@settings(max_examples=60, deadline=None)
@given(
    STEPS,
    st.floats(-SHIFT_S, SHIFT_S),
    st.floats(1 - 0.99 * FOLLOWED_PART, 1 + 0.99 * FOLLOWED_PART),
    st.floats(0, 59),
)
def test_who_runs_the_plan_follows_it_whenever_a_step_begins_a_little_off(
    steps: list[tuple[float, float, float]], shift_s: float, factor: float, offset_s: float
) -> None:
    course = course_of(steps, 240, shift_s, factor, offset_s)
    assert not course.left.any()
    assert not course.unknown.any()
    assert all(course.until(lead) == "followed" for lead in LEAD_TIMES_S)


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 7000), st.floats(0, 6000), st.sampled_from([-1, 1]), st.booleans(), SEEDS)
def test_who_runs_elsewhere_has_left_it_from_then_on(
    speed_rpm: float, load_n: float, sign: int, of_speed: bool, seed: int
) -> None:
    """Whatever the plan: one that was left at a minute is left at the next lead times."""
    level, least = (speed_rpm, FOLLOWED_RPM) if of_speed else (load_n, FOLLOWED_N)
    beyond = level + sign * 1.01 * max(FOLLOWED_PART * level, least)
    if beyond < 0:
        beyond = level + 1.01 * max(FOLLOWED_PART * level, least)
    leaves = int(np.random.default_rng(seed).integers(0, 120))
    values = np.where(np.arange(240) < leaves, level, beyond)
    other = np.full(240, load_n if of_speed else speed_rpm)
    measured = (values, other) if of_speed else (other, values)
    course = minute_course([14400.0], [speed_rpm], [load_n], 60.0 * np.arange(240), *measured)
    for lead_s in LEAD_TIMES_S:
        gone = max(lead_s / 60 - leaves, 0)
        if gone == 0:
            assert course.until(lead_s) == "followed"
        elif gone > 0.05 * lead_s / 60 or gone > 0.05 * min(lead_s / 60, 30):
            assert course.until(lead_s) == "left"


def test_a_spike_is_forgiven_and_a_last_half_hour_elsewhere_is_not() -> None:
    values = np.full(240, 3000.0)
    load = np.full(240, 2000.0)

    def until(changed: slice, lead_s: float) -> str:
        speed = values.copy()
        speed[changed] = 5000.0
        course = minute_course([14400.0], [3000.0], [2000.0], 60.0 * np.arange(240), speed, load)
        return course.until(lead_s)

    assert until(slice(100, 106), 14400) == "followed"
    assert until(slice(100, 106), 7200) == "left"
    assert until(slice(234, 240), 14400) == "left"
    assert until(slice(0, 1), 300) == "left"


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 239), st.integers(0, 60))
def test_what_is_not_known_holds_for_five_minutes(first: int, count: int) -> None:
    speed = np.full(240, 3000.0)
    speed[first : first + count] = np.nan
    course = minute_course(
        [14400.0], [3000.0], [2000.0], 60.0 * np.arange(240), speed, np.full(240, 2000.0)
    )
    missing = min(count, 240 - first)
    held = 0 if first == 0 else min(missing, 5)
    assert np.count_nonzero(course.unknown) == missing - held
    assert not course.left.any()


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(0, 50))
def test_scores_are_those_of_plain_reckoning(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    quantiles = np.sort(rng.normal(60.0, 5.0, (count, 5)), axis=1)
    measured = rng.normal(60.0, 5.0, count)
    measured[rng.random(count) < 0.2] = np.nan
    found = verify(quantiles, measured)
    known = [(q, y) for q, y in zip(quantiles.tolist(), measured.tolist(), strict=True) if y == y]
    assert found.n == len(known)
    if not known:
        assert np.isnan(found.coverage_95)
        return

    def mean(values: list[float]) -> float:
        return sum(values) / len(values)

    assert found.coverage_95 == pytest.approx(mean([q[0] <= y <= q[4] for q, y in known]))
    assert found.coverage_50 == pytest.approx(mean([q[1] <= y <= q[3] for q, y in known]))
    assert found.bias_k == pytest.approx(mean([q[2] - y for q, y in known]))
    assert found.mae_k == pytest.approx(mean([abs(q[2] - y) for q, y in known]))
    assert found.interval_score_k == pytest.approx(
        mean([q[4] - q[0] + 40.0 * (max(q[0] - y, 0.0) + max(y - q[4], 0.0)) for q, y in known])
    )
    assert found.below == pytest.approx([mean([y <= q[k] for q, y in known]) for k in range(5)])
    assert list(found.below) == sorted(found.below)


def test_an_honest_forecast_covers_what_it_states_and_no_other_scores_better() -> None:
    rng = np.random.default_rng(0)
    measured = rng.normal(60.0, 2.0, 20_000)
    steps = np.array([NormalDist().inv_cdf(level) for level in scores.QUANTILE_LEVELS])

    def of(spread_k: float, off_k: float = 0.0) -> np.ndarray:
        return np.tile(60.0 + off_k + spread_k * steps, (measured.size, 1))

    honest = verify(of(2.0), measured)
    assert honest.coverage_95 == pytest.approx(0.95, abs=0.01)
    assert honest.coverage_50 == pytest.approx(0.50, abs=0.01)
    assert honest.below == pytest.approx(scores.QUANTILE_LEVELS, abs=0.01)
    for other in (of(4.0), of(1.0), of(2.0, 1.5)):
        worse = verify(other, measured)
        assert worse.crps_k > honest.crps_k
        assert worse.interval_score_k > honest.interval_score_k


def test_shapes_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ValueError, match=r"quantiles \(3, 5\), expected \(2, 5\)"):
        verify(np.zeros((3, 5)), np.zeros(2))


@settings(max_examples=60, deadline=None)
@given(st.floats(0.5, 18.5), st.floats(-5, 5))
def test_a_value_between_minutes_is_that_of_a_straight_course(minute: float, slope: float) -> None:
    means = 20.0 + slope * (np.arange(20) + 0.5)
    assert value_at(means, minute) == pytest.approx(20.0 + slope * minute)
    own = int(minute)
    gone = means.copy()
    gone[[own - 1, own + 1]] = np.nan
    assert value_at(gone, minute) == pytest.approx(means[own])
    gone[own] = np.nan
    assert value_at(gone, minute) is None
    assert value_at(means, -0.1) is None
    assert value_at(means, 20.0) is None


def stopped(at_minute: int, minutes: int = 240, without_speed_from: int = 240) -> MinuteCourse:
    """A machine that holds a point and stops in a minute."""
    rows = np.arange(minutes)
    speed_rpm = np.where(rows < at_minute, 3000.0, 0.0)
    speed_rpm[rows >= without_speed_from] = np.nan
    return minute_course([14_400.0], [3000.0], [2650.0], 60.0 * rows, speed_rpm, rows * 0.0 + 2650)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 200), st.integers(1, 239))
def test_the_last_minute_that_was_followed_is_the_one_before_the_stop(
    at_minute: int, lead_minutes: int
) -> None:
    last = stopped(at_minute).last_followed(60.0 * lead_minutes)
    assert last == min(at_minute, lead_minutes) - 1
    assert stopped(0).last_followed(3600.0) is None


def followed(course: MinuteCourse, measured_c: np.ndarray, above_from: int = 240) -> FollowedBand:
    """Band from 50 to 60 degC and of the run from 48 to 62; measured 65 degC from a minute on."""
    rows = np.arange(course.time_s.size)
    band_c = np.tile([50.0, 60.0, 48.0, 62.0], (rows.size, 1))
    return FollowedBand(course, np.where(rows >= above_from, measured_c + 10.0, measured_c), band_c)


def test_a_plan_that_is_left_is_scored_at_its_last_minute() -> None:
    measured_c = np.full(240, 55.0)
    inside = followed(stopped(40), measured_c).left(7200.0)
    outside = followed(stopped(40), measured_c, above_from=35).left(7200.0)
    assert inside is not None
    assert outside is not None
    assert (inside.after_s, inside.measured_c, inside.is_inside) == (39 * 60.0 + 30.0, 55.0, True)
    assert (outside.measured_c, outside.high_c, outside.is_inside) == (65.0, 60.0, False)
    # A sensor that did not measure in that minute did in one of the five before, or says nothing.
    for gap, found in ((3, True), (8, False)):
        some_c = measured_c.copy()
        some_c[40 - gap :] = np.nan
        assert (followed(stopped(40), some_c).left(7200.0) is not None) == found


@pytest.mark.parametrize("without_speed_from", [240, 60])
def test_a_sensor_that_is_lost_above_its_band_was_outside(without_speed_from: int) -> None:
    course = stopped(240, without_speed_from=without_speed_from)
    lost_c = np.full(240, 55.0)
    lost_c[50:] = np.nan
    above = followed(course, lost_c, above_from=45).lost_above(7200.0)
    assert above is not None
    assert (above.after_s, above.is_inside) == (49 * 60.0 + 30.0, False)
    assert followed(course, lost_c).lost_above(7200.0) is None, "lost inside: not of the forecast"
    assert followed(course, lost_c * np.nan).lost_above(7200.0) is None


def test_a_run_is_inside_with_all_of_its_minutes_or_not() -> None:
    measured_c = np.full(240, 55.0)
    band = followed(stopped(240), measured_c, above_from=100)
    assert [band.run_inside(60.0 * end) for end in (60, 100, 101, 240)] == [
        True, True, False, False,
    ]  # fmt: skip
    few_c = measured_c.copy()
    few_c[10:30] = np.nan
    assert followed(stopped(240), few_c).run_inside(60.0 * 60) is None
    assert followed(stopped(240), few_c).run_inside(60.0 * 240) is True
    assert followed(stopped(240), few_c, above_from=40).run_inside(60.0 * 60) is False
    assert band.run_inside(30.0) is None


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_bands_at_a_few_times_are_those_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.choice(14_400, 120, replace=False)).astype(float)
    level = np.where(time_s > rng.uniform(0, 14_400), 20.0, 0.0)
    curves_c = np.stack([level * (1 - np.exp(-time_s / 1800.0)) + k * 3.0 for k in range(4)])
    rows = kept_rows(time_s, curves_c, [0.05] * 4)
    again_c = band_at(time_s[rows], curves_c[:, rows].T, time_s)
    assert np.max(np.abs(again_c.T - curves_c)) <= 0.05 + 1e-9
    assert len(rows) < 60


def test_forecasts_that_overlap_count_as_one() -> None:
    every_ten_minutes = [600.0 * k for k in range(37)]
    assert independent_runs(every_ten_minutes, 3600.0) == 7
    assert independent_runs(reversed(every_ten_minutes), 600.0) == 37
    assert independent_runs([], 600.0) == 0
