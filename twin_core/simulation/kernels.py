"""The compiled core: friction, resistances, exact zero-order hold with one corrector.

Everything compiled lives in this one file on purpose: numba's on-disk cache notices changes of
the file a function stands in, not of the functions it calls.

Between two instants the network is linear but for the heat: C dT/dt = -L T + g Ta + q. With the
symmetric S = C^-1/2 L C^-1/2 = V diag(lam) V', the coordinates y = V' C^1/2 T decouple and, for a
q that is linear in time within the step, the solution is exact:

    y1 = e y0 + h phi1 b0 + h phi2 (b1 - b0),      b = V' C^-1/2 (g Ta + q)

with e = exp(-lam h), phi1 = (1 - e) / (lam h), phi2 = (1 - phi1) / (lam h). The predictor takes
b1 = b0; the corrector evaluates the heat at the predicted temperatures.
"""

import math

import numpy as np
from numba import njit

MAX_STEP_S = 60.0
"""Longer rows are divided into equal steps no longer than this."""
FRESH_STEP_S = 15.0
FRESH_S = 120.0
"""For this long after a change of the operating point the steps are shorter: the heat moves
fastest there. It depends on the profile alone, so results stay smooth in the parameters."""
FRESH_SPEED_FRACTION = 0.02
FRESH_LOAD_FRACTION = 0.05
"""Smaller changes are measurement noise and need no shorter steps."""
HOLD_GROWTH = 0.1
HOLD_LONGEST_STEP_S = 960.0
"""Held points (`hold_points_range`): steps of FRESH_STEP_S double whenever the doubled step is at
most this share of the time since the start, up to the longest one."""
STEADY_BALANCE_W = 1e-6
STEADY_ITERATIONS = 20
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
PALMGREN, LINEAR = 0, 2
CONSTANT, CONTACT, CONVECTIVE, CONVECTIVE_REFERENCE, FILM, SHAFT_SINK = 0, 1, 2, 3, 4, 5
SPEED_POWER = 6
FILM_REFERENCE_K = 12.0
PALMGREN_BRANCH = math.log(2000.0)
"""Equation (3) changes its form at nu n = 2000."""


def compiled(function):  # type: ignore[no-untyped-def]
    """Compile without the GIL, cached on disk where any cache folder is writable."""
    try:
        return njit(nogil=True, cache=True, error_model="numpy")(function)
    except RuntimeError:
        # Neither the package folder nor the user's cache folder can be written.
        return njit(nogil=True, error_model="numpy")(function)


@compiled
def bound(factor, index, values):  # type: ignore[no-untyped-def]
    """Return a coefficient: its factor times its parameter, if it has one."""
    if index < 0:
        return factor
    return factor * values[index]


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
def friction_heat_w(kind, c, point, temperature, revolutions):  # type: ignore[no-untyped-def]
    """Heat in W at the temperature of the lubricant; limited unless it is independent of it."""
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
        fresh = 1.0 + c[8] * math.exp(-revolutions / c[9]) if c[8] != 0.0 else 1.0
        moment = (point[1] * math.exp(point[2] * viscosity) + point[3]) * fresh
    return min(point[0] * moment, HEAT_LIMIT_W)


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
def bind_network(net, values):  # type: ignore[no-untyped-def]
    """Apply a parameter vector: capacities, edge and friction coefficients, heat per node."""
    count = net.capacity.size
    capacity = np.empty(count)
    for i in range(count):
        capacity[i] = bound(net.capacity[i], net.capacity_parameter[i], values)
    coefficient = np.empty_like(net.edge_coefficient)
    for e in range(coefficient.shape[0]):
        for j in range(coefficient.shape[1]):
            coefficient[e, j] = bound(net.edge_coefficient[e, j], net.edge_parameter[e, j], values)
    friction = np.empty_like(net.friction_coefficient)
    for j in range(friction.size):
        friction[j] = bound(net.friction_coefficient[j], net.friction_parameter[j], values)
    share = np.zeros(count)
    rest = 1.0
    last = net.share_node.size - 1
    for j in range(last):
        fraction = bound(net.share_fraction[j], net.share_parameter[j], values)
        share[net.share_node[j]] += rest * fraction
        rest *= 1.0 - fraction
    share[net.share_node[last]] += rest
    return capacity, coefficient, friction, share


