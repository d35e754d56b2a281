"""Derivatives of a simulation by all parameters at once: the discrete scheme, differentiated.

Between two changes of the operating point a step is diagonal in the coordinates of
:mod:`twin_core.simulation.assembly`. Its derivative stays diagonal if rates and modes move along
with the parameters: with E_kl = v_k' dS v_l of the symmetric S,

    d lam_k = E_kk,      d v_k = sum over l of v_l E_lk / (lam_k - lam_l).

Pairs of (nearly) equal rates keep their modes, and E_kl couples them in every step instead; the
derivative of the matrix exponential between equal rates is that of the scalar one. What is
followed for all parameters together is thus as long as the state itself.
"""

import math

import numpy as np

from twin_core.simulation.assembly import (
    bind_network,
    count_losses,
    driving_value,
    film_edges,
    modal_basis,
    step_functions,
)
from twin_core.simulation.compiling import compiled
from twin_core.simulation.kernels import (
    FRESH_LOAD_FRACTION,
    FRESH_S,
    FRESH_SPEED_FRACTION,
    FRESH_STEP_S,
    MAX_STEP_S,
    drives_differ,
    padded,
)
from twin_core.simulation.laws import (
    COPPER,
    FILM,
    LINEAR,
    TEMPERATURE_LIMIT_C,
    edge_gradient,
    film_excess_w,
    film_gradient,
    friction_at_point,
    friction_gradient,
    friction_heat_w,
    loss_gradient,
)
from twin_core.simulation.vectors import LANES, STRIDE, combine, combine_wide

_NEARLY_EQUAL = 1e-5


@compiled
def set_scaled(out, scale, vector):  # type: ignore[no-untyped-def]
    """Set out to scale * vector, without a temporary."""
    for d in range(out.size):
        out[d] = scale * vector[d]


@compiled
def add_scaled(out, scale, vector):  # type: ignore[no-untyped-def]
    """Add scale * vector to out, without a temporary."""
    for d in range(out.size):
        out[d] += scale * vector[d]


@compiled
def spread(gradient, factor, parameter, out):  # type: ignore[no-untyped-def]
    """Add derivatives by coefficients to those by the parameters that the coefficients follow."""
    for c in range(factor.size):
        if parameter[c] >= 0:
            out[parameter[c]] += gradient[c] * factor[c]


@compiled
def share_tangents(net, values, out):  # type: ignore[no-untyped-def]
    """Fill out (nodes, directions) with the derivatives of the nodes' shares of the heat."""
    out[:] = 0.0
    rest = 1.0
    rest_tangent = np.zeros(out.shape[1])
    last = net.share_node.size - 1
    for s in range(last):
        parameter = net.share_parameter[s]
        fraction = net.share_fraction[s]
        if parameter >= 0:
            fraction *= values[parameter]
        node = net.share_node[s]
        add_scaled(out[node], fraction, rest_tangent)
        set_scaled(rest_tangent, 1.0 - fraction, rest_tangent)
        if parameter >= 0:
            out[node, parameter] += rest * net.share_fraction[s]
            rest_tangent[parameter] -= rest * net.share_fraction[s]
        rest *= 1.0 - fraction
    add_scaled(out[net.share_node[last]], 1.0, rest_tangent)


@compiled
def slope_functions(rate, step, out):  # type: ignore[no-untyped-def]
    """Fill out (3, n) with the derivatives of `step_functions` by the rates."""
    for k in range(rate.size):
        x = rate[k] * step
        decay = math.exp(-x)
        if abs(x) < 0.1:
            slope = -0.5 + x * (1 / 3 - x * (1 / 8 - x * (1 / 30 - x * (1 / 144 - x / 840))))
            bend = -1 / 6 + x * (1 / 12 - x * (1 / 40 - x * (1 / 180 - x * (1 / 1008 - x / 6720))))
        else:
            phi = (1.0 - decay) / x
            slope = (decay - phi) / x
            bend = -(slope + (1.0 - phi) / x) / x
        out[0, k] = -step * decay
        out[1, k] = step * step * slope
        out[2, k] = step * step * bend


