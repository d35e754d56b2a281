"""What single parts of a network do: edges, the friction heat, films.

Each function is compiled into all kernels. Limits at and near standstill are explained beside
their constants.
"""

import math

import numpy as np

from twin_core.simulation.compiling import compiled

HEAT_LIMIT_W = 3000.0
"""No bearing of this size survives more friction heat; keeps a run-away model computable."""
TEMPERATURE_LIMIT_C = 2000.0
"""Beyond this a simulation counts as run away. Only heat that depends on temperature can run away;
a LINEAR source is bound by neither limit."""

# Limits at and near standstill. Below some 10 rpm the heat source no longer moves relative to
# the contact (Peclet number about one) and the contact conducts like a resting one; 50 N is about
# the weight of a shaft. A power of speed stays finite. The friction law was regressed above
# 1500 rpm and 2650 N: its quadratic terms are frozen at a tenth of the reference point, so that
# the moment stays finite.
CONTACT_MIN_SPEED_RPM = 10.0
CONTACT_MIN_LOAD_N = 50.0
POWER_MIN_SPEED_RPM = 10.0
REFERENCE_SPEED_RPM = 3000.0
REFERENCE_LOAD_N = 2650.0
LAW_MIN_FRACTION = 0.1

# Kinds, equal to those of twin_core.network (plain integers: numba freezes them into the code).
PALMGREN, TWO_PART, LINEAR = 0, 1, 2
CONSTANT, CONTACT, CONVECTIVE, CONVECTIVE_REFERENCE, FILM, SHAFT_SINK = 0, 1, 2, 3, 4, 5
SPEED_POWER = 6
FILM_REFERENCE_K = 12.0
PALMGREN_BRANCH = math.log(2000.0)
"""Equation (3) changes its form at nu n = 2000."""


@compiled
def edge_conductance(kind, c, speed, load):  # type: ignore[no-untyped-def]
    """Conductance in W/K of an edge (a film: at its reference difference)."""
    if kind == CONTACT:
        product = max(load, CONTACT_MIN_LOAD_N) * max(speed, CONTACT_MIN_SPEED_RPM)
        return 1.0 / (c[0] + c[1] + c[2] / math.sqrt(product))
    if kind == CONVECTIVE:
        return (c[1] + c[2] * speed ** c[3]) / c[0]
    if kind == CONVECTIVE_REFERENCE:
        return (c[1] + (c[2] - c[1]) * (speed / REFERENCE_SPEED_RPM) ** c[3]) / c[0]
    if kind == FILM:
        return c[0]
    if kind == SHAFT_SINK:
        return c[0] + c[1] * (speed / 6000.0) ** (2.0 / 3.0)
    if kind == SPEED_POWER:
        return 1.0 / (c[0] * (max(speed, POWER_MIN_SPEED_RPM) / c[1]) ** c[2])
    return 1.0 / c[0]


@compiled
def friction_at_point(kind, c, speed, load):  # type: ignore[no-untyped-def]
    """Everything of a friction law that does not change while speed and load stay.

    Palmgren, c: f2, dm in mm, C0 in N, nu0 in mm2/s, beta in 1/K, T0 in degC. Two-part, c:
    moment at the reference in N.mm, p, p2, q, pq, s, b, c, A, Nr. Linear, c: W per rpm, W per N,
    W. Gives the numbers for :func:`friction_heat_w`, the first being W per N.mm.
    """
    point = np.zeros(5)
    if kind == LINEAR:
        point[1] = c[0] * speed + c[1] * load + c[2]
        return point
    point[0] = 1e-3 * 2.0 * math.pi / 60.0 * speed
    if kind == PALMGREN:
        point[1] = 0.0009 * (load / c[2]) ** 0.55 * load * c[1]
        # ln(nu n) at 0 degC and its slope: M_v = 1e-7 f2 (nu n)^(2/3) dm^3
        point[2] = math.log(max(c[3] * speed, 1e-12)) + c[4] * c[5]
        point[3] = c[4]
        point[4] = 1e-7 * c[0] * c[1] ** 3
        return point
    relative_speed = math.log(max(speed / REFERENCE_SPEED_RPM, LAW_MIN_FRACTION))
    relative_load = math.log(max(load / REFERENCE_LOAD_N, LAW_MIN_FRACTION))
    exponent = (c[1] + c[2] * relative_speed) * relative_speed
    exponent += c[6] * relative_load
    point[1] = c[0] * (1.0 - c[5]) * math.exp(exponent)
    point[2] = c[3] + c[4] * relative_speed
    point[3] = c[0] * c[5] * math.exp(c[7] * relative_load)
    return point


@compiled
def running_in(kind, c, revolutions):  # type: ignore[no-untyped-def]
    """Excess friction of fresh grease, as a part of what is left once it is run in."""
    if kind != TWO_PART or c[8] == 0.0:
        return 0.0
    return c[8] * math.exp(-revolutions / c[9])


@compiled
def heat_at_point_w(kind, point, temperature, fresh):  # type: ignore[no-untyped-def]
    """Heat in W at the lubricant's temperature; `fresh` is what `running_in` gave.

    Limited unless it is independent of the temperature.
    """
    if kind == LINEAR:
        return point[1]
    if kind == PALMGREN:
        logarithm = point[2] - point[3] * temperature
        viscous = 160.0
        if logarithm >= PALMGREN_BRANCH:
            viscous = math.exp(2.0 / 3.0 * logarithm)
        moment = point[1] + point[4] * viscous
    else:
        # Vogel's ln(nu / nu(60 degC)); far below its range the grease is solid and the law moot.
        viscosity = 989.0 / max(temperature + 95.0, 35.0) - 989.0 / 155.0
        moment = (point[1] * math.exp(point[2] * viscosity) + point[3]) * (1.0 + fresh)
    return min(point[0] * moment, HEAT_LIMIT_W)


@compiled
def friction_heat_w(kind, c, point, temperature, revolutions):  # type: ignore[no-untyped-def]
    """Heat in W at the temperature of the lubricant and the revolutions since greasing."""
    return heat_at_point_w(kind, point, temperature, running_in(kind, c, revolutions))


@compiled
def film_excess_w(conductance, exponent, difference):  # type: ignore[no-untyped-def]
    """Heat in W that a film takes up beyond its linear part, and its slope in W/K."""
    size = abs(difference)
    if size < 1e-9:
        return 0.0, 0.0
    relative = (size / FILM_REFERENCE_K) ** exponent
    return (
        conductance * (relative - 1.0) * difference,
        conductance * ((1.0 + exponent) * relative - 1.0),
    )
