"""Friction of a grease-lubricated deep groove ball bearing after the SKF model, or Palmgren's.

Sources: SKF rolling bearing catalogue, "The SKF model for calculating the frictional moment"
(rolling and sliding moment, inlet shear heating and replenishment factors); Palmgren, Grundlagen
der Wälzlagertechnik (viscous and load-dependent moment); the base oil follows Walther's law (ASTM
D341). Open bearing: no seals; grease: no oil bath drag.
"""

import math
from typing import NamedTuple

from adapters.virtual_bench.bearings import BenchBearing
from adapters.virtual_bench.compiling import compiled
from adapters.virtual_bench.parameters import BenchParameters

_GEOMETRY_K_Z = 3.1  # single row deep groove ball bearings
_BOUNDARY_FRICTION = 0.12  # mu_bl while running
_FULL_FILM_FRICTION = 0.05  # mu_EHL, mineral oil
_OIL_THAT_FEEDS = 0.4
# Palmgren's coefficients: f0 is such that both laws agree on a warm 6311 between 1500 and 6200 rpm
# (grease as delivered: 0.7 to 2), f1 = z (F/C0)^y, and the nu n in mm2/s rpm that counts at least.
_VISCOUS_F0 = 0.55
_LOAD_Z, _LOAD_Y = 0.0009, 0.55
_LEAST_VISCOUS = 2000.0
_STATIC_RATING_F0 = 14.5  # C0 = f0 Z Dw^2, ISO 76


class FrictionConstants(NamedTuple):
    """Numbers of the frictional moment that do not change during a run (mm, N, mm2/s)."""

    pitch_mm: float
    rolling_geometry: float
    rolling_load_exponent: float
    sliding_geometry: float
    replenishment: float
    replenishment_viscosity: float
    walther_a: float
    walther_b: float
    palmgren: bool


def friction_constants(bearing: BenchBearing, parameters: BenchParameters) -> FrictionConstants:
    """Collect the constants of the frictional moment of one bench."""
    pitch_mm = bearing.pitch_m * 1e3
    bore_mm, outside_mm = bearing.bore_m * 1e3, bearing.outside_m * 1e3
    cold, hot = math.log10(313.15), math.log10(373.15)
    upper = math.log10(math.log10(parameters.oil_40_mm2_s + 0.7))
    lower = math.log10(math.log10(parameters.oil_100_mm2_s + 0.7))
    slope = (upper - lower) / (hot - cold)
    palmgren = parameters.friction_law == "palmgren"
    rolling, sliding = bearing.r1 * pitch_mm**1.96, bearing.s1 * pitch_mm**-0.26
    if palmgren:
        static_n = _STATIC_RATING_F0 * bearing.ball_count * (bearing.ball_m * 1e3) ** 2
        rolling = 1e-7 * _VISCOUS_F0 * pitch_mm**3
        sliding = _LOAD_Z * pitch_mm / static_n**_LOAD_Y
    return FrictionConstants(
        pitch_mm=pitch_mm,
        rolling_geometry=parameters.friction_scale * parameters.rolling_scale * rolling,
        rolling_load_exponent=parameters.rolling_load_exponent,
        sliding_geometry=parameters.friction_scale * parameters.sliding_scale * sliding,
        replenishment=(
            parameters.replenishment_constant
            * (bore_mm + outside_mm)
            * math.sqrt(_GEOMETRY_K_Z / (2.0 * (outside_mm - bore_mm)))
        ),
        replenishment_viscosity=parameters.replenishment_viscosity_mm2_s,
        walther_a=upper + slope * cold,
        walther_b=slope,
        palmgren=palmgren,
    )


@compiled
def oil_viscosity(temperature_c: float, walther_a: float, walther_b: float) -> float:
    """Kinematic viscosity in mm2/s: log10 log10(nu + 0.7) = A - B log10 T (Walther)."""
    kelvin = min(max(temperature_c, -40.0), 250.0) + 273.15
    return float(10.0 ** (10.0 ** (walther_a - walther_b * math.log10(kelvin))) - 0.7)


@compiled
def frictional_moment(
    speed_rpm: float,
    load_n: float,
    viscosity: float,
    constants: FrictionConstants,
    dry_share: float = 0.0,
) -> tuple[float, float]:
    """Compute rolling and sliding frictional moment of the whole bearing in N.m.

    The replenishment factor is evaluated with a capped viscosity (smooth minimum): the catalogue
    form, made for the operating range, would let the friction of a cold bearing fall towards zero,
    as if it ran dry, and give a cold start a second, cold equilibrium. A cold greased bearing
    churns.

    `load_n` includes what thermal preload adds; `viscosity` is that of the base oil at the contact
    in mm2/s; `dry_share` is the share of the sliding contacts that the oil no longer reaches.
    """
    load = max(load_n, 1.0)
    if constants.palmgren:
        viscous = constants.rolling_geometry * max(viscosity * speed_rpm, _LEAST_VISCOUS) ** (
            2.0 / 3.0
        )
        # Dry contacts rub as they do in the other law: boundary friction instead of the film's.
        rubbing = 1.0 + dry_share * (_BOUNDARY_FRICTION / _FULL_FILM_FRICTION - 1.0)
        return 1e-3 * viscous, 1e-3 * constants.sliding_geometry * rubbing * load ** (1.0 + _LOAD_Y)
    shear = 1.0 / (1.0 + 1.84e-9 * (speed_rpm * constants.pitch_mm) ** 1.28 * viscosity**0.64)
    ratio = (viscosity / constants.replenishment_viscosity) ** 4
    capped = viscosity / math.sqrt(math.sqrt(1.0 + ratio))
    replenishment = math.exp(-constants.replenishment * capped * speed_rpm)
    rolling = (
        shear
        * replenishment
        * constants.rolling_geometry
        * load**constants.rolling_load_exponent
        * (viscosity * speed_rpm) ** 0.6
    )
    boundary = math.exp(-2.6e-8 * (speed_rpm * viscosity) ** 1.4 * constants.pitch_mm)
    coefficient = boundary * _BOUNDARY_FRICTION + (1.0 - boundary) * _FULL_FILM_FRICTION
    coefficient += dry_share * (_BOUNDARY_FRICTION - coefficient)
    sliding = constants.sliding_geometry * load ** (5.0 / 3.0) * coefficient
    return 1e-3 * rolling, 1e-3 * sliding


@compiled
def grease_condition(oil: float, thickening: float) -> tuple[float, float]:
    """What a grease that has lost oil does: factor on the viscosity, share of dry contacts.

    What is left is thicker: the light fractions go first. While the thickener still feeds the
    contacts nothing runs dry; that changes below two fifths of the oil (the usual figure for the
    end of a grease's life is half).

    `oil` is what is left, 1 when fresh; `thickening` the relative rise when all is gone.
    """
    dry_share = max(_OIL_THAT_FEEDS - oil, 0.0) / _OIL_THAT_FEEDS
    return 1.0 + thickening * (1.0 - oil), dry_share