@compiled
def basis_tangents(  # type: ignore[no-untyped-def]
    net,
    capacity,
    coefficient,
    rate,
    modes,
    speed,
    load,
    given,
    turning,
    mode_tangent,
    outer_tangent,
):
    """Derivatives of an operating point's modes.

    Fills turning (n, n', directions), first with E, whose diagonal is what the rates do, then off
    it with the coefficients of the modes' derivatives; mode_tangent (n, nodes, directions) and
    outer_tangent (rows, nodes, directions), that of what acts from outside. Gives the pairs of
    nearly equal rates and their E (pairs, directions).
    """
    count, width = modes.shape
    turning[:] = 0.0
    outer_tangent[:] = 0.0
    boundaries = 1 + net.boundary_input.size
    gradient = np.empty(coefficient.shape[1])
    shape = np.empty(count)
    for e in range(net.edge_kind.size):
        bound = False
        for c in range(gradient.size):
            bound = bound or net.edge_parameter[e, c] >= 0
        if not bound:
            continue
        a, b = net.edge_nodes[e, 0], net.edge_nodes[e, 1]
        driving = driving_value(net, e, given)
        if net.edge_kind[e] >= COPPER:
            loss_gradient(net.edge_kind[e], coefficient[e], speed, driving, gradient)
            for c in range(gradient.size):
                parameter = net.edge_parameter[e, c]
                if parameter >= 0:
                    moved = gradient[c] * net.edge_coefficient[e, c]
                    outer_tangent[boundaries, a, parameter] += moved
        edge_gradient(net.edge_kind[e], coefficient[e], speed, load, driving, gradient)
        for k in range(count):
            shape[k] = modes[k, a] - (modes[k, b] if b < count else 0.0)
        for c in range(gradient.size):
            parameter = net.edge_parameter[e, c]
            moved = gradient[c] * net.edge_coefficient[e, c]
            if parameter < 0 or moved == 0.0:
                continue
            if b >= count and net.edge_kind[e] < COPPER:
                outer_tangent[b - count, a, parameter] += moved
            for k in range(count):
                for m in range(k, count):
                    turning[k, m, parameter] += moved * shape[k] * shape[m]
    for i in range(count):
        parameter = net.capacity_parameter[i]
        if parameter >= 0:
            for k in range(count):
                for m in range(k, count):
                    share = modes[k, i] * net.capacity[i] * modes[m, i]
                    turning[k, m, parameter] -= 0.5 * (rate[k] + rate[m]) * share
    for k in range(count):
        for m in range(k):
            set_scaled(turning[k, m], 1.0, turning[m, k])
    pairs = 0
    pair = np.empty((count * count, 2), np.int64)
    for k in range(count):
        for m in range(count):
            near = abs(rate[k] - rate[m]) <= _NEARLY_EQUAL * max(rate[k], rate[m])
            if k != m and near:
                pair[pairs] = k, m
                pairs += 1
    coupled = np.empty((pairs, turning.shape[2]))
    for n in range(pairs):
        both = turning[pair[n, 0], pair[n, 1]]
        set_scaled(coupled[n], 1.0, both)
        set_scaled(both, 0.0, both)
    for k in range(count):
        for m in range(count):
            if k != m and rate[k] != rate[m]:
                set_scaled(turning[k, m], 1.0 / (rate[k] - rate[m]), turning[k, m])
    across = np.zeros((count, width))
    for i in range(count):
        for k in range(count):
            across[i, k] = modes[k, i]
    diagonal = np.empty(turning.shape[2])
    for k in range(count):
        # The mode itself does not turn; its place on the diagonal holds the rate's derivative.
        set_scaled(diagonal, 1.0, turning[k, k])
        set_scaled(turning[k, k], 0.0, diagonal)
        for i in range(count):
            combine(mode_tangent[k, i], across[i], turning[k])
            parameter = net.capacity_parameter[i]
            if parameter >= 0:
                relative = net.capacity[i] / capacity[i]
                mode_tangent[k, i, parameter] -= 0.5 * relative * modes[k, i]
        set_scaled(turning[k, k], 1.0, diagonal)
    return pair[:pairs], coupled


