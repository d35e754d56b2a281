"""The bearings that can be mounted on the virtual bench.

The bench keeps catalogue data of its own, so that an error in the twin's catalogue cannot hide
itself by being made twice.

Sources: boundary dimensions ISO 15; masses, load ratings, shoulder diameters and the constants
R1 and S1 of the frictional moment from the SKF rolling bearing catalogue (PUB BU/P1 17000 EN);
ball sets recomputed from the static load rating C0 = f0 Z Dw^2 (ISO 76); clearance classes
ISO 5753-1.
"""

import math
from dataclasses import dataclass

from scipy.special import ellipe, ellipk

STEEL_DENSITY = 7810.0  # kg/m3
STEEL_HEAT_CAPACITY = 460.0  # J/(kg K)
STEEL_CONDUCTIVITY = 46.0  # W/(m K), through-hardened bearing steel
STEEL_EXPANSION = 12.0e-6  # 1/K
STEEL_MODULUS = 207.0e9  # Pa
STEEL_POISSON = 0.3
BRASS_HEAT_CAPACITY = 385.0  # J/(kg K)


@dataclass(frozen=True, slots=True)
class BenchBearing:
    """A deep groove ball bearing as the virtual bench knows it.

    Lengths in metres, masses in kilograms. `r1` and `s1` are the geometry constants of the SKF
    frictional moment without axial load (N.mm, mm and N).
    """

    name: str
    bore_m: float
    outside_m: float
    width_m: float
    inner_shoulder_m: float
    outer_shoulder_m: float
    ball_count: int
    ball_m: float
    outer_ring_kg: float
    inner_ring_kg: float
    cage_kg: float
    grease_kg: float
    r1: float
    s1: float
    groove_conformity: float = 0.52

    @property
    def pitch_m(self) -> float:
        """Pitch diameter of the ball set in metres."""
        return 0.5 * (self.bore_m + self.outside_m)

    @property
    def inner_groove_m(self) -> float:
        """Diameter of the inner raceway at the bottom of its groove in metres."""
        return self.pitch_m - self.ball_m

    @property
    def outer_groove_m(self) -> float:
        """Diameter of the outer raceway at the bottom of its groove in metres."""
        return self.pitch_m + self.ball_m

    @property
    def ball_kg(self) -> float:
        """Mass of one ball in kilograms."""
        return STEEL_DENSITY * math.pi * self.ball_m**3 / 6.0


BEARINGS = {
    "6311": BenchBearing(
        name="6311",
        bore_m=0.055,
        outside_m=0.120,
        width_m=0.029,
        inner_shoulder_m=0.0753,
        outer_shoulder_m=0.104,
        ball_count=8,
        ball_m=0.020638,
        outer_ring_kg=0.592,
        inner_ring_kg=0.384,
        cage_kg=0.42,
        grease_kg=0.062,
        r1=3.7e-7,
        s1=2.84e-3,
    ),
    "6016": BenchBearing(
        name="6016",
        bore_m=0.080,
        outside_m=0.125,
        width_m=0.022,
        inner_shoulder_m=0.0944,
        outer_shoulder_m=0.115,
        ball_count=14,
        ball_m=0.013494,
        outer_ring_kg=0.319,
        inner_ring_kg=0.293,
        cage_kg=0.30,
        grease_kg=0.045,
        r1=4.1e-7,
        s1=3.73e-3,
    ),
}


@dataclass(frozen=True, slots=True)
class HertzContact:
    """Ball on groove: how the contact grows with its load."""

    #: Semi-axes of the contact ellipse at a load of 1 N; both grow with load^(1/3).
    semi_major_m: float
    semi_minor_m: float
    stiffness: float  # K of Q = K delta^1.5 in N/m^1.5


def hertz_contact(bearing: BenchBearing, *, inner: bool) -> HertzContact:
    """Elliptic point contact of one ball with one raceway (Hertz).

    The axis ratio is solved from the curvature difference with complete elliptic integrals.
    Constants are at 1 N.
    """
    gamma = bearing.ball_m / bearing.pitch_m
    rolling = 2.0 * gamma / (1.0 - gamma) if inner else -2.0 * gamma / (1.0 + gamma)
    across = 1.0 / bearing.groove_conformity
    curvature_sum = (4.0 - across + rolling) / bearing.ball_m
    difference = (across + rolling) / (4.0 - across + rolling)

    def curvature_difference(ratio: float) -> float:
        m = 1.0 - 1.0 / ratio**2
        first, second = float(ellipk(m)), float(ellipe(m))
        return ((ratio**2 + 1.0) * second - 2.0 * first) / ((ratio**2 - 1.0) * second)

    low, high = 1.0001, 1000.0  # the difference rises with the ratio: bisection is enough
    for _ in range(200):
        middle = math.sqrt(low * high)
        if curvature_difference(middle) < difference:
            low = middle
        else:
            high = middle
    ratio = math.sqrt(low * high)
    m = 1.0 - 1.0 / ratio**2
    first, second = float(ellipk(m)), float(ellipe(m))
    compliance = 2.0 * (1.0 - STEEL_POISSON**2) / STEEL_MODULUS
    size = (3.0 * compliance / (2.0 * curvature_sum)) ** (1.0 / 3.0)
    semi_major = (2.0 * ratio**2 * second / math.pi) ** (1.0 / 3.0) * size
    semi_minor = (2.0 * second / (math.pi * ratio)) ** (1.0 / 3.0) * size
    approach = (
        2.0
        * first
        / math.pi
        * (math.pi / (2.0 * ratio**2 * second)) ** (1.0 / 3.0)
        * (3.0 * compliance / (2.0 * curvature_sum)) ** (2.0 / 3.0)
        * curvature_sum
        / 2.0
    )
    return HertzContact(semi_major, semi_minor, approach**-1.5)


def ball_stiffness(bearing: BenchBearing) -> float:
    """Stiffness K of Q = K delta^1.5 of a ball between both raceways in N/m^1.5."""
    inner = hertz_contact(bearing, inner=True).stiffness
    outer = hertz_contact(bearing, inner=False).stiffness
    return float((inner ** (-2.0 / 3.0) + outer ** (-2.0 / 3.0)) ** -1.5)
