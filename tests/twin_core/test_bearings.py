import dataclasses
import math

import pytest

from twin_core.bearings import (
    CATALOGUE,
    UnknownBearingError,
    bearing,
    bearing_from_dimensions,
)
from twin_core.materials import MINERAL_OIL_100, walther_viscosity_mm2_s


@pytest.mark.parametrize(
    ("designation", "inner_kg", "outer_kg", "balls_kg", "pitch_mm"),
    [("6311", 0.384, 0.592, 0.285, 87.5), ("6016", 0.293, 0.319, 0.140, 102.5)],
)
def test_part_masses_follow_from_the_dimensions(
    designation: str, inner_kg: float, outer_kg: float, balls_kg: float, pitch_mm: float
) -> None:
    part = bearing(designation)
    assert part.pitch_diameter_mm == pitch_mm
    assert part.inner_ring_kg == pytest.approx(inner_kg, rel=0.01)
    assert part.outer_ring_kg == pytest.approx(outer_kg, rel=0.01)
    assert part.balls_kg == pytest.approx(balls_kg, rel=0.01)


@pytest.mark.parametrize(("designation", "factor"), [("6311", 13.0), ("6016", 16.0)])
def test_balls_reproduce_the_static_load_rating(designation: str, factor: float) -> None:
    """C0 = f0 Z Dw^2 with the catalogue's f0."""
    part = bearing(designation)
    rating = factor * part.ball_count * part.ball_diameter_mm**2
    assert rating == pytest.approx(part.static_load_rating_n, rel=0.025)


def test_an_unknown_designation_names_the_known_ones() -> None:
    with pytest.raises(UnknownBearingError, match=r"'6312'.*6016, 6311"):
        bearing("6312")
    assert issubclass(UnknownBearingError, ValueError)


@pytest.mark.parametrize("known", list(CATALOGUE.values()), ids=list(CATALOGUE))
def test_estimates_from_boundary_dimensions_come_close_to_the_catalogue(known: object) -> None:
    assert dataclasses.is_dataclass(known)
    part = bearing(known.designation)  # type: ignore[attr-defined]
    guess = bearing_from_dimensions("guess", part.bore_mm, part.outer_mm, part.width_mm)
    assert guess.ball_count == part.ball_count
    assert guess.ball_diameter_mm == pytest.approx(part.ball_diameter_mm, rel=0.05)
    assert guess.static_load_rating_n == pytest.approx(part.static_load_rating_n, rel=0.06)
    assert guess.inner_ring_kg == pytest.approx(part.inner_ring_kg, rel=0.06)
    assert guess.outer_ring_kg == pytest.approx(part.outer_ring_kg, rel=0.06)
    assert guess.cage_kg == pytest.approx(part.cage_kg, rel=0.10)


def test_given_ball_data_are_taken_over() -> None:
    part = bearing_from_dimensions(
        "6205", 25.0, 52.0, 15.0, ball_count=9, ball_diameter_mm=7.938, static_load_rating_n=7800.0
    )
    assert (part.ball_count, part.ball_diameter_mm) == (9, 7.938)
    assert part.static_load_rating_n == 7800.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bore_mm": 130.0}, "inner_shoulder_mm is 75.3, expected more than bore_mm"),
        ({"outer_shoulder_mm": 70.0}, "outer_shoulder_mm is 70.0"),
        ({"width_mm": 0.0}, "width_mm is 0.0, expected > 0"),
        ({"width_mm": math.nan}, "width_mm is nan"),
        ({"ball_diameter_mm": 40.0}, "ball_diameter_mm is 40.0, expected less than the section"),
        ({"ball_count": 14}, "ball_count is 14"),
    ],
)
def test_impossible_dimensions_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(bearing("6311"), **change)


def test_the_papers_ball_radii_do_not_fit() -> None:
    """Table 3 prints 20 mm as the balls' radius of the 6311: eight of 40 mm."""
    with pytest.raises(ValueError, match="less than the section"):
        dataclasses.replace(bearing("6311"), ball_diameter_mm=40.0)


def test_dimensions_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ValueError, match=r"bore_mm is 120.0 and outer_mm 55.0"):
        bearing_from_dimensions("x", 120.0, 55.0, 29.0)


def test_walther_viscosity_of_a_100_oil() -> None:
    values = [walther_viscosity_mm2_s(t, 100.0, 10.5) for t in (22.6, 40.0, 60.0, 80.0, 100.0)]
    assert values == pytest.approx([297.0, 100.0, 38.6, 18.6, 10.5], rel=2e-3)


def test_the_exponential_law_falls_and_meets_walther_at_both_ends() -> None:
    oil = MINERAL_OIL_100
    for temperature in (22.6, 80.0):
        assert oil.kinematic_viscosity_mm2_s(temperature) == pytest.approx(
            walther_viscosity_mm2_s(temperature, 100.0, 10.5), rel=0.01
        )
    # nu0 exp(-0.0482 * 20) = 0.3814 nu0
    assert oil.kinematic_viscosity_mm2_s(42.6) == pytest.approx(297.0 * 0.3814, rel=1e-4)