@compiled
def film_edges(net, coefficient):  # type: ignore[no-untyped-def]
    """Node, conductance and exponent of every film with a temperature-dependent coefficient."""
    count = 0
    for e in range(net.edge_kind.size):
        if net.edge_kind[e] == FILM:
            count += 1
    node = np.empty(count, np.int64)
    law = np.empty((count, 2))
    k = 0
    for e in range(net.edge_kind.size):
        if net.edge_kind[e] == FILM:
            node[k] = net.edge_nodes[e, 0]
            law[k, 0] = coefficient[e, 0]
            law[k, 1] = coefficient[e, 1]
            k += 1
    return node, law


@compiled
def edge_conductances(net, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """Conductance of every edge in W/K (edges,)."""
    result = np.empty(net.edge_kind.size)
    for e in range(result.size):
        result[e] = edge_conductance(net.edge_kind[e], coefficient[e], speed, load)
    return result


@compiled
def conductance_matrix(net, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """L (nodes, nodes) and the conductances to ambient g (nodes,), both in W/K."""
    count = net.capacity.size
    matrix = np.zeros((count, count))
    to_ambient = np.zeros(count)
    for e in range(net.edge_kind.size):
        conductance = edge_conductance(net.edge_kind[e], coefficient[e], speed, load)
        a, b = net.edge_nodes[e, 0], net.edge_nodes[e, 1]
        matrix[a, a] += conductance
        if b == count:
            to_ambient[a] += conductance
        else:
            matrix[b, b] += conductance
            matrix[a, b] -= conductance
            matrix[b, a] -= conductance
    return matrix, to_ambient


@compiled
def decompose(net, capacity, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """Modes of an operating point: rates lam (1/s), T = modes @ y, y = inverse @ T, ambient b.

    Heat q at node i adds modes[i] * q to the modal input b. Without a solution all is NaN.
    """
    matrix, to_ambient = conductance_matrix(net, coefficient, speed, load)
    count = capacity.size
    root = np.sqrt(capacity)
    finite = True
    for i in range(count):
        for j in range(count):
            matrix[i, j] /= root[i] * root[j]
            finite = finite and math.isfinite(matrix[i, j])
    if not finite:  # LAPACK would not return
        nan = np.full((count, count), np.nan)
        return nan[0].copy(), nan, nan.copy(), nan[0].copy()
    rate, vector = np.linalg.eigh(matrix)
    modes = np.empty((count, count))
    inverse = np.empty((count, count))
    ambient = np.zeros(count)
    for k in range(count):
        rate[k] = max(rate[k], 0.0)
        for i in range(count):
            modes[i, k] = vector[i, k] / root[i]
            inverse[k, i] = vector[i, k] * root[i]
            ambient[k] += modes[i, k] * to_ambient[i]
    return rate, modes, inverse, ambient


@compiled
def step_functions(rate, step, decay, first, second):  # type: ignore[no-untyped-def]
    """Fill e, h phi1 and h phi2 for a step length."""
    for k in range(rate.size):
        x = rate[k] * step
        if x < 1e-4:  # series: the closed forms lose all digits
            decay[k] = math.exp(-x)
            first[k] = step * (1.0 - x * (0.5 - x / 6.0))
            second[k] = step * (0.5 - x * (1.0 / 6.0 - x / 24.0))
        else:
            decay[k] = math.exp(-x)
            phi = -math.expm1(-x) / x
            first[k] = step * phi
            second[k] = step * (1.0 - phi) / x


@compiled
def simulate_kernel(  # type: ignore[no-untyped-def]
    net, values, time, speed, load, ambient, initial, revolutions, disturbance, fading, out
):
    """Simulate one candidate; fill out (n, nodes) with temperatures at the rows' instants.

    `disturbance` (nodes,) is an extra heat in W at the first row that fades at the rate `fading`
    in 1/s. Returns the row from which on the result is unusable (the rest of `out` is NaN), or -1.
    """
    count = net.capacity.size
    capacity, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    films = film_node.size
    lubricant = net.temperature_node
    temperature = initial.copy()
    y = np.empty(count)
    predicted = np.empty(count)
    base = np.empty(count)
    b = np.empty(count)
    decay = np.empty(count)
    first = np.empty(count)
    second = np.empty(count)
    heat_input = np.empty(count)
    slope = np.empty(films)
    point = np.empty(5)
    kind = net.friction_kind
    limit = math.inf if kind == LINEAR else TEMPERATURE_LIMIT_C
    rate = np.empty(count)
    modes = np.empty((count, count))
    inverse = np.empty((count, count))
    transposed = np.empty((count, count))
    ambient_input = np.empty(count)
    point_speed, point_load, point_step = math.nan, math.nan, math.nan
    fresh_until = -math.inf
    turned = revolutions
    out[0] = temperature
    for row in range(time.size - 1):
        n = abs(speed[row])
        f = max(load[row], 0.0)
        if n != point_speed or f != point_load:
            if not (
                abs(n - point_speed) <= FRESH_SPEED_FRACTION * n
                and abs(f - point_load) <= FRESH_LOAD_FRACTION * f
            ):
                fresh_until = time[row] + FRESH_S
            rate, modes, inverse, ambient_input = decompose(net, capacity, coefficient, n, f)
            transposed = modes.T.copy()
            point = friction_at_point(kind, friction, n, f)
            point_speed, point_load, point_step = n, f, math.nan
            heat_input[:] = 0.0
            y[:] = 0.0
            for i in range(count):
                for k in range(count):
                    heat_input[k] += modes[i, k] * share[i]
                    y[k] += inverse[k, i] * temperature[i]
        for k in range(count):
            base[k] = ambient_input[k] * ambient[row]
        duration = time[row + 1] - time[row]
        left = math.exp(-fading * (time[row] + 0.5 * duration - time[0]))
        for i in range(count):
            if disturbance[i] != 0.0:
                for k in range(count):
                    base[k] += modes[i, k] * disturbance[i] * left
        # A part of shorter steps after a change, then the rest of the row.
        fresh = min(max(fresh_until - time[row], 0.0), duration)
        for part in range(2):
            span = fresh if part == 0 else duration - fresh
            steps = math.ceil(span / (FRESH_STEP_S if part == 0 else MAX_STEP_S) - 1e-9)
            if steps <= 0:
                continue
            step = span / steps
            if step != point_step:
                step_functions(rate, step, decay, first, second)
                point_step = step
            for _ in range(steps):
                heat = friction_heat_w(kind, friction, point, temperature[lubricant], turned)
                for k in range(count):
                    b[k] = base[k] + heat_input[k] * heat
                for j in range(films):
                    node = film_node[j]
                    excess, slope[j] = film_excess_w(
                        film_law[j, 0], film_law[j, 1], temperature[node] - ambient[row]
                    )
                    for k in range(count):
                        b[k] -= modes[node, k] * excess
                for k in range(count):
                    predicted[k] = decay[k] * y[k] + first[k] * b[k]
                turned += n * step / 60.0
                later = 0.0
                for k in range(count):
                    later += modes[lubricant, k] * predicted[k]
                change = friction_heat_w(kind, friction, point, later, turned) - heat
                for k in range(count):
                    b[k] = heat_input[k] * change
                for j in range(films):
                    node = film_node[j]
                    later = 0.0
                    for k in range(count):
                        later += modes[node, k] * predicted[k]
                    change = slope[j] * (later - temperature[node])
                    for k in range(count):
                        b[k] -= modes[node, k] * change
                for i in range(count):
                    temperature[i] = 0.0
                for k in range(count):
                    y[k] = predicted[k] + second[k] * b[k]
                    for i in range(count):
                        temperature[i] += transposed[k, i] * y[k]
        for i in range(count):
            out[row + 1, i] = temperature[i]
        for i in range(count):
            if not abs(temperature[i]) < limit:
                out[row + 1 :] = math.nan
                return row + 1
    return -1


@compiled
def simulate_range(  # type: ignore[no-untyped-def]
    net,
    values,
    time,
    speed,
    load,
    ambient,
    initial,
    revolutions,
    disturbance,
    fading,
    start,
    stop,
    out,
):
    """Simulate candidates start..stop-1 of a batch, each independent of all others."""
    for member in range(start, stop):
        failed = simulate_kernel(
            net,
            values[member],
            time,
            speed,
            load,
            ambient,
            initial[member],
            revolutions[member],
            disturbance,
            fading,
            out[member],
        )
        if failed >= 0:
            out[member] = math.nan


@compiled
def heat_balance(  # type: ignore[no-untyped-def]
    net, values, temperature, speed, load, ambient, revolutions
):
    """Net heat flow into every node (nodes,) and the friction heat, both in W."""
    _, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    matrix, to_ambient = conductance_matrix(net, coefficient, speed, load)
    kind = net.friction_kind
    point = friction_at_point(kind, friction, speed, load)
    heat = friction_heat_w(kind, friction, point, temperature[net.temperature_node], revolutions)
    count = temperature.size
    flow = np.empty(count)
    for i in range(count):
        flow[i] = share[i] * heat - to_ambient[i] * (temperature[i] - ambient)
        for j in range(count):
            # Differences, not L T: a huge conductance must not drown the balance in rounding.
            flow[i] += matrix[i, j] * (temperature[i] - temperature[j])
    for k in range(film_node.size):
        node = film_node[k]
        excess, _ = film_excess_w(film_law[k, 0], film_law[k, 1], temperature[node] - ambient)
        flow[node] -= excess
    return flow, heat


@compiled
def heat_balance_linearised(  # type: ignore[no-untyped-def]
    net, values, temperature, speed, load, ambient
):
    """Net heat flow (nodes,) before any revolution, and its Jacobian (nodes, nodes) in W/K."""
    flow, heat = heat_balance(net, values, temperature, speed, load, ambient, 0.0)
    _, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    matrix, _ = conductance_matrix(net, coefficient, speed, load)
    jacobian = -matrix
    lubricant = net.temperature_node
    nudge = 1e-4
    kind = net.friction_kind
    point = friction_at_point(kind, friction, speed, load)
    warmer = friction_heat_w(kind, friction, point, temperature[lubricant] + nudge, 0.0)
    for i in range(temperature.size):
        jacobian[i, lubricant] += share[i] * (warmer - heat) / nudge
    for k in range(film_node.size):
        node = film_node[k]
        _, slope = film_excess_w(film_law[k, 0], film_law[k, 1], temperature[node] - ambient)
        jacobian[node, node] -= slope
    return flow, jacobian


@compiled
def hold_points_range(  # type: ignore[no-untyped-def]
    net,
    values,
    initial,
    revolutions,
    disturbance,
    fading,
    ambient,
    speed,
    load,
    rows,
    limit,
    horizon,
    start,
    stop,
    steady,
    crossing,
):
    """Hold each of many operating points, for candidates start..stop-1 of a batch.

    `rows` (sensors, nodes) are the sensors' weights, `limit` (B, sensors, limits) what their
    temperatures are compared with. Fills `steady` (B, points, sensors) with the steady
    temperatures and `crossing` (B, points, sensors, limits) with the times in s at which they
    first reach the limits, infinite if not within the horizon. NaN steady temperatures mean that
    there is no steady state within TEMPERATURE_LIMIT_C; what had been crossed by then stays.

    Steps grow with the time since the start: nothing but slow modes is left then.
    """
    sensors = rows.shape[0]
    limits = limit.shape[2]
    now = np.empty(sensors)
    for member in range(start, stop):
        capacity, coefficient, friction, share = bind_network(net, values[member])
        film_node, film_law = film_edges(net, coefficient)
        for cell in range(speed.size):
            n, f = speed[cell], load[cell]
            point = friction_at_point(net.friction_kind, friction, n, f)
            temperature = initial[member].copy()
            turned = revolutions
            for s in range(sensors):
                now[s] = dot(rows[s], temperature)
                for k in range(limits):
                    over = now[s] >= limit[member, s, k]
                    crossing[member, cell, s, k] = 0.0 if over else math.inf
            rate, modes, inverse, ambient_input = decompose(net, capacity, coefficient, n, f)
            alive = hold_point(
                net.friction_kind,
                net.temperature_node,
                friction,
                point,
                share,
                film_node,
                film_law,
                rate,
                modes,
                inverse,
                ambient_input * ambient,
                ambient,
                disturbance,
                fading,
                n,
                turned,
                horizon,
                rows,
                limit[member],
                temperature,
                crossing[member, cell],
            )
            turned += n * horizon / 60.0
            if alive:
                matrix, to_ambient = conductance_matrix(net, coefficient, n, f)
                alive = polish_steady_state(
                    net.friction_kind,
                    net.temperature_node,
                    friction,
                    point,
                    share,
                    film_node,
                    film_law,
                    matrix,
                    to_ambient,
                    ambient,
                    turned,
                    temperature,
                )
            for s in range(sensors):
                steady[member, cell, s] = dot(rows[s], temperature) if alive else math.nan


@compiled
def dot(a, b):  # type: ignore[no-untyped-def]
    """Sum of products of two vectors."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@compiled
def hold_point(  # type: ignore[no-untyped-def]
    kind,
    lubricant,
    friction,
    point,
    share,
    film_node,
    film_law,
    rate,
    modes,
    inverse,
    ambient_input,
    ambient,
    disturbance,
    fading,
    speed,
    revolutions,
    horizon,
    rows,
    limit,
    temperature,
    crossing,
):
    """Advance `temperature` over the horizon at one point and note when limits are crossed.

    As `simulate_kernel`, but only the temperatures that matter on the way are computed.
    """
    count = rate.size
    sensors, limits = limit.shape
    films = film_node.size
    y = inverse @ temperature
    heat_input = modes.T @ share
    disturbed = modes.T @ disturbance
    # What is looked at on the way: the lubricant, the nodes with a film, the sensors.
    watched = 1 + films + sensors
    view = np.empty((count, watched))
    for k in range(count):
        view[k, 0] = modes[lubricant, k]
        for j in range(films):
            view[k, 1 + j] = modes[film_node[j], k]
        for s in range(sensors):
            view[k, 1 + films + s] = dot(rows[s], modes[:, k])
    now = np.empty(watched)
    later = np.empty(watched)
    predicted = np.empty(count)
    b = np.empty(count)
    decay = np.empty(count)
    first = np.empty(count)
    second = np.empty(count)
    slope = np.empty(films)
    watch(view, y, now)
    top = math.inf if kind == LINEAR else TEMPERATURE_LIMIT_C
    time, turned, grown, last_step = 0.0, revolutions, FRESH_STEP_S, math.nan
    while time < horizon:
        if 2.0 * grown <= min(HOLD_GROWTH * time, HOLD_LONGEST_STEP_S):
            grown *= 2.0
        step = min(grown, horizon - time)
        if step != last_step:
            step_functions(rate, step, decay, first, second)
            last_step = step
        left = math.exp(-fading * (time + 0.5 * step))
        heat = friction_heat_w(kind, friction, point, now[0], turned)
        for k in range(count):
            b[k] = ambient_input[k] + heat_input[k] * heat + disturbed[k] * left
        for j in range(films):
            excess, slope[j] = film_excess_w(film_law[j, 0], film_law[j, 1], now[1 + j] - ambient)
            for k in range(count):
                b[k] -= view[k, 1 + j] * excess
        for k in range(count):
            predicted[k] = decay[k] * y[k] + first[k] * b[k]
        turned += speed * step / 60.0
        watch(view, predicted, later)
        change = friction_heat_w(kind, friction, point, later[0], turned) - heat
        for k in range(count):
            b[k] = heat_input[k] * change
        for j in range(films):
            change = slope[j] * (later[1 + j] - now[1 + j])
            for k in range(count):
                b[k] -= view[k, 1 + j] * change
        for k in range(count):
            y[k] = predicted[k] + second[k] * b[k]
        watch(view, y, later)
        for s in range(sensors):
            old, new = now[1 + films + s], later[1 + films + s]
            for k in range(limits):
                if new >= limit[s, k] and crossing[s, k] == math.inf:
                    part = min(max((limit[s, k] - old) / (new - old), 0.0), 1.0)
                    crossing[s, k] = time + step * part
        now[:] = later
        time += step
        if not abs(now[0]) < top:
            return False
    for i in range(count):
        temperature[i] = dot(modes[i], y)
    return True


@compiled
def watch(view, y, out):  # type: ignore[no-untyped-def]
    """Fill out with y @ view, the loop arranged so that it runs on vector units."""
    out[:] = 0.0
    for k in range(y.size):
        for r in range(out.size):
            out[r] += view[k, r] * y[k]


@compiled
def polish_steady_state(  # type: ignore[no-untyped-def]
    kind,
    lubricant,
    friction,
    point,
    share,
    film_node,
    film_law,
    matrix,
    to_ambient,
    ambient,
    revolutions,
    temperature,
):
    """Newton from temperatures near the steady state; tells whether they closed the balance."""
    count = temperature.size
    top = math.inf if kind == LINEAR else TEMPERATURE_LIMIT_C
    flow = np.empty(count)
    for _ in range(STEADY_ITERATIONS):
        heat = friction_heat_w(kind, friction, point, temperature[lubricant], revolutions)
        warmer = friction_heat_w(kind, friction, point, temperature[lubricant] + 1e-4, revolutions)
        jacobian = matrix.copy()
        for i in range(count):
            flow[i] = share[i] * heat - to_ambient[i] * (temperature[i] - ambient)
            for j in range(count):
                flow[i] += matrix[i, j] * (temperature[i] - temperature[j])
            jacobian[i, lubricant] -= share[i] * (warmer - heat) / 1e-4
        for j in range(film_node.size):
            node = film_node[j]
            excess, slope = film_excess_w(
                film_law[j, 0], film_law[j, 1], temperature[node] - ambient
            )
            flow[node] -= excess
            jacobian[node, node] += slope
        worst = 0.0
        for i in range(count):
            worst = max(worst, abs(flow[i]))
        if worst < STEADY_BALANCE_W:
            return True
        move = np.linalg.solve(jacobian, flow)
        for i in range(count):
            temperature[i] += move[i]
            if not abs(temperature[i]) < top:
                return False
    return False
