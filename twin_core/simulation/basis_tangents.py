"""Derivatives of a network's shares, modes and what acts from outside by all parameters at once.

With E_kl = v_k' dS v_l of the symmetric S of :mod:`twin_core.simulation.assembly`,

    d lam_k = E_kk,      d v_k = sum over l of v_l E_lk / (lam_k - lam_l).

Pairs of (nearly) equal rates keep their modes.
"""

import math

import numpy as np

from twin_core.simulation.assembly import driving_value
from twin_core.simulation.compiling import compiled
from twin_core.simulation.laws import COPPER, edge_gradient, loss_gradient
from twin_core.simulation.vectors import combine, combine_wide

_NEARLY_EQUAL = 1e-5


@compiled
def add_products(out, first, first_rows, second, second_rows):  # type: ignore[no-untyped-def]
    """Set out to first @ first_rows + second @ second_rows, compiled once for all callers."""
    combine_wide(out, first, first_rows, second, second_rows)


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
    net, capacity, coefficient, rate, modes, point, given, turning, mode_tangent, outer_tangent
):
    """Derivatives of an operating point's modes; `point` is its speed and load.

    Fills turning (n, n', directions), first with E, whose diagonal is what the rates do, then off
    it with the coefficients of the modes' derivatives; mode_tangent (n, nodes, directions) and
    outer_tangent (rows, nodes, directions), that of what acts from outside. Gives the pairs of
    nearly equal rates and their E (pairs, directions).
    """
    speed, load = point
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
        driving = driving_value(net.edge_input, e, given)
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
def watch(view, view_tangent, y, tangent, out, out_tangent):  # type: ignore[no-untyped-def]
    """Active temperatures of the coordinates y, with their derivatives."""
    for j in range(out.size):
        total = 0.0
        for k in range(y.size):
            total += view[j, k] * y[k]
        out[j] = total
        combine_wide(out_tangent[j], view[j], tangent, y, view_tangent[j])
