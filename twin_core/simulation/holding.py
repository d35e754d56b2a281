"""Many operating points held for many candidates: steady temperatures, times to limits."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation.assembly import (
    bind_network,
    boundary_values,
    conductance_matrix,
    count_losses,
    decompose,
    film_edges,
    loss_heats_w,
    step_functions,
)
from twin_core.simulation.compiling import compiled
from twin_core.simulation.kernels import FRESH_STEP_S
from twin_core.simulation.laws import (
    LINEAR,
    TEMPERATURE_LIMIT_C,
    film_excess_w,
    friction_at_point,
    friction_heat_w,
)
from twin_core.simulation.linear import solve_in_place
from twin_core.simulation.stability import loop_gain


class HeldPoint(NamedTuple):
    """A network with its parameters, at one operating point."""

    #: The law, its coefficients, and what `friction_at_point` gives.
    friction_kind: int
    friction: NDArray[np.float64]
    point: NDArray[np.float64]
    bounded: bool  # whether temperatures above TEMPERATURE_LIMIT_C have run away
    #: The node whose temperature sets the friction, and the nodes' shares (nodes,) of its heat.
    lubricant: int
    share: NDArray[np.float64]
    #: See `twin_core.simulation.assembly.film_edges`.
    film_node: NDArray[np.int64]
    film_law: NDArray[np.float64]


class Grid(NamedTuple):
    """Operating points (points,), and for how long each is held."""

    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: float
    horizon_s: float


class Crossable(NamedTuple):
    """Sensors and their limits."""

    rows: NDArray[np.float64]  # (sensors, nodes) the sensors' weights
    limit_c: NDArray[np.float64]  # (B, sensors, limits) what temperatures are compared with
    #: (B, points, sensors, limits) what is added to them before: it builds up from zero as a
    #: first-order process of the time constant `slow_s` spreads.
    deviation_k: NDArray[np.float64]
    slow_s: float


class HeldResult(NamedTuple):
    """What becomes of held points."""

    #: (B, points, sensors) steady temperatures. NaN: there is none within TEMPERATURE_LIMIT_C; what
    #: had been crossed by then stays.
    steady_c: NDArray[np.float64]
    #: (B, points, sensors, limits) times in s at which they first reach the limits, infinite if not
    #: within the horizon.
    crossing_s: NDArray[np.float64]
    gain: NDArray[np.float64]  # (B, points) the steady states' loop gains; infinite without one
    #: (B, points, sensors) how much hotter the sensors may become until the gain is 1, see
    #: `twin_core.simulation.stability.loop_gain`; 0 without a steady state.
    room_k: NDArray[np.float64]


HOLD_GROWTH = 0.1
HOLD_LONGEST_STEP_S = 960.0
"""Steps of FRESH_STEP_S double whenever the doubled step is at most this share of the time since
the start, up to the longest one."""
STEADY_BALANCE_W = 1e-6
STEADY_ITERATIONS = 20


@compiled
def hold_points_range(net, values, starts, grid, limits, start, stop, held):  # type: ignore[no-untyped-def]
    """Hold each of many operating points, for candidates start..stop-1 of a batch.

    `starts` are `twin_core.simulation.kernels.Starts`; `grid`, `limits` and `held`, which is
    filled, are `Grid`, `Crossable` and `HeldResult`.

    Steps grow with the time since the start: nothing but slow modes is left then.
    """
    initial, revolutions, disturbance, fading = starts
    speed, load, ambient, horizon = grid
    rows, limit, deviation, slow = limits
    steady, crossing, gain, room = held
    sensors = rows.shape[0]
    levels = limit.shape[2]
    now = np.empty(sensors)
    _, copper = count_losses(net.edge_kind)
    bounded = copper or net.friction_kind != LINEAR
    for member in range(start, stop):
        capacity, coefficient, friction, share = bind_network(net, values[member])
        film_node, film_law = film_edges(net, coefficient)
        for cell in range(speed.size):
            n, f = speed[cell], load[cell]
            point = friction_at_point(net.friction_kind, friction, n, f)
            at = HeldPoint(
                net.friction_kind,
                friction,
                point,
                bounded,
                net.temperature_node,
                share,
                film_node,
                film_law,
            )
            temperature = initial[member].copy()
            turned = revolutions[member]
            for s in range(sensors):
                now[s] = dot(rows[s], temperature)
                for k in range(levels):
                    over = now[s] >= limit[member, s, k]
                    crossing[member, cell, s, k] = 0.0 if over else math.inf
            rate, modes, inverse, outside = decompose(net, capacity, coefficient, n, f)
            level = boundary_values(net, ambient, net.inputs)
            # Copper that heats itself faster than it cools has no steady state.
            stable = True
            for k in range(rate.size):
                stable = stable and (not copper or rate[k] > 0.0)
            alive = hold_point(
                at,
                (rate, modes, inverse),
                (times(level, outside), ambient, disturbance[member], fading),
                (n, turned, horizon),
                (rows, limit[member], deviation[member, cell], slow),
                temperature,
                crossing[member, cell],
            )
            turned += n * horizon / 60.0
            alive = alive and stable
            if alive:
                matrix, outer = conductance_matrix(net, coefficient, n, f, net.inputs)
                cold = np.zeros(temperature.size)
                warm = np.ones(temperature.size)
                to_outside = np.zeros(temperature.size)
                from_outside = loss_heats_w(net, coefficient, cold, n)
                # What the losses gain with temperature, W/K.
                rising = loss_heats_w(net, coefficient, warm, n)
                for i in range(cold.size):
                    rising[i] -= from_outside[i]
                for b in range(1 + net.boundary_input.size):
                    for i in range(cold.size):
                        to_outside[i] += outer[b, i]
                        from_outside[i] += outer[b, i] * (level[b] - ambient)
                alive = polish_steady_state(
                    at,
                    matrix,
                    to_outside,
                    from_outside,
                    rising,
                    ambient,
                    turned,
                    temperature,
                )
            gain[member, cell] = math.inf
            room[member, cell] = 0.0
            if alive:
                gain[member, cell] = loop_gain(
                    at, matrix, ambient, turned, rows, temperature, room[member, cell]
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
def hold_point(held, basis, acting, run, looked_at, temperature, crossing):  # type: ignore[no-untyped-def]
    """Advance `temperature` over the horizon at one point and note when limits are crossed.

    As `simulate_range`, but only the temperatures that matter on the way are computed. `held` is a
    `HeldPoint`, `basis` (rate, modes, inverse) what `decompose` gives, `acting` what acts from
    outside (modal input, ambient, disturbance and the rate at which it fades), `run` speed,
    revolutions and horizon, `looked_at` what a `Crossable` has of this member and point.
    """
    kind, friction, point, bounded, lubricant, share, film_node, film_law = held
    rate, modes, inverse = basis
    ambient_input, ambient, disturbance, fading = acting
    speed, revolutions, horizon = run
    rows, limit, deviation, slow = looked_at
    count = rate.size
    sensors, limits = limit.shape
    films = film_node.size
    y = np.empty(count)
    for k in range(count):
        y[k] = dot(inverse[k], temperature)
    heat_input = times(share, modes)
    disturbed = times(disturbance, modes)
    # What is looked at on the way: the lubricant, the nodes with a film, the sensors.
    watched = 1 + films + sensors
    view = np.empty((count, watched))
    for k in range(count):
        view[k, 0] = modes[lubricant, k]
        for j in range(films):
            view[k, 1 + j] = modes[film_node[j], k]
        for s in range(sensors):
            view[k, 1 + films + s] = 0.0
            for i in range(count):
                view[k, 1 + films + s] += rows[s, i] * modes[i, k]
    now = np.empty(watched)
    later = np.empty(watched)
    predicted = np.empty(count)
    b = np.empty(count)
    decay = np.empty(count)
    first = np.empty(count)
    second = np.empty(count)
    slope = np.empty(films)
    watch(view, y, now)
    top = TEMPERATURE_LIMIT_C if bounded else math.inf
    time, turned, grown, last_step = 0.0, revolutions, FRESH_STEP_S, math.nan
    built_before = 0.0
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
        built = math.sqrt(-math.expm1(-2.0 * (time + step) / slow))
        for s in range(sensors):
            old, new = now[1 + films + s], later[1 + films + s]
            for k in range(limits):
                high = new + built * deviation[s, k]
                if high >= limit[s, k] and crossing[s, k] == math.inf:
                    low = old + built_before * deviation[s, k]
                    part = min(max((limit[s, k] - low) / (high - low), 0.0), 1.0)
                    crossing[s, k] = time + step * part
        built_before = built
        for r in range(watched):
            now[r] = later[r]
        time += step
        if not abs(now[0]) < top:
            return False
    for i in range(count):
        temperature[i] = dot(modes[i], y)
    return True


@compiled
def times(vector, matrix):  # type: ignore[no-untyped-def]
    """Product of a vector (n,) and a matrix (n, m)."""
    result = np.zeros(matrix.shape[1])
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            result[j] += vector[i] * matrix[i, j]
    return result


@compiled
def watch(view, y, out):  # type: ignore[no-untyped-def]
    """Fill out with y @ view, the loop arranged so that it runs on vector units."""
    out[:] = 0.0
    for k in range(y.size):
        for r in range(out.size):
            out[r] += view[k, r] * y[k]


@compiled
def polish_steady_state(  # type: ignore[no-untyped-def]
    held,
    matrix,
    to_outside,
    from_outside,
    gain,
    ambient,
    revolutions,
    temperature,
):
    """Newton from temperatures near the steady state; tells whether they closed the balance."""
    kind, friction, point, bounded, lubricant, share, film_node, film_law = held
    count = temperature.size
    top = TEMPERATURE_LIMIT_C if bounded else math.inf
    flow = np.empty(count)
    for _ in range(STEADY_ITERATIONS):
        heat = friction_heat_w(kind, friction, point, temperature[lubricant], revolutions)
        warmer = friction_heat_w(kind, friction, point, temperature[lubricant] + 1e-4, revolutions)
        jacobian = matrix.copy()
        for i in range(count):
            flow[i] = share[i] * heat - to_outside[i] * (temperature[i] - ambient)
            flow[i] += from_outside[i] + gain[i] * temperature[i]
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
        solve_in_place(jacobian, flow.reshape((count, 1)))
        for i in range(count):
            temperature[i] += flow[i]
            if not abs(temperature[i]) < top:
                return False
    return False
