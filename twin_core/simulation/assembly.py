"""A network with its parameters applied: matrices, modes, heat balance.

With the symmetric S = C^-1/2 L C^-1/2 = V diag(lam) V', the coordinates y = V' C^1/2 T of
C dT/dt = -L T + g Ta + q decouple.
"""

import math

import numpy as np

from twin_core.simulation.compiling import compiled
from twin_core.simulation.eigen import eigen_decompose
from twin_core.simulation.laws import (
    COPPER,
    FILM,
    edge_conductance,
    film_excess_w,
    friction_at_point,
    friction_heat_w,
    loss_at_zero_w,
)


@compiled
def bound(factor, index, values):  # type: ignore[no-untyped-def]
    """Return a coefficient: its factor times its parameter, if it has one."""
    if index < 0:
        return factor
    return factor * values[index]


@compiled
def bind_network(net, values):  # type: ignore[no-untyped-def]
    """Apply a parameter vector: capacities, edge and friction coefficients, heat per node."""
    count = net.capacity.size
    capacity = np.empty(count)
    for i in range(count):
        capacity[i] = bound(net.capacity[i], net.capacity_parameter[i], values)
    coefficient = np.empty(net.edge_coefficient.shape)
    for e in range(coefficient.shape[0]):
        for j in range(coefficient.shape[1]):
            coefficient[e, j] = bound(net.edge_coefficient[e, j], net.edge_parameter[e, j], values)
    friction = np.empty(net.friction_coefficient.size)
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
def count_losses(edge_kind):  # type: ignore[no-untyped-def]
    """Tell how many edges are losses, and whether one of them changes with temperature."""
    losses, copper = 0, False
    for e in range(edge_kind.size):
        losses += edge_kind[e] >= COPPER
        copper = copper or edge_kind[e] == COPPER
    return losses, copper


@compiled
def driving_value(edge_input, edge, given):  # type: ignore[no-untyped-def]
    """Value of the input that drives a loss, of the inputs given (k,); 0 where none does."""
    place = edge_input[edge]
    return given[place] if place >= 0 else 0.0


@compiled
def boundary_values(net, ambient, given):  # type: ignore[no-untyped-def]
    """What the rows of `conductance_matrix`'s second result are multiplied with, (rows,)."""
    losses, _ = count_losses(net.edge_kind)
    boundaries = 1 + net.boundary_input.size
    result = np.ones(boundaries + (1 if losses else 0))
    result[0] = ambient
    for b in range(1, boundaries):
        result[b] = given[net.boundary_input[b - 1]]
    return result


@compiled
def edge_conductances(net, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """Conductance of every edge in W/K (edges,), the inputs at the values held."""
    result = np.empty(net.edge_kind.size)
    for e in range(result.size):
        driving = driving_value(net.edge_input, e, net.inputs)
        result[e] = edge_conductance(net.edge_kind[e], coefficient[e], speed, load, driving)
    return result


@compiled
def conductance_matrix(net, coefficient, speed, load, given):  # type: ignore[no-untyped-def]
    """L (nodes, nodes) in W/K, and what acts on the nodes from outside.

    The second (rows, nodes) has the conductances to the ambient and to every other boundary, in
    W/K, and where there are losses a last row with their heat at 0 degC in W.
    """
    count = net.capacity.size
    matrix = np.zeros((count, count))
    losses, _ = count_losses(net.edge_kind)
    boundaries = 1 + net.boundary_input.size
    outside = np.zeros((boundaries + (1 if losses else 0), count))
    for e in range(net.edge_kind.size):
        kind = net.edge_kind[e]
        driving = driving_value(net.edge_input, e, given)
        conductance = edge_conductance(kind, coefficient[e], speed, load, driving)
        a, b = net.edge_nodes[e, 0], net.edge_nodes[e, 1]
        matrix[a, a] += conductance
        if kind >= COPPER:
            outside[boundaries, a] += loss_at_zero_w(kind, coefficient[e], speed, driving)
        elif b >= count:
            outside[b - count, a] += conductance
        else:
            matrix[b, b] += conductance
            matrix[a, b] -= conductance
            matrix[b, a] -= conductance
    return matrix, outside


@compiled
def loss_heats_w(net, coefficient, temperature, speed):  # type: ignore[no-untyped-def]
    """Heat of the losses at every node in W (nodes,), the inputs at the values held."""
    heat = np.zeros(temperature.size)
    for e in range(net.edge_kind.size):
        kind = net.edge_kind[e]
        if kind >= COPPER:
            node, driving = net.edge_nodes[e, 0], driving_value(net.edge_input, e, net.inputs)
            slope = -edge_conductance(kind, coefficient[e], speed, 0.0, driving)
            heat[node] += loss_at_zero_w(kind, coefficient[e], speed, driving)
            heat[node] += slope * temperature[node]
    return heat


@compiled
def slower(matrix, capacity, first, second):  # type: ignore[no-untyped-def]
    """Whether a node alone would follow its surroundings more slowly than another."""
    return matrix[first, first] / capacity[first] < matrix[second, second] / capacity[second]


@compiled
def modal_basis(  # type: ignore[no-untyped-def]
    net, capacity, coefficient, speed, load, given, rate, modes, inverse
):
    """Decouple an operating point: T = sum of y_k modes[k] and y_k = inverse[k] T.

    Fills rate (n,) with lam in 1/s, in no order, modes and inverse (n, m >= n; columns from n on
    zero). Heat q at node i adds modes[k, i] q to the input of y_k. Gives what acts from outside
    (rows, n), see `conductance_matrix`. Without a solution all is NaN.
    """
    matrix, outside = conductance_matrix(net, coefficient, speed, load, given)
    _, copper = count_losses(net.edge_kind)
    count, width = modes.shape
    root = np.empty(count)
    order = np.empty(count, np.int64)
    for i in range(count):
        root[i] = math.sqrt(capacity[i])
        # Slow nodes first, as the method likes it.
        place = i
        while place > 0 and slower(matrix, capacity, i, order[place - 1]):
            order[place] = order[place - 1]
            place -= 1
        order[place] = i
    symmetric = np.zeros((count, width))
    total = 0.0
    for i in range(count):
        for j in range(count):
            a, b = order[i], order[j]
            symmetric[i, j] = matrix[a, b] / (root[a] * root[b])
            total += symmetric[i, j]
    if not (math.isfinite(total) and eigen_decompose(symmetric, modes, rate)):
        rate[:] = math.nan
        modes[:] = math.nan
        inverse[:] = math.nan
        return outside
    for k in range(count):
        # Rounding alone makes a rate negative, unless copper heats itself faster than it cools.
        if not copper:
            rate[k] = max(rate[k], 0.0)
        for i in range(count):
            inverse[k, order[i]] = modes[k, i] * root[order[i]]
        for i in range(count):
            modes[k, i] = inverse[k, i] / capacity[i]
        for i in range(count, width):
            inverse[k, i] = 0.0
    return outside


@compiled
def decompose(net, capacity, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """Modes of an operating point: rates lam (1/s), T = modes @ y, y = inverse @ T, input b.

    Heat q at node i adds modes[i] * q to the modal input; b (rows, n) is what acts from outside,
    to be multiplied with `boundary_values`. The network's inputs are at the values held. Without a
    solution all is NaN.
    """
    count = capacity.size
    rate = np.empty(count)
    modes = np.empty((count, count))
    inverse = np.empty((count, count))
    outside = modal_basis(net, capacity, coefficient, speed, load, net.inputs, rate, modes, inverse)
    result = np.zeros((outside.shape[0], count))
    for b in range(outside.shape[0]):
        for k in range(count):
            for i in range(count):
                result[b, k] += modes[k, i] * outside[b, i]
    return rate, modes.T.copy(), inverse, result


@compiled
def step_functions(rate, step, decay, first, second):  # type: ignore[no-untyped-def]
    """Fill e, h phi1 and h phi2 for a step length."""
    for k in range(rate.size):
        x = rate[k] * step
        decay[k] = math.exp(-x)
        if abs(x) < 0.02:  # series: the closed forms lose all digits
            phi = 1.0 - x / 6.0 * (1.0 - x / 7.0)
            phi = 1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * phi))
            second[k] = 0.5 * step * phi
            first[k] = step * (1.0 - 0.5 * x * phi)
        else:
            phi = (1.0 - decay[k]) / x
            first[k] = step * phi
            second[k] = step * (1.0 - phi) / x


