"""The compiled simulation: exact zero-order hold with one corrector.

Between two instants the network is linear but for the heat: C dT/dt = -L T + g Ta + q. In the
coordinates y of :mod:`twin_core.simulation.assembly`, and for a q that is linear in time within
the step, the solution is exact:

    y1 = e y0 + h phi1 b0 + h phi2 (b1 - b0),      b = V' C^-1/2 (g Ta + q)

with e = exp(-lam h), phi1 = (1 - e) / (lam h), phi2 = (1 - phi1) / (lam h). The predictor takes
b1 = b0; the corrector evaluates the heat at the predicted temperatures.
"""

import math

import numpy as np

from twin_core.simulation.assembly import (
    bind_network,
    conductance_matrix,
    decompose,
    edge_conductances,
    film_edges,
    heat_balance,
    heat_balance_linearised,
    step_functions,
)
from twin_core.simulation.compiling import compiled
from twin_core.simulation.laws import (
    LINEAR,
    TEMPERATURE_LIMIT_C,
    edge_conductance,
    film_excess_w,
    friction_at_point,
    friction_heat_w,
)

__all__ = [
    "bind_network",
    "conductance_matrix",
    "decompose",
    "edge_conductance",
    "edge_conductances",
    "film_excess_w",
    "friction_at_point",
    "friction_heat_w",
    "heat_balance",
    "heat_balance_linearised",
    "simulate_kernel",
    "simulate_range",
]


MAX_STEP_S = 60.0
"""Longer rows are divided into equal steps no longer than this."""
FRESH_STEP_S = 15.0
FRESH_S = 120.0
"""For this long after a change of the operating point the steps are shorter: the heat moves
fastest there. It depends on the profile alone, so results stay smooth in the parameters."""
FRESH_SPEED_FRACTION = 0.02
FRESH_LOAD_FRACTION = 0.05
"""Smaller changes are measurement noise and need no shorter steps."""


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
