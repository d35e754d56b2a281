"""Deep groove ball bearings: catalogue data and what follows from the dimensions.

Catalogue figures are those of ISO 15 (boundary dimensions) and of manufacturers' catalogues.
Ball counts and diameters are the real ones (8 x 13/16", 14 x 17/32"): they reproduce the static
load rating C0 = f0 Z Dw^2 and the catalogue mass. Table 3 of Wang et al., Appl. Sci. 2025,
15(12), 6671 lists others that do not fit between the rings.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from twin_core import TwinCoreError
from twin_core.materials import BALL_STEEL, RING_STEEL

GROOVE_CONFORMITY = 0.52
"""Raceway groove radius over ball diameter, the usual value for deep groove ball bearings."""


class UnknownBearingError(TwinCoreError, ValueError):
    """A designation is not in the catalogue."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """Geometry, static load rating and masses of a deep groove ball bearing."""

    designation: str
    #: Boundary dimensions d, D, B.
    bore_mm: float
    outer_mm: float
    width_mm: float
    #: Z and Dw.
    ball_count: int
    ball_diameter_mm: float
    #: Shoulder diameter d1 of the inner ring; inside diameter D1 or D2 of the outer ring.
    inner_shoulder_mm: float
    outer_shoulder_mm: float
    static_load_rating_n: float  # C0
    cage_kg: float  # mass of the (brass) cage

    def __post_init__(self) -> None:
        ascending = (
            ("0", 0.0),
            ("bore_mm", self.bore_mm),
            ("inner_shoulder_mm", self.inner_shoulder_mm),
            ("outer_shoulder_mm", self.outer_shoulder_mm),
            ("outer_mm", self.outer_mm),
        )
        for (low_name, low), (name, value) in pairwise(ascending):
            if not low < value:
                raise ValueError(
                    f"bearing {self.designation!r}: {name} is {value}, expected more than "
                    f"{low_name} ({low})"
                )
        for name in ("width_mm", "ball_diameter_mm", "static_load_rating_n", "cage_kg"):
            value = getattr(self, name)
            if not value > 0.0:
                raise ValueError(f"bearing {self.designation!r}: {name} is {value}, expected > 0")
        if not self.ball_diameter_mm < (self.outer_mm - self.bore_mm) / 2.0:
            raise ValueError(
                f"bearing {self.designation!r}: ball_diameter_mm is {self.ball_diameter_mm}, "
                f"expected less than the section {(self.outer_mm - self.bore_mm) / 2.0}"
            )
        if not 3 <= self.ball_count <= math.pi * self.pitch_diameter_mm / self.ball_diameter_mm:
            raise ValueError(
                f"bearing {self.designation!r}: ball_count is {self.ball_count}, expected 3 or "
                "more and no more than fit on the pitch circle"
            )

    @property
    def pitch_diameter_mm(self) -> float:
        """Mean diameter dm = (d + D) / 2."""
        return (self.bore_mm + self.outer_mm) / 2.0

    @property
    def inner_ring_kg(self) -> float:
        """Mass of the inner ring: the annulus d..d1 less the raceway groove."""
        depth_mm = (self.inner_shoulder_mm - self.pitch_diameter_mm + self.ball_diameter_mm) / 2.0
        annulus_mm3 = _annulus_mm2(self.bore_mm, self.inner_shoulder_mm) * self.width_mm
        groove_mm3 = self._groove_mm3(depth_mm, self.inner_shoulder_mm - depth_mm)
        return (annulus_mm3 - groove_mm3) * 1e-9 * RING_STEEL.density_kg_m3

    @property
    def outer_ring_kg(self) -> float:
        """Mass of the outer ring: the annulus D1..D less the raceway groove."""
        depth_mm = (self.pitch_diameter_mm + self.ball_diameter_mm - self.outer_shoulder_mm) / 2.0
        annulus_mm3 = _annulus_mm2(self.outer_shoulder_mm, self.outer_mm) * self.width_mm
        groove_mm3 = self._groove_mm3(depth_mm, self.outer_shoulder_mm + depth_mm)
        return (annulus_mm3 - groove_mm3) * 1e-9 * RING_STEEL.density_kg_m3

    @property
    def balls_kg(self) -> float:
        """Mass of all balls."""
        ball_mm3 = math.pi / 6.0 * self.ball_diameter_mm**3
        return self.ball_count * ball_mm3 * 1e-9 * BALL_STEEL.density_kg_m3

    def _groove_mm3(self, depth_mm: float, mean_diameter_mm: float) -> float:
        """Volume of a raceway: a circular segment swept around the axis."""
        radius = GROOVE_CONFORMITY * self.ball_diameter_mm
        depth = min(max(depth_mm, 0.0), radius)
        angle = math.acos(1.0 - depth / radius)
        segment = radius**2 * (angle - math.sin(angle) * math.cos(angle))
        return segment * math.pi * mean_diameter_mm


def _annulus_mm2(inner_mm: float, outer_mm: float) -> float:
    return math.pi / 4.0 * (outer_mm**2 - inner_mm**2)


CATALOGUE: dict[str, Bearing] = {
    "6311": Bearing(
        designation="6311",
        bore_mm=55.0,
        outer_mm=120.0,
        width_mm=29.0,
        ball_count=8,
        ball_diameter_mm=20.638,
        inner_shoulder_mm=75.3,
        outer_shoulder_mm=104.0,
        static_load_rating_n=45_000.0,
        cage_kg=0.42,
    ),
    "6016": Bearing(
        designation="6016",
        bore_mm=80.0,
        outer_mm=125.0,
        width_mm=22.0,
        ball_count=14,
        ball_diameter_mm=13.494,
        inner_shoulder_mm=94.4,
        outer_shoulder_mm=115.0,
        static_load_rating_n=40_000.0,
        cage_kg=0.30,
    ),
}
"""Bearings known by name."""


def bearing(designation: str) -> Bearing:
    """Return a bearing of the catalogue.

    Raises `UnknownBearingError` if the designation is not in the catalogue; the message names the
    known ones.
    """
    try:
        return CATALOGUE[designation.strip()]
    except KeyError:
        known = ", ".join(sorted(CATALOGUE))
        raise UnknownBearingError(
            f"unknown bearing {designation!r}, expected one of {known} "
            "(or give its dimensions bore_mm, outer_mm, width_mm)"
        ) from None


def bearing_from_dimensions(
    designation: str,
    bore_mm: float,
    outer_mm: float,
    width_mm: float,
    *,
    ball_count: int | None = None,
    ball_diameter_mm: float | None = None,
    inner_shoulder_mm: float | None = None,
    outer_shoulder_mm: float | None = None,
    static_load_rating_n: float | None = None,
    cage_kg: float | None = None,
) -> Bearing:
    """Describe any deep groove ball bearing by its boundary dimensions.

    What is not given is estimated by proportions that hold for the catalogue bearings within a
    few percent: Dw = 0.31 (D - d), balls filling 60 % of the pitch circle, shoulders 0.6 Dw
    inside and 0.86 Dw outside dm, C0 = 14 Z Dw^2 (the mean of the geometry factor f0 of
    ISO 76 for these sections), cage mass 2.25e-4 kg/mm2 dm Dw.

    `bore_mm`, `outer_mm`, `width_mm`: d, D, B; `ball_count`, `ball_diameter_mm`,
    `inner_shoulder_mm`, `outer_shoulder_mm`, `static_load_rating_n`: Z, Dw, d1, D1 or D2 and C0
    where the catalogue gives them. Raises `ValueError` if the dimensions do not make a bearing;
    names the field, the value and the expectation.
    """
    if not 0.0 < bore_mm < outer_mm:
        raise ValueError(
            f"bearing {designation!r}: bore_mm is {bore_mm} and outer_mm {outer_mm}, expected "
            "0 < bore_mm < outer_mm"
        )
    pitch_mm = (bore_mm + outer_mm) / 2.0
    ball_mm = 0.31 * (outer_mm - bore_mm) if ball_diameter_mm is None else ball_diameter_mm
    section_mm = (outer_mm - bore_mm) / 2.0
    if not 0.0 < ball_mm < section_mm:
        raise ValueError(
            f"bearing {designation!r}: ball_diameter_mm is {ball_mm}, expected > 0 and less than "
            f"the section {section_mm}"
        )
    balls = round(0.6 * math.pi * pitch_mm / ball_mm) if ball_count is None else ball_count

    def given(value: float | None, estimate: float) -> float:
        return estimate if value is None else value

    return Bearing(
        designation=designation,
        bore_mm=bore_mm,
        outer_mm=outer_mm,
        width_mm=width_mm,
        ball_count=balls,
        ball_diameter_mm=ball_mm,
        inner_shoulder_mm=given(inner_shoulder_mm, pitch_mm - 0.6 * ball_mm),
        outer_shoulder_mm=given(outer_shoulder_mm, pitch_mm + 0.86 * ball_mm),
        static_load_rating_n=given(static_load_rating_n, 14.0 * balls * ball_mm**2),
        cage_kg=given(cage_kg, 2.25e-4 * pitch_mm * ball_mm),
    )
