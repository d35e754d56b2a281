"""The operating profile ahead."""

import numpy as np
import pytest

from adapters.samples import PlannedProfile, PlanStep
from service.live.profiles import StepAhead, held, operating_profile, planned
from twin_core.profiles import Point

NOW_US = 1_763_700_000_000_000
PRESENT = Point(2391.0, 2702.0, 23.5)
STEPS = (
    PlanStep(600.0, 2400.0, 2650.0),
    PlanStep(1800.0, 4200.0, 2650.0),
    PlanStep(900.0, 0.0, 0.0),
)


def plan(read_before_s: float = 0.0, steps: tuple[PlanStep, ...] = STEPS) -> PlannedProfile:
    return PlannedProfile("bench-1", NOW_US - round(read_before_s * 1e6), steps)


def durations(steps: list[StepAhead]) -> list[float]:
    return [step.duration_s for step in steps]


def test_the_present_point_is_held() -> None:
    assert held(PRESENT, 7200.0) == [StepAhead(7200.0, 2391.0, 2702.0, 23.5)]


def test_a_plan_is_followed_to_its_end() -> None:
    steps = planned(plan(), NOW_US, PRESENT, 14_400.0)
    assert durations(steps) == [600.0, 1800.0, 900.0]
    assert [step.speed_rpm for step in steps[1:]] == [4200.0, 0.0]
    assert [step.load_n for step in steps[1:]] == [2650.0, 0.0]
    assert {step.ambient_c for step in steps} == {23.5}


def test_a_plan_is_cut_at_the_horizon() -> None:
    assert durations(planned(plan(), NOW_US, PRESENT, 1000.0)) == [600.0, 400.0]
    assert durations(planned(plan(), NOW_US, PRESENT, 600.0)) == [600.0]


def test_time_since_the_plan_was_read_is_over() -> None:
    assert durations(planned(plan(200.0), NOW_US, PRESENT, 14_400.0)) == [400.0, 1800.0, 900.0]


def test_a_step_that_has_ended_meanwhile_is_left_out() -> None:
    present = Point(4195.0, 2640.0, 23.5)
    steps = planned(plan(700.0), NOW_US, present, 14_400.0)
    assert durations(steps) == [1700.0, 900.0]
    assert (steps[0].speed_rpm, steps[0].load_n) == (4195.0, 2640.0), "now this one is under way"


def test_a_plan_read_after_the_estimate_is_stretched_back() -> None:
    assert durations(planned(plan(-30.0), NOW_US, PRESENT, 14_400.0)) == [630.0, 1800.0, 900.0]


def test_a_plan_that_is_over_says_nothing() -> None:
    assert planned(plan(3300.0), NOW_US, PRESENT, 14_400.0) == []
    assert planned(plan(steps=()), NOW_US, PRESENT, 14_400.0) == []


@pytest.mark.parametrize(
    ("measured", "expected"),
    [
        ((2391.0, 2702.0), (2391.0, 2702.0)),  # both near: what is measured says it better
        ((1800.0, 2702.0), (2400.0, 2702.0)),  # still on the ramp
        ((2391.0, 0.0), (2391.0, 2650.0)),  # not loaded yet
    ],
)
def test_the_step_under_way_follows_what_is_measured_near_its_set_points(
    measured: tuple[float, float], expected: tuple[float, float]
) -> None:
    (step, *_) = planned(plan(), NOW_US, Point(*measured, 23.5), 14_400.0)
    assert (step.speed_rpm, step.load_n) == expected


def test_rows_come_at_their_spacing_and_at_every_change() -> None:
    steps = [StepAhead(90.0, 1500.0, 2650.0, 22.0), StepAhead(75.0, 2400.0, 3300.0, 24.0)]
    profile = operating_profile(steps, 60.0)
    assert profile.time_s.tolist() == [0.0, 60.0, 90.0, 120.0, 165.0]
    # A row's operating point holds from its time on: the change is at 90 s.
    assert profile.speed_rpm.tolist() == [1500.0, 1500.0, 2400.0, 2400.0, 2400.0]
    assert profile.load_n.tolist() == [2650.0, 2650.0, 3300.0, 3300.0, 3300.0]
    assert profile.ambient_c.tolist() == [22.0, 22.0, 24.0, 24.0, 24.0]


def test_a_change_on_a_row_makes_no_second_row() -> None:
    # Durations as a controller counts them down, not multiples of a minute to the last bit.
    steps = [StepAhead(59.9999, 1500.0, 2650.0, 22.0), StepAhead(60.0002, 2400.0, 2650.0, 22.0)]
    profile = operating_profile(steps, 60.0)
    assert profile.time_s.tolist() == [0.0, 60.0, 120.0]
    assert profile.speed_rpm.tolist() == [1500.0, 2400.0, 2400.0]


def test_the_last_moment_of_a_plan_is_a_profile_too() -> None:
    profile = operating_profile([StepAhead(0.0003, 1500.0, 2650.0, 22.0)], 60.0)
    assert profile.time_s.tolist() == [0.0]
    assert np.isfinite(profile.speed_rpm).all()