@compiled
def heat_balance(  # type: ignore[no-untyped-def]
    net, values, temperature, speed, load, ambient, revolutions
):
    """Net heat flow into every node (nodes,) and the heat of friction and losses, both in W.

    The network's inputs are at the values held.
    """
    _, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    matrix, outside = conductance_matrix(net, coefficient, speed, load, net.inputs)
    level = boundary_values(net, ambient, net.inputs)
    loss = loss_heats_w(net, coefficient, temperature, speed)
    kind = net.friction_kind
    point = friction_at_point(kind, friction, speed, load)
    heat = friction_heat_w(kind, friction, point, temperature[net.temperature_node], revolutions)
    count = temperature.size
    flow = np.empty(count)
    for i in range(count):
        flow[i] = share[i] * heat + loss[i]
        for b in range(1 + net.boundary_input.size):
            flow[i] -= outside[b, i] * (temperature[i] - level[b])
        for j in range(count):
            # Differences, not L T: a huge conductance must not drown the balance in rounding.
            flow[i] += matrix[i, j] * (temperature[i] - temperature[j])
    for k in range(film_node.size):
        node = film_node[k]
        excess, _ = film_excess_w(film_law[k, 0], film_law[k, 1], temperature[node] - ambient)
        flow[node] -= excess
    for i in range(count):
        heat += loss[i]
    return flow, heat


@compiled
def heat_balance_linearised(  # type: ignore[no-untyped-def]
    net, values, temperature, speed, load, ambient
):
    """Net heat flow (nodes,) before any revolution, and its Jacobian (nodes, nodes) in W/K."""
    flow, _ = heat_balance(net, values, temperature, speed, load, ambient, 0.0)
    _, coefficient, friction, share = bind_network(net, values)
    film_node, film_law = film_edges(net, coefficient)
    matrix, _ = conductance_matrix(net, coefficient, speed, load, net.inputs)
    jacobian = -matrix
    lubricant = net.temperature_node
    nudge = 1e-4
    kind = net.friction_kind
    point = friction_at_point(kind, friction, speed, load)
    heat = friction_heat_w(kind, friction, point, temperature[lubricant], 0.0)
    warmer = friction_heat_w(kind, friction, point, temperature[lubricant] + nudge, 0.0)
    for i in range(temperature.size):
        jacobian[i, lubricant] += share[i] * (warmer - heat) / nudge
    for k in range(film_node.size):
        node = film_node[k]
        _, slope = film_excess_w(film_law[k, 0], film_law[k, 1], temperature[node] - ambient)
        jacobian[node, node] -= slope
    return flow, jacobian
