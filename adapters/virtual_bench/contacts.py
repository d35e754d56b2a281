"""Load zone of the ball set and heat through the rolling contacts.

Sources: load distribution with clearance after T. A. Harris, Rolling Bearing Analysis; conductance
of a small moving heat source after Y. S. Muzychka, M. M. Yovanovich (J. Tribol. 2001), as used in
Wang et al., Appl. Sci. 2025, 15(12), 6671, eq. 5.
"""

import math
from typing import NamedTuple

from adapters.virtual_bench.bearings import (
    STEEL_CONDUCTIVITY,
    STEEL_DENSITY,
    STEEL_EXPANSION,
    STEEL_HEAT_CAPACITY,
    BenchBearing,
    ball_stiffness,
    hertz_contact,
)
from adapters.virtual_bench.compiling import compiled
from adapters.virtual_bench.parameters import BenchParameters

_ASSEMBLY_C = 20.0  # temperature at which the clearance was measured
_SEIZED = 5.0  # bound of the preload factor: a bearing that runs away yields, numbers stay finite


class ContactConstants(NamedTuple):
    """Numbers of the load zone and of the contact conductances (SI units)."""

    ball_count: int
    stiffness: float
    mounted_clearance_m: float
    inner_groove_m: float
    outer_groove_m: float
    ball_m: float
    ball_mass_kg: float
    pitch_m: float
    preload_share: float
    inner_moving: float
    outer_moving: float
    inner_still: float
    outer_still: float


def contact_constants(bearing: BenchBearing, parameters: BenchParameters) -> ContactConstants:
    """Collect the constants of the load zone of one bench."""
    gamma = bearing.ball_m / bearing.pitch_m
    diffusivity = STEEL_CONDUCTIVITY / (STEEL_DENSITY * STEEL_HEAT_CAPACITY)
    # speed of the contact along both surfaces per rpm of the inner ring
    speed_per_rpm = math.pi / 60.0 * bearing.pitch_m / 2.0 * (1.0 - gamma**2)
    moving, still = [], []
    for inner in (True, False):
        contact = hertz_contact(bearing, inner=inner)
        # one body: R = sqrt(alpha) / (pi k sqrt(a b^2 u)); two bodies in series; a b^2 ~ load
        track = contact.semi_major_m * contact.semi_minor_m**2
        moving.append(
            parameters.contact_scale
            * math.pi
            * STEEL_CONDUCTIVITY
            / (2.0 * math.sqrt(diffusivity))
            * math.sqrt(track * speed_per_rpm)
        )
        # at standstill: constriction of a stationary contact, 2 k sqrt(a b) per body
        radius = math.sqrt(contact.semi_major_m * contact.semi_minor_m)
        still.append(parameters.contact_scale * STEEL_CONDUCTIVITY * radius)
    return ContactConstants(
        ball_count=bearing.ball_count,
        stiffness=ball_stiffness(bearing),
        mounted_clearance_m=(parameters.clearance_um - parameters.fit_um) * 1e-6,
        inner_groove_m=bearing.inner_groove_m,
        outer_groove_m=bearing.outer_groove_m,
        ball_m=bearing.ball_m,
        ball_mass_kg=bearing.ball_kg,
        pitch_m=bearing.pitch_m,
        preload_share=parameters.preload_share,
        inner_moving=moving[0],
        outer_moving=moving[1],
        inner_still=still[0],
        outer_still=still[1],
    )


@compiled
def ring_displacement(
    load_n: float, clearance_m: float, stiffness: float, ball_count: int
) -> float:
    """Radial displacement in metres of the inner ring under a load, one ball below the load.

    Solves sum K max(0, delta cos psi - P/2)^1.5 cos psi = F by Newton steps inside a bracket; a
    negative clearance is a preload.
    """
    half = 0.5 * clearance_m
    low = 0.0
    high = (load_n / stiffness) ** (2.0 / 3.0) + max(half, 0.0)
    delta = high
    for _ in range(60):
        force = -load_n
        slope = 0.0
        for j in range(ball_count):
            cosine = math.cos(2.0 * math.pi * j / ball_count)
            approach = delta * cosine - half
            if approach > 0.0:
                root = math.sqrt(approach)
                force += stiffness * approach * root * cosine
                slope += 1.5 * stiffness * root * cosine * cosine
        if abs(force) < 1e-6 * load_n:
            break
        if force > 0.0:
            high = delta
        else:
            low = delta
        step = delta - force / slope if slope > 0.0 else low
        delta = step if low < step < high else 0.5 * (low + high)
    return float(delta)


@compiled
def load_sums(
    load_n: float,
    clearance_m: float,
    centrifugal_n: float,
    constants: ContactConstants,
) -> tuple[float, float, float, float, float]:
    """Sum Q and its roots over the ball set at the inner and the outer raceway.

    Returns the sums of Q_i, Q_i^(1/2), Q_o^(1/2), Q_i^(1/3), Q_o^(1/3); Q_o contains the
    centrifugal force of the ball.
    """
    delta = ring_displacement(load_n, clearance_m, constants.stiffness, constants.ball_count)
    total = 0.0
    inner_half = 0.0
    outer_half = 0.0
    inner_third = 0.0
    outer_third = 0.0
    for j in range(constants.ball_count):
        approach = delta * math.cos(2.0 * math.pi * j / constants.ball_count) - 0.5 * clearance_m
        force = 0.0
        if approach > 0.0:
            force = constants.stiffness * approach * math.sqrt(approach)
        total += force
        inner_half += math.sqrt(force)
        outer_half += math.sqrt(force + centrifugal_n)
        inner_third += force ** (1.0 / 3.0)
        outer_third += (force + centrifugal_n) ** (1.0 / 3.0)
    return total, inner_half, outer_half, inner_third, outer_third


@compiled
def contact_state(
    speed_rpm: float,
    load_n: float,
    inner_ring_c: float,
    ball_c: float,
    outer_ring_c: float,
    constants: ContactConstants,
) -> tuple[float, float, float]:
    """Thermal preload and contact conductances at the present temperatures.

    ``inner_ring_c``, ``ball_c``, ``outer_ring_c``: mean temperatures of rings and balls in degC;
    they set the operating clearance. Returns the factor on the load that causes friction (1 at the
    mounted clearance), and the conductance of the inner and of the outer raceway contacts in W/K.
    """
    load = max(load_n, 1.0)
    growth = STEEL_EXPANSION * (
        constants.inner_groove_m * (inner_ring_c - _ASSEMBLY_C)
        + 2.0 * constants.ball_m * (ball_c - _ASSEMBLY_C)
        - constants.outer_groove_m * (outer_ring_c - _ASSEMBLY_C)
    )
    gamma = constants.ball_m / constants.pitch_m
    orbit = math.pi / 60.0 * speed_rpm * (1.0 - gamma)  # rad/s of the ball set
    centrifugal = 0.5 * constants.ball_mass_kg * constants.pitch_m * orbit * orbit
    operating = constants.mounted_clearance_m - growth
    total, inner_half, outer_half, inner_third, outer_third = load_sums(
        load, operating, centrifugal, constants
    )
    reference = load_sums(load, constants.mounted_clearance_m, 0.0, constants)[0]
    factor = 1.0 + constants.preload_share * (total / reference - 1.0)
    root_speed = math.sqrt(speed_rpm)
    inner = math.hypot(
        constants.inner_moving * root_speed * inner_half, constants.inner_still * inner_third
    )
    outer = math.hypot(
        constants.outer_moving * root_speed * outer_half, constants.outer_still * outer_third
    )
    return min(max(factor, 0.1), _SEIZED), inner, outer
