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
from functools import partial

import numpy as np

from twin_core.simulation.assembly import (
    bind_network,
    count_losses,
    film_edges,
    modal_basis,
    step_functions,
)
from twin_core.simulation.basis_tangents import (
    add_products,
    add_scaled,
    basis_tangents,
    set_scaled,
    share_tangents,
    slope_functions,
    spread,
    watch,
)
from twin_core.simulation.compiling import compiled
from twin_core.simulation.kernels import (
    FRESH_S,
    drives_differ,
    is_fresh,
    padded,
    set_outside,
    step_count,
)
from twin_core.simulation.laws import (
    FILM,
    LINEAR,
    TEMPERATURE_LIMIT_C,
    film_excess_w,
    film_gradient,
    friction_at_point,
    friction_gradient,
    friction_heat_w,
)
from twin_core.simulation.vectors import LANES, STRIDE, combine, combine_wide


@compiled
def tangent_kernel(  # type: ignore[no-untyped-def]
    net, values, profile, initial, seeds, revolutions, rows, out, derivative
):
    """Simulate one candidate as `simulate_range` does, with its derivatives.

    `profile` holds time, speed, load, ambient (n,) and inputs (n, k). Directions are the p
    parameters, then the columns of seeds (nodes, e): changes of the initial temperatures. Fills out
    (n, r) with rows (r, nodes) @ temperatures, derivative (n, r, p + e). Returns the row from which
    on the result is unusable, or -1.
    """
    time, speed, load, ambient, given = profile
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
    for j in range(films):
        node[1 + j] = film_node[j]
    losses, copper = count_losses(net.edge_kind)
    outer = 1 + net.boundary_input.size + (1 if losses else 0)
    inputs = active + outer
    kind = net.friction_kind
    limit = math.inf if kind == LINEAR and not copper else TEMPERATURE_LIMIT_C
    outputs = rows.shape[0]
    rate = np.empty(count)
    modes = np.empty((count, width))
    inverse = np.empty((count, width))
    shares, outside = np.zeros(width), np.zeros((outer, width))
    for i in range(count):
        shares[i] = share[i]
    share_tangent = np.zeros((width, span))
    share_tangents(net, values, share_tangent)
    turning = np.zeros((count, width, span))
    mode_tangent = np.zeros((count, width, span))
    outer_tangent = np.zeros((outer, width, span))
    weights = np.zeros((outputs, width))
    for r in range(outputs):
        for i in range(count):
            weights[r, i] = rows[r, i]
    pair = np.empty((0, 2), np.int64)
    coupled = np.empty((0, span))
    source = np.zeros((padded(inputs, STRIDE), width))
    functions = np.zeros((3, width))
    slopes = np.zeros((3, width))
    decay, reach, late_reach = functions[0], functions[1], functions[2]
    decay_slope, reach_slope, late_slope = slopes[0], slopes[1], slopes[2]
    source_tangent = np.zeros((count, inputs, span))
    # Per coordinate: its own tangent, that of its rate, those of what the inputs do to it in a
    # step; once for the inputs, once for their changes.
    local = np.zeros((2, count, padded(2 + inputs, STRIDE), span))
    ahead_local, late_local = local[0], local[1]
    ahead_weight, late_weight = np.zeros(local.shape[2]), np.zeros(local.shape[2])
    ones, moved = np.ones(width), np.zeros(width)
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
    ahead_gain, late_gain = gain[0], gain[1]
    now = np.empty(active)
    later = np.empty(active)
    now_tangent = np.zeros((active, span))
    later_tangent = np.zeros((active, span))
    driven = np.zeros(width)
    temperature = initial.copy()
    temperature_tangent = np.zeros((count, span))
    for i in range(count):
        for d in range(seeds.shape[1]):
            temperature_tangent[i, parameters + d] = seeds[i, d]
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
        for i in range(count):
            out[0, r] += rows[r, i] * initial[i]
        for d in range(directions):
            derivative[0, r, d] = 0.0
            for i in range(count):
                derivative[0, r, d] += rows[r, i] * temperature_tangent[i, d]
    for row in range(time.size - 1):
        n = abs(speed[row])
        f = max(load[row], 0.0)
        driven_anew = losses > 0 and row > 0 and drives_differ(net.edge_input, given, row)
        if n != point_speed or f != point_load or driven_anew:
            if driven_anew or is_fresh(n, f, point_speed, point_load):
                fresh_until = time[row] + FRESH_S
            if row > 0:
                for i in range(count):
                    temperature[i] = 0.0
                    set_scaled(temperature_tangent[i], 0.0, one)
                    for k in range(count):
                        temperature[i] += modes[k, i] * y[k]
                        add_scaled(temperature_tangent[i], modes[k, i], tangent[k])
                        add_scaled(temperature_tangent[i], y[k], mode_tangent[k, i])
            acting = modal_basis(net, capacity, coefficient, n, f, given[row], rate, modes, inverse)
            if not math.isfinite(rate[0]):
                return row + 1
            pair, coupled = basis_tangents(
                net,
                capacity,
                coefficient,
                rate,
                modes,
                (n, f),
                given[row],
                turning,
                mode_tangent,
                outer_tangent,
            )
            point = friction_at_point(kind, friction, n, f)
            point_speed, point_load, point_step = n, f, math.nan
            for b in range(outer):
                for i in range(count):
                    outside[b, i] = acting[b, i]
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
                add_products(source_tangent[k, 0], shares, mode_tangent[k], modes[k], share_tangent)
                for b in range(outer):
                    add_products(
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
        set_outside(net.boundary_input, ambient, given, row, heat, active, inputs)
        early = min(max(fresh_until - time[row], 0.0), duration)
        for part in range(2):
            stretch = early if part == 0 else duration - early
            steps = step_count(stretch, part)
            if steps <= 0:
                continue
            step = stretch / steps
            if step != point_step:
                point_step = step
                step_functions(rate, step, decay, reach, late_reach)
                slope_functions(rate, step, slopes)
                for k in range(count):
                    for q in range(inputs):
                        set_scaled(local[0, k, 2 + q], reach[k], source_tangent[k, q])
                    for q in range(active):
                        set_scaled(local[1, k, 2 + q], late_reach[k], source_tangent[k, q])
                        gain[0, k, q] = reach[k] * source[q, k]
                        gain[1, k, q] = late_reach[k] * source[q, k]
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
                    ahead_weight[2 + q] = heat[q]
                for k in range(count):
                    ahead[k] = decay[k] * y[k] + reach[k] * driven[k]
                    moved[k] = decay_slope[k] * y[k] + reach_slope[k] * driven[k]
                advance_tangents(
                    decay,
                    moved,
                    ahead_weight,
                    ahead_local,
                    ahead_gain,
                    heat_tangent,
                    pair,
                    coupled,
                    tangent,
                    ahead_tangent,
                )
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
                    y[k] = ahead[k] + late_reach[k] * driven[k]
                    moved[k] = late_slope[k] * driven[k]
                advance_tangents(
                    ones,
                    moved,
                    late_weight,
                    late_local,
                    late_gain,
                    change_tangent,
                    pair,
                    coupled,
                    ahead_tangent,
                    tangent,
                )
                watch(view, view_tangent, y, tangent, now, now_tangent)
        for j in range(active):
            if not abs(now[j]) < limit:
                return row + 1
        for r in range(outputs):
            out[row + 1, r] = 0.0
            for k in range(count):
                out[row + 1, r] += look[r, k] * y[k]
            combine_wide(one, look[r], tangent, y, look_tangent[r])
            for d in range(directions):
                derivative[row + 1, r, d] = one[d]
    return -1


@partial(compiled, inlined=True)
def advance_tangents(  # type: ignore[no-untyped-def]
    decay, moved, weight, local, gain, input_tangent, pair, coupled, tangent, out
):
    """Set out (n, span) to the derivatives of decay y + what inputs, or their changes, do.

    `moved` (n,) are the derivatives of that by the rates; `weight` (inputs + 2,) has the inputs
    from its third place on, `local` what they are multiplied with.
    """
    for k in range(local.shape[0]):
        set_scaled(local[k, 0], 1.0, tangent[k])
        weight[0] = decay[k]
        weight[1] = moved[k]
        combine_wide(out[k], weight, local[k], gain[k], input_tangent)
    for m in range(pair.shape[0]):
        add_scaled(out[pair[m, 0]], moved[pair[m, 1]], coupled[m])
