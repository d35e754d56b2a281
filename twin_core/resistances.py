"""Constant thermal resistances (table 2 of the paper, restored) in K/W; all inputs in SI units.

R3 and R4 of the table need a gap length and, for R4, the fluid's conductivity, which the table
omits (Holman's joint formula has it). For interference fits and bolted joints a joint coefficient
in W/m2K is used instead: R3 with a gap as thin as the roughness would make them perfect.
"""

import math


def radial_shell(
    inner_m: float, outer_m: float, length_m: float, conductivity_w_mk: float
) -> float:
    """R1 = ln(do / di) / (2 pi k L): a cylindrical shell, conducting radially."""
    return math.log(outer_m / inner_m) / (2.0 * math.pi * conductivity_w_mk * length_m)


def ball(radius_m: float, conductivity_w_mk: float) -> float:
    """R2 = 1 / (pi k r): one ball from contact to contact."""
    return 1.0 / (math.pi * conductivity_w_mk * radius_m)


def clearance_joint(
    gap_m: float,
    area_m2: float,
    contact_fraction: float,
    conductivity_w_mk: float,
    fluid_conductivity_w_mk: float,
) -> float:
    """R4: two equal solids that touch on a fraction of the area, a fluid fills the rest.

    Mean gap length Lg, apparent area A, contact fraction Ac / A, conductivities of solids and
    fluid.
    """
    per_area = (
        contact_fraction * conductivity_w_mk + (1.0 - contact_fraction) * fluid_conductivity_w_mk
    )
    return gap_m / (area_m2 * per_area)


def joint(coefficient_w_m2k: float, area_m2: float) -> float:
    """1 / (h A): a fit, a bolted joint (h is its joint coefficient) or a convective film (R6)."""
    return 1.0 / (coefficient_w_m2k * area_m2)


def bar(length_m: float, area_m2: float, conductivity_w_mk: float) -> float:
    """R5 = L / (k S): conduction along a bar."""
    return length_m / (conductivity_w_mk * area_m2)


def heated_cylinder(length_m: float, conductivity_w_mk: float) -> float:
    """1 / (8 pi k L): a solid cylinder from its mean temperature to its surface."""
    return 1.0 / (8.0 * math.pi * conductivity_w_mk * length_m)


def spreading(radius_m: float, conductivity_w_mk: float) -> float:
    """1 / (4 k a): from a disc of radius a into a half-space."""
    return 1.0 / (4.0 * conductivity_w_mk * radius_m)


def annulus(inner_m: float, outer_m: float) -> float:
    """Area of an annulus in m2."""
    return math.pi / 4.0 * (outer_m**2 - inner_m**2)


def cylinder_side(diameter_m: float, length_m: float) -> float:
    """Lateral area of a cylinder in m2."""
    return math.pi * diameter_m * length_m
