"""What is added to the paths of an ensemble, in one pass over them."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.simulation.assembly import bind_network, heat_balance
from twin_core.simulation.compiling import compiled, kernel_array

FloatArray = NDArray[np.float64]


@compiled
def add_deviations(
    paths: FloatArray,
    normal: FloatArray,
    keep: FloatArray,
    shock: FloatArray,
    widening: FloatArray,
    lasting: FloatArray,
    growth: FloatArray,
) -> None:
    """Add first-order random deviations that begin at zero, and lasting ones that grow.

    paths (members, n, k), changed in place; normal (members / 2, n - 1, k) standard normal
    numbers, of which the second half of the members takes the negative ones; keep and shock
    (n - 1,) what is left after a step and what is new; widening (n, k) a factor of the deviation;
    lasting (members, k) times growth (n,) is added too.
    """
    members, rows, count = paths.shape
    half = members // 2
    state = np.empty(count)
    for member in range(members):
        sign, source = (1.0, member) if member < half else (-1.0, member - half)
        state[:] = 0.0
        for row in range(rows):
            if row > 0:
                for k in range(count):
                    new = sign * shock[row - 1] * normal[source, row - 1, k]
                    state[k] = keep[row - 1] * state[k] + new
            for k in range(count):
                paths[member, row, k] += (
                    widening[row, k] * state[k] + growth[row] * lasting[member, k]
                )


@compiled
def delay_paths(paths, time, lag, out):  # type: ignore[no-untyped-def]
    """Fill out with paths (members, n, k) as they were lag (members,) >= 0 before each row.

    time (1 or members, n). Before its first row a path stays as it is there. Where a path is not
    finite, it stays so.
    """
    rows, count = paths.shape[1:]
    for member in range(paths.shape[0]):
        at = time[member if time.shape[0] > 1 else 0]
        before = 0
        for row in range(rows):
            then = max(at[row] - lag[member], at[0])
            while before + 1 < rows and at[before + 1] <= then:
                before += 1
            after = min(before + 1, row)
            share = (then - at[before]) / max(at[after] - at[before], 1e-9)
            for k in range(count):
                out[member, row, k] = paths[member, row, k]
                if math.isfinite(paths[member, row, k]):
                    early, late = paths[member, before, k], paths[member, after, k]
                    out[member, row, k] = (1.0 - share) * early + share * late


@compiled
def shift_between(
    paths: FloatArray, bodies: NDArray[np.int64], neighbours: NDArray[np.int64], part: FloatArray
) -> None:
    """Move bodies by a part of what lies between them and their neighbours.

    paths (members, n, k), changed in place; bodies and neighbours (pairs,) places on its last
    axis; part (members, pairs).
    """
    moved = np.empty(bodies.size)
    for member in range(paths.shape[0]):
        for row in range(paths.shape[1]):
            here = paths[member, row]
            for pair in range(bodies.size):
                between = here[neighbours[pair]] - here[bodies[pair]]
                moved[pair] = part[member, pair] * between
            for pair in range(bodies.size):
                here[bodies[pair]] += moved[pair]


@compiled
def net_heat_range(  # type: ignore[no-untyped-def]
    net, values, temperatures, speed, load, ambient, revolutions, flow, capacity
):
    """Net heat flow into every node in W and the nodes' capacities in J/K, of every member.

    values (members, p), temperatures, flow and capacity (members, nodes), the last two filled.
    """
    for member in range(values.shape[0]):
        own, _ = heat_balance(
            net, values[member], temperatures[member], speed, load, ambient, revolutions
        )
        held, _, _, _ = bind_network(net, values[member])
        for i in range(own.size):
            flow[member, i], capacity[member, i] = own[i], held[i]


@compiled
def gather_members(paths: FloatArray, columns: NDArray[np.int64], out: FloatArray) -> None:
    """Fill out (n, columns, members) with columns of paths (members, n, k), row by row."""
    for row in range(paths.shape[1]):
        for member in range(paths.shape[0]):
            for place in range(columns.size):
                out[row, place, member] = paths[member, row, columns[place]]


def delayed(paths: FloatArray, time_s: FloatArray, lag_s: ArrayLike) -> FloatArray:
    """Paths (members, n, k) as lagging sensors show them.

    `time_s` (n,) of the rows, or (members, n) each path's own; `lag_s` for all, or (members,).
    """
    out = np.empty(paths.shape)
    lags = kernel_array(np.broadcast_to(np.asarray(lag_s, np.float64), paths.shape[:1]))
    delay_paths(kernel_array(paths), kernel_array(np.atleast_2d(time_s)), lags, out)
    return out