@compiled
def tangent_kernel(  # type: ignore[no-untyped-def]
    net,
    values,
    time,
    speed,
    load,
    ambient,
    given,
    initial,
    seeds,
    revolutions,
    rows,
    out,
    derivative,
):
    """Simulate one candidate as `simulate_kernel` does, with its derivatives.

    Directions are the p parameters, then the columns of seeds (nodes, e): changes of the initial
    temperatures. Fills out (n, r) with rows (r, nodes) @ temperatures, derivative (n, r, p + e).
    Returns the row from which on the result is unusable, or -1.
    """
    count = net.capacity.size
    width = padded(count, LANES)
    parameters = values.size
    directions = parameters + seeds.shape[1]
    span = padded(directions, 2 * LANES)
    capacity, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    films = film_node.size
    film_edge = np.empty(films, np.int64)
    j = 0
    for e in range(net.edge_kind.size):
        if net.edge_kind[e] == FILM:
            film_edge[j] = e
            j += 1
    active = 1 + films
    node = np.empty(active, np.int64)
    node[0] = net.temperature_node
    node[1:] = film_node
    losses, copper = count_losses(net)
    outer = 1 + net.boundary_input.size + (1 if losses else 0)
    inputs = active + outer
    kind = net.friction_kind
    limit = math.inf if kind == LINEAR and not copper else TEMPERATURE_LIMIT_C
    outputs = rows.shape[0]
    rate = np.empty(count)
    modes = np.empty((count, width))
    inverse = np.empty((count, width))
    shares, outside = np.zeros(width), np.zeros((outer, width))
    shares[:count] = share
    share_tangent = np.zeros((width, span))
    share_tangents(net, values, share_tangent)
    turning = np.zeros((count, width, span))
    mode_tangent = np.zeros((count, width, span))
    outer_tangent = np.zeros((outer, width, span))
    weights = np.zeros((outputs, width))
    weights[:, :count] = rows
    pair = np.empty((0, 2), np.int64)
    coupled = np.empty((0, span))
    source = np.zeros((padded(inputs, STRIDE), width))
    functions = np.zeros((3, width))
    slopes = np.zeros((3, width))
    source_tangent = np.zeros((count, inputs, span))
    # Per coordinate: its own tangent, that of its rate, those of what the inputs do to it in a
    # step; once for the inputs, once for their changes.
    local = np.zeros((2, count, padded(2 + inputs, STRIDE), span))
    local_weight = np.zeros(local.shape[2])
    late_weight = np.zeros(local.shape[2])
    late_weight[0] = 1.0
    view = np.zeros((active, width))
    view_tangent = np.zeros((active, width, span))
    look = np.zeros((outputs, width))
    look_tangent = np.zeros((outputs, width, span))
    y = np.zeros(width)
    ahead = np.zeros(width)
    tangent = np.zeros((width, span))
    ahead_tangent = np.zeros((width, span))
    heat = np.zeros(source.shape[0])
    heat_tangent = np.zeros((padded(active, STRIDE), span))
    change = np.zeros(source.shape[0])
    change_tangent = np.zeros((padded(active, STRIDE), span))
    gain = np.zeros((2, count, heat_tangent.shape[0]))
    now = np.empty(active)
    later = np.empty(active)
    now_tangent = np.zeros((active, span))
    later_tangent = np.zeros((active, span))
    driven = np.zeros(width)
    temperature = initial.copy()
    temperature_tangent = np.zeros((count, span))
    temperature_tangent[:, parameters:directions] = seeds
    gradient = np.empty(friction.size)
    film_slope = np.empty((films, 2, 3))
    film_value = np.empty(films)
    one = np.zeros(span)
    point = np.empty(5)
    point_speed, point_load, point_step = math.nan, math.nan, math.nan
    fresh_until = -math.inf
    turned = revolutions
    for r in range(outputs):
        out[0, r] = 0.0
        derivative[0, r] = 0.0
        for i in range(count):
            out[0, r] += rows[r, i] * initial[i]
            derivative[0, r, parameters:] += rows[r, i] * seeds[i]
    for row in range(time.size - 1):
        n = abs(speed[row])
        f = max(load[row], 0.0)
        driven_anew = losses > 0 and row > 0 and drives_differ(net, given, row)
        if n != point_speed or f != point_load or driven_anew:
            if driven_anew or not (
                abs(n - point_speed) <= FRESH_SPEED_FRACTION * n
                and abs(f - point_load) <= FRESH_LOAD_FRACTION * f
            ):
                fresh_until = time[row] + FRESH_S
            if row > 0:
                for i in range(count):
                    temperature[i] = 0.0
                    set_scaled(temperature_tangent[i], 0.0, one)
                    for k in range(count):
                        temperature[i] += modes[k, i] * y[k]
                        add_scaled(temperature_tangent[i], modes[k, i], tangent[k])
                        add_scaled(temperature_tangent[i], y[k], mode_tangent[k, i])
            outside[:, :count] = modal_basis(
                net, capacity, coefficient, n, f, given[row], rate, modes, inverse
            )
            if not math.isfinite(rate[0]):
                out[row + 1 :] = math.nan
                derivative[row + 1 :] = math.nan
                return row + 1
            pair, coupled = basis_tangents(
                net,
                capacity,
                coefficient,
                rate,
                modes,
                n,
                f,
                given[row],
                turning,
                mode_tangent,
                outer_tangent,
            )
            point = friction_at_point(kind, friction, n, f)
            point_speed, point_load, point_step = n, f, math.nan
            for k in range(count):
                y[k] = 0.0
                for q in range(inputs):
                    source[q, k] = 0.0
                set_scaled(local[0, k, 1], 1.0, turning[k, k])
                set_scaled(local[1, k, 1], 1.0, turning[k, k])
                for i in range(count):
                    y[k] += inverse[k, i] * temperature[i]
                    source[0, k] += modes[k, i] * share[i]
                    for b in range(outer):
                        source[active + b, k] += modes[k, i] * outside[b, i]
                combine_wide(source_tangent[k, 0], shares, mode_tangent[k], modes[k], share_tangent)
                for b in range(outer):
                    combine_wide(
                        source_tangent[k, active + b],
                        outside[b],
                        mode_tangent[k],
                        modes[k],
                        outer_tangent[b],
                    )
                for j in range(active):
                    view[j, k] = modes[k, node[j]]
                    set_scaled(view_tangent[j, k], 1.0, mode_tangent[k, node[j]])
                for j in range(1, active):
                    source[j, k] = -view[j, k]
                    set_scaled(source_tangent[k, j], -1.0, view_tangent[j, k])
                for r in range(outputs):
                    look[r, k] = 0.0
                    for i in range(count):
                        look[r, k] += rows[r, i] * modes[k, i]
                    combine(look_tangent[r, k], weights[r], mode_tangent[k])
            for i in range(count):
                for k in range(count):
                    add_scaled(temperature_tangent[i], -y[k], mode_tangent[k, i])
            for k in range(count):
                set_scaled(tangent[k], 0.0, one)
                for i in range(count):
                    add_scaled(tangent[k], inverse[k, i], temperature_tangent[i])
            watch(view, view_tangent, y, tangent, now, now_tangent)
        duration = time[row + 1] - time[row]
        heat[active] = ambient[row]
        for b in range(net.boundary_input.size):
            heat[active + 1 + b] = given[row, net.boundary_input[b]]
        if losses:
            heat[active + outer - 1] = 1.0
        early = min(max(fresh_until - time[row], 0.0), duration)
        for part in range(2):
            stretch = early if part == 0 else duration - early
            steps = math.ceil(stretch / (FRESH_STEP_S if part == 0 else MAX_STEP_S) - 1e-9)
            if steps <= 0:
                continue
            step = stretch / steps
            if step != point_step:
                point_step = step
                step_functions(rate, step, functions[0], functions[1], functions[2])
                slope_functions(rate, step, slopes)
                for k in range(count):
                    for q in range(inputs):
                        set_scaled(local[0, k, 2 + q], functions[1, k], source_tangent[k, q])
                    for q in range(active):
                        set_scaled(local[1, k, 2 + q], functions[2, k], source_tangent[k, q])
                        gain[0, k, q] = functions[1, k] * source[q, k]
                        gain[1, k, q] = functions[2, k] * source[q, k]
            for _ in range(steps):
                heat[0] = friction_heat_w(kind, friction, point, now[0], turned)
                by_now = friction_gradient(kind, friction, n, f, now[0], turned, gradient)
                set_scaled(heat_tangent[0], by_now, now_tangent[0])
                spread(gradient, net.friction_coefficient, net.friction_parameter, heat_tangent[0])
                for j in range(films):
                    difference = now[1 + j] - ambient[row]
                    law = film_law[j]
                    heat[1 + j], film_value[j] = film_excess_w(law[0], law[1], difference)
                    film_gradient(law[0], law[1], difference, film_slope[j])
                    set_scaled(heat_tangent[1 + j], film_slope[j, 0, 2], now_tangent[1 + j])
                    spread(
                        film_slope[j, 0],
                        net.edge_coefficient[film_edge[j], :2],
                        net.edge_parameter[film_edge[j], :2],
                        heat_tangent[1 + j],
                    )
                # The predictor.
                combine(driven, heat, source)
                for q in range(inputs):
                    local_weight[2 + q] = heat[q]
                for k in range(count):
                    ahead[k] = functions[0, k] * y[k] + functions[1, k] * driven[k]
                    set_scaled(local[0, k, 0], 1.0, tangent[k])
                    local_weight[0] = functions[0, k]
                    local_weight[1] = slopes[0, k] * y[k] + slopes[1, k] * driven[k]
                    combine_wide(
                        ahead_tangent[k], local_weight, local[0, k], gain[0, k], heat_tangent
                    )
                for m in range(pair.shape[0]):
                    k, other = pair[m, 0], pair[m, 1]
                    moved = slopes[0, other] * y[other] + slopes[1, other] * driven[other]
                    add_scaled(ahead_tangent[k], moved, coupled[m])
                turned += n * step / 60.0
                watch(view, view_tangent, ahead, ahead_tangent, later, later_tangent)
                # What changes within the step.
                change[0] = friction_heat_w(kind, friction, point, later[0], turned) - heat[0]
                by_later = friction_gradient(kind, friction, n, f, later[0], turned, gradient)
                set_scaled(change_tangent[0], by_later, later_tangent[0])
                add_scaled(change_tangent[0], -1.0, heat_tangent[0])
                spread(
                    gradient, net.friction_coefficient, net.friction_parameter, change_tangent[0]
                )
                for j in range(films):
                    apart = later[1 + j] - now[1 + j]
                    change[1 + j] = film_value[j] * apart
                    bend = film_slope[j, 1, 2] * apart - film_value[j]
                    set_scaled(change_tangent[1 + j], film_value[j], later_tangent[1 + j])
                    add_scaled(change_tangent[1 + j], bend, now_tangent[1 + j])
                    set_scaled(film_slope[j, 1], apart, film_slope[j, 1])
                    spread(
                        film_slope[j, 1],
                        net.edge_coefficient[film_edge[j], :2],
                        net.edge_parameter[film_edge[j], :2],
                        change_tangent[1 + j],
                    )
                # The corrector.
                combine(driven, change, source)
                for q in range(active):
                    late_weight[2 + q] = change[q]
                for k in range(count):
                    y[k] = ahead[k] + functions[2, k] * driven[k]
                    set_scaled(local[1, k, 0], 1.0, ahead_tangent[k])
                    late_weight[1] = slopes[2, k] * driven[k]
                    combine_wide(tangent[k], late_weight, local[1, k], gain[1, k], change_tangent)
                for m in range(pair.shape[0]):
                    k, other = pair[m, 0], pair[m, 1]
                    add_scaled(tangent[k], slopes[2, other] * driven[other], coupled[m])
                watch(view, view_tangent, y, tangent, now, now_tangent)
        for j in range(active):
            if not abs(now[j]) < limit:
                out[row + 1 :] = math.nan
                derivative[row + 1 :] = math.nan
                return row + 1
        for r in range(outputs):
            out[row + 1, r] = 0.0
            for k in range(count):
                out[row + 1, r] += look[r, k] * y[k]
            combine_wide(one, look[r], tangent, y, look_tangent[r])
            for d in range(directions):
                derivative[row + 1, r, d] = one[d]
    return -1


@compiled
def watch(view, view_tangent, y, tangent, out, out_tangent):  # type: ignore[no-untyped-def]
    """Active temperatures of the coordinates y, with their derivatives."""
    for j in range(out.size):
        total = 0.0
        for k in range(y.size):
            total += view[j, k] * y[k]
        out[j] = total
        combine_wide(out_tangent[j], view[j], tangent, y, view_tangent[j])
