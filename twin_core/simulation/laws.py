"""What single parts of a network do: edges, the friction heat, films.

Each function is compiled into all kernels. Limits at and near standstill are explained next to
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
COPPER, POWER, SPEED_LOSS = 7, 8, 9
COPPER_REFERENCE_C = 20.0
FILM_REFERENCE_K = 12.0
PALMGREN_BRANCH = math.log(2000.0)
"""Equation (3) changes its form at nu n = 2000."""


@compiled
def loss_at_zero_w(kind, c, speed, driving):  # type: ignore[no-untyped-def]
    """Heat in W of a loss at 0 degC; what it gains with temperature is in `edge_conductance`."""
    if kind == COPPER:
        return c[0] * (1.0 - c[1] * COPPER_REFERENCE_C) * driving * driving
    if kind == POWER:
        size = (abs(driving) / c[1]) ** c[2]
        return math.copysign(c[0] * c[1] * size, driving)
    return c[0] * (speed / c[1]) ** c[2]


@compiled
def loss_gradient(kind, c, speed, driving, out):  # type: ignore[no-untyped-def]
    """Fill out (MAX_COEFFICIENTS,) with the derivatives of `loss_at_zero_w` by c."""
    out[:] = 0.0
    if kind == COPPER:
        square = driving * driving
        out[0] = (1.0 - c[1] * COPPER_REFERENCE_C) * square
        out[1] = -c[0] * COPPER_REFERENCE_C * square
    elif kind == POWER:
        relative = abs(driving) / c[1]
        size = math.copysign(c[1] * relative ** c[2], driving)
        out[0] = size
        out[1] = c[0] * (1.0 - c[2]) * size / c[1]
        if relative > 0.0:
            out[2] = c[0] * size * math.log(relative)
    else:
        power = (speed / c[1]) ** c[2]
        out[0] = power
        out[1] = -c[0] * c[2] * power / c[1]
        if speed > 0.0:
            out[2] = c[0] * power * math.log(speed / c[1])


@compiled
def edge_conductance(kind, c, speed, load, driving):  # type: ignore[no-untyped-def]
    """Conductance in W/K of an edge (a film: at its reference difference).

    That of a loss is what its heat loses per kelvin: below zero for copper, else zero.
    """
    if kind == COPPER:
        return -c[0] * c[1] * driving * driving
    if kind >= POWER:
        return 0.0
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
def edge_gradient(kind, c, speed, load, driving, out):  # type: ignore[no-untyped-def]
    """Fill out (MAX_COEFFICIENTS,) with the derivatives of `edge_conductance` by c."""
    out[:] = 0.0
    if kind == COPPER:
        out[0] = -c[1] * driving * driving
        out[1] = -c[0] * driving * driving
        return
    if kind >= POWER:
        return
    conductance = edge_conductance(kind, c, speed, load, driving)
    if kind == CONTACT:
        product = max(load, CONTACT_MIN_LOAD_N) * max(speed, CONTACT_MIN_SPEED_RPM)
        out[0] = out[1] = -conductance * conductance
        out[2] = out[0] / math.sqrt(product)
    elif kind == CONVECTIVE:
        power = speed ** c[3]
        out[0] = -conductance / c[0]
        out[1] = 1.0 / c[0]
        out[2] = power / c[0]
        if speed > 0.0:
            out[3] = c[2] * power * math.log(speed) / c[0]
    elif kind == CONVECTIVE_REFERENCE:
        power = (speed / REFERENCE_SPEED_RPM) ** c[3]
        out[0] = -conductance / c[0]
        out[1] = (1.0 - power) / c[0]
        out[2] = power / c[0]
        if speed > 0.0:
            out[3] = (c[2] - c[1]) * power * math.log(speed / REFERENCE_SPEED_RPM) / c[0]
    elif kind == FILM:
        out[0] = 1.0
    elif kind == SHAFT_SINK:
        out[0] = 1.0
        out[1] = (speed / 6000.0) ** (2.0 / 3.0)
    elif kind == SPEED_POWER:
        relative = max(speed, POWER_MIN_SPEED_RPM) / c[1]
        out[0] = -conductance / c[0]
        out[1] = conductance * c[2] / c[1]
        out[2] = -conductance * math.log(relative)
    else:
        out[0] = -conductance * conductance


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
def friction_gradient(  # type: ignore[no-untyped-def]
    kind, c, speed, load, temperature, revolutions, out
):
    """Fill out (coefficients,) with the derivatives of the heat by c; gives that by temperature."""
    out[:] = 0.0
    if kind == LINEAR:
        out[0], out[1], out[2] = speed, load, 1.0
        return 0.0
    point = friction_at_point(kind, c, speed, load)
    if friction_heat_w(kind, c, point, temperature, revolutions) >= HEAT_LIMIT_W:
        return 0.0
    if kind == PALMGREN:
        logarithm = point[2] - point[3] * temperature
        flows = logarithm >= PALMGREN_BRANCH
        viscous = math.exp(2.0 / 3.0 * logarithm) if flows else 160.0
        heat = point[0] * point[4] * viscous
        out[0] = point[0] * 1e-7 * c[1] ** 3 * viscous
        out[1] = point[0] * point[1] / c[1] + 3.0 * heat / c[1]
        out[2] = -0.55 * point[0] * point[1] / c[2]
        if not flows:
            return 0.0
        out[3] = 2.0 / 3.0 * heat / c[3]
        out[4] = 2.0 / 3.0 * heat * (c[5] - temperature)
        out[5] = 2.0 / 3.0 * heat * c[4]
        return -2.0 / 3.0 * heat * c[4]
    distance = max(temperature + 95.0, 35.0)
    viscosity = 989.0 / distance - 989.0 / 155.0
    relative_speed = math.log(max(speed / REFERENCE_SPEED_RPM, LAW_MIN_FRACTION))
    relative_load = math.log(max(load / REFERENCE_LOAD_N, LAW_MIN_FRACTION))
    exponent = (c[1] + c[2] * relative_speed) * relative_speed + c[6] * relative_load
    exponent += (c[3] + c[4] * relative_speed) * viscosity
    left = math.exp(-revolutions / c[9])
    fresh = 1.0 + c[8] * left
    viscous, sliding = math.exp(exponent), math.exp(c[7] * relative_load)
    both = (1.0 - c[5]) * viscous + c[5] * sliding
    level = point[0] * c[0]
    rolling = level * (1.0 - c[5]) * viscous * fresh
    out[0] = point[0] * both * fresh
    out[1] = rolling * relative_speed
    out[2] = rolling * relative_speed * relative_speed
    out[3] = rolling * viscosity
    out[4] = rolling * relative_speed * viscosity
    out[5] = level * (sliding - viscous) * fresh
    out[6] = rolling * relative_load
    out[7] = level * c[5] * sliding * fresh * relative_load
    out[8] = level * both * left
    out[9] = level * both * c[8] * left * revolutions / (c[9] * c[9])
    if temperature + 95.0 <= 35.0:
        return 0.0
    return -rolling * (c[3] + c[4] * relative_speed) * 989.0 / (distance * distance)


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


@compiled
def film_gradient(conductance, exponent, difference, out):  # type: ignore[no-untyped-def]
    """Derivatives of what `film_excess_w` gives.

    Fills out (2, 3): rows for heat and slope, columns by conductance, exponent and difference.
    """
    size = abs(difference)
    out[:] = 0.0
    if size < 1e-9:
        return
    ratio = math.log(size / FILM_REFERENCE_K)
    relative = math.exp(exponent * ratio)
    out[0, 0] = (relative - 1.0) * difference
    out[0, 1] = conductance * relative * ratio * difference
    out[0, 2] = conductance * ((1.0 + exponent) * relative - 1.0)
    out[1, 0] = (1.0 + exponent) * relative - 1.0
    out[1, 1] = conductance * relative * (1.0 + (1.0 + exponent) * ratio)
    out[1, 2] = conductance * (1.0 + exponent) * exponent * relative / difference
