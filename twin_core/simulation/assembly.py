"""A network with its parameters applied: matrices, modes, heat balance.

With the symmetric S = C^-1/2 L C^-1/2 = V diag(lam) V', the coordinates y = V' C^1/2 T of
C dT/dt = -L T + g Ta + q decouple.
"""

import math

import numpy as np

from twin_core.simulation.compiling import compiled
from twin_core.simulation.eigen import eigen_decompose
from twin_core.simulation.laws import (
    FILM,
    edge_conductance,
    film_excess_w,
    friction_at_point,
    friction_heat_w,
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
def modal_basis(  # type: ignore[no-untyped-def]
    net, capacity, coefficient, speed, load, rate, modes, inverse
):
    """Decouple an operating point: T = sum of y_k modes[k] and y_k = inverse[k] T.

    Fills rate (n,) with lam in 1/s, in no order, modes and inverse (n, m >= n; columns from n on
    zero). Heat q at node i adds modes[k, i] q to the input of y_k. Gives the conductances to
    ambient (n,). Without a solution all is NaN.
    """
    matrix, to_ambient = conductance_matrix(net, coefficient, speed, load)
    count, width = modes.shape
    root = np.sqrt(capacity)
    symmetric = np.zeros((count, width))
    total = 0.0
    # Slow nodes first, as the method likes it.
    order = np.argsort(np.diag(matrix) / capacity)
    for i in range(count):
        for j in range(count):
            a, b = order[i], order[j]
            symmetric[i, j] = matrix[a, b] / (root[a] * root[b])
            total += symmetric[i, j]
    if not (math.isfinite(total) and eigen_decompose(symmetric, modes, rate)):
        rate[:] = math.nan
        modes[:] = math.nan
        inverse[:] = math.nan
        return to_ambient
    for k in range(count):
        rate[k] = max(rate[k], 0.0)
        for i in range(count):
            inverse[k, order[i]] = modes[k, i] * root[order[i]]
        for i in range(count):
            modes[k, i] = inverse[k, i] / capacity[i]
        for i in range(count, width):
            inverse[k, i] = 0.0
    return to_ambient


@compiled
def decompose(net, capacity, coefficient, speed, load):  # type: ignore[no-untyped-def]
    """Modes of an operating point: rates lam (1/s), T = modes @ y, y = inverse @ T, ambient b.

    Heat q at node i adds modes[i] * q to the modal input b. Without a solution all is NaN.
    """
    count = capacity.size
    rate = np.empty(count)
    modes = np.empty((count, count))
    inverse = np.empty((count, count))
    to_ambient = modal_basis(net, capacity, coefficient, speed, load, rate, modes, inverse)
    ambient = np.zeros(count)
    for k in range(count):
        for i in range(count):
            ambient[k] += modes[k, i] * to_ambient[i]
    return rate, modes.T.copy(), inverse, ambient


@compiled
def step_functions(rate, step, decay, first, second):  # type: ignore[no-untyped-def]
    """Fill e, h phi1 and h phi2 for a step length."""
    for k in range(rate.size):
        x = rate[k] * step
        decay[k] = math.exp(-x)
        if x < 0.02:  # series: the closed forms lose all digits
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
