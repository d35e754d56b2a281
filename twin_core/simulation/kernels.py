"""The compiled simulation: exact zero-order hold with one corrector.

Between two instants the network is linear but for the heat: C dT/dt = -L T + g Ta + q, where L
holds what the heat of a current gains with temperature, and g Ta all boundaries and losses. In the
coordinates y of :mod:`twin_core.simulation.assembly`, and for a q that is linear in time within
the step, the solution is exact:

    y1 = e y0 + h phi1 b0 + h phi2 (b1 - b0),      b = V' C^-1/2 (g Ta + q)

with e = exp(-lam h), phi1 = (1 - e) / (lam h), phi2 = (1 - phi1) / (lam h). The predictor takes
b1 = b0; the corrector evaluates the heat at the predicted temperatures.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation.assembly import (
    bind_network,
    conductance_matrix,
    count_losses,
    decompose,
    edge_conductances,
    film_edges,
    heat_balance,
    heat_balance_linearised,
    loss_heats_w,
    modal_basis,
    step_functions,
)
from twin_core.simulation.compiling import compiled
from twin_core.simulation.laws import (
    FILM,
    FILM_REFERENCE_K,
    LINEAR,
    TEMPERATURE_LIMIT_C,
    TWO_PART,
    edge_conductance,
    film_excess_w,
    friction_at_point,
    friction_heat_w,
    heat_at_point_w,
    running_in,
)

__all__ = [
    "UNKNOWN_BASIS",
    "Basis",
    "Starts",
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
    "loss_heats_w",
    "simulate_range",
]
from twin_core.simulation.linear import fill_product
from twin_core.simulation.vectors import LANES, STRIDE, advance, combine

MAX_STEP_S = 60.0
"""Longer rows are divided into equal steps no longer than this."""
FRESH_STEP_S = 15.0
FRESH_S = 120.0
"""For this long after a change of the operating point the steps are shorter: the heat moves
fastest there. It depends on the profile alone, so results stay smooth in the parameters."""
FRESH_SPEED_FRACTION = 0.02
FRESH_LOAD_FRACTION = 0.05
"""Smaller changes are measurement noise and need no shorter steps."""


class Basis(NamedTuple):
    """Modes of the members' first operating points, see `modal_basis`."""

    rate: NDArray[np.float64]  # (B, nodes)
    #: (B, nodes, nodes).
    modes: NDArray[np.float64]
    inverse: NDArray[np.float64]


class Starts(NamedTuple):
    """How the members of a batch begin."""

    temperatures_c: NDArray[np.float64]  # (B, nodes)
    revolutions: NDArray[np.float64]  # (B,) since greasing
    disturbance_w: NDArray[np.float64]  # (B, nodes) extra heat, which fades
    fading: float  # the rate at which it does, in 1/s


UNKNOWN_BASIS = Basis(np.empty((0, 0)), np.empty((0, 0, 0)), np.empty((0, 0, 0)))


@compiled
def padded(count, multiple):  # type: ignore[no-untyped-def]
    """Round up to a multiple."""
    return (count + multiple - 1) // multiple * multiple


@compiled
def prepare_step(  # type: ignore[no-untyped-def]
    functions, source, modes, node, gain, ahead, response
):
    """All that a step of one length needs while the operating point stays.

    From the step's functions (3, m) of every rate, and what each input does to the coordinates'
    rates of change, source (inputs, m): what it does to them in one step, gain (inputs + active,
    m), and to the active temperatures, ahead (m + inputs, active), whose first m rows are what the
    coordinates themselves do; and what changes within the step do, response (active, active).
    """
    inputs, width = source.shape
    for q in range(inputs):
        for k in range(width):
            gain[q, k] = functions[1, k] * source[q, k]
    for q in range(node.size):
        for k in range(width):
            gain[inputs + q, k] = functions[2, k] * source[q, k]
    for j in range(node.size):
        for k in range(modes.shape[0]):
            ahead[k, j] = functions[0, k] * modes[k, node[j]]
        for q in range(inputs):
            total = 0.0
            for k in range(modes.shape[0]):
                total += gain[q, k] * modes[k, node[j]]
            ahead[width + q, j] = total
        for q in range(node.size):
            total = 0.0
            for k in range(modes.shape[0]):
                total += gain[inputs + q, k] * modes[k, node[j]]
            response[q, j] = total


@compiled
def film_heat_w(laws, memories, j, difference):  # type: ignore[no-untyped-def]
    """`film_excess_w` of the film j, its power continued from where it was last computed.

    memories (films, 3): one over the difference and the power there, and the slope here, which is
    left for the caller. Within 1/32 of that difference the binomial series is exact to 1e-9 of the
    power.
    """
    size, e = abs(difference), laws[j, 1]
    if size < 1e-9:
        memories[j, 2] = 0.0
        return 0.0
    x = size * memories[j, 0] - 1.0
    if abs(x) > 1.0 / 32.0:
        memories[j, 0] = 1.0 / size
        memories[j, 1] = (size / FILM_REFERENCE_K) ** e
        x = 0.0
    series = 1.0 + 0.25 * (e - 3.0) * x * (1.0 + 0.2 * (e - 4.0) * x)
    series = 1.0 + e * x * (1.0 + 0.5 * (e - 1.0) * x * (1.0 + (e - 2.0) / 3.0 * x * series))
    relative = memories[j, 1] * series
    memories[j, 2] = laws[j, 0] * ((1.0 + e) * relative - 1.0)
    return laws[j, 0] * (relative - 1.0) * difference


@compiled
def emit(modes, path, begin, end, limit, out):  # type: ignore[no-untyped-def]
    """Temperatures out[begin:end] of the coordinates path[begin:end].

    Returns the first row beyond the limit or not finite, or -1.
    """
    if begin >= end:
        return -1
    fill_product(path[begin:end], modes, out[begin:end])
    count = modes.shape[1]
    square = 0.0
    for row in range(begin, end):
        for i in range(count):
            square += out[row, i] * out[row, i]
    if square < limit * limit:
        return -1
    for row in range(begin, end):
        for i in range(count):
            if not abs(out[row, i]) < limit:
                return row
    return -1


@compiled
def drives_differ(edge_input, given, row):  # type: ignore[no-untyped-def]
    """Whether an input that drives a loss is another one than in the row before."""
    for e in range(edge_input.size):
        place = edge_input[e]
        if place >= 0 and given[row, place] != given[row - 1, place]:
            return True
    return False


@compiled
def is_fresh(speed, load, last_speed, last_load):  # type: ignore[no-untyped-def]
    """Whether an operating point differs from the last one by more than measurement noise."""
    return not (
        abs(speed - last_speed) <= FRESH_SPEED_FRACTION * speed
        and abs(load - last_load) <= FRESH_LOAD_FRACTION * load
    )


@compiled
def step_count(span, part):  # type: ignore[no-untyped-def]
    """Count the equal steps of a span, which is fresh (part 0) or not (part 1)."""
    return math.ceil(span / (FRESH_STEP_S if part == 0 else MAX_STEP_S) - 1e-9)


@compiled
def set_outside(boundary_input, ambient, given, row, heat, begin, end):  # type: ignore[no-untyped-def]
    """Fill heat[begin:end] with what acts from outside: ambient, other boundaries, 1 for losses."""
    heat[begin] = ambient[row]
    for b in range(end - begin - 1):
        inside = b < boundary_input.size
        heat[begin + 1 + b] = given[row, boundary_input[b]] if inside else 1.0


@compiled
def simulate_range(  # type: ignore[no-untyped-def]
    net, values, ahead, starts, ends, basis, start, stop, failed, out
):
    """Simulate members start..stop-1 of a batch, each independent of all others.

    `ahead` are `twin_core.simulation.profile.OperatingProfiles`: one for each member, or one for
    all. The disturbance of `starts` ends at the row `ends` (B,). Fills out (B, n, nodes) with
    temperatures at the rows' instants, NaN behind the rows of a member; and failed (B,) with -1, or
    with the row that could not be reached: all of such a member is NaN. `basis` is what
    `modal_basis` gave at the members' first operating points, or `UNKNOWN_BASIS`.

    Within a step only the temperatures matter that the heat depends on, the *active* ones: of the
    lubricant and of the nodes with films. The step of the coordinates y is then a diagonal decay
    plus the inputs (friction, films, ambient, disturbance) and their changes, each times what it
    does to every y in one step; the active temperatures follow by products prepared also.
    """
    initial, revolutions, disturbance, fading = starts
    count = net.capacity.size
    width = padded(count, LANES)
    films = 0
    for e in range(net.edge_kind.size):
        films += net.edge_kind[e] == FILM
    active = 1 + films
    node = np.empty(active, np.int64)
    # Inputs: heat of the friction and of the films, boundaries, losses, disturbance.
    losses, copper = count_losses(net.edge_kind)
    outer = 1 + net.boundary_input.size + (1 if losses else 0)
    inputs = active + outer + 1
    disturbed = inputs - 1
    kind = net.friction_kind
    limit = math.inf if kind == LINEAR and not copper else TEMPERATURE_LIMIT_C

    rate = np.empty(count)
    modes = np.zeros((count, width))
    emitted = np.zeros((width, count))
    inverse = np.zeros((count, width))
    source = np.zeros((inputs, width))
    functions = np.zeros((3, width))
    decay, first, second = functions[0], functions[1], functions[2]
    gain = np.zeros((padded(inputs + active, STRIDE), width))
    forward = np.zeros((width + padded(inputs, STRIDE), padded(active, LANES)))
    response = np.zeros((padded(active, STRIDE), forward.shape[1]))
    now = np.zeros(forward.shape[1])
    later = np.zeros(forward.shape[1])
    ones = np.ones(forward.shape[1])
    # Coordinates, inputs, changes; slices reach into what follows where rows of zeros await it.
    state = np.zeros(width + padded(inputs, STRIDE) + padded(active, STRIDE))
    y, heat = state[:width], state[width : width + inputs]
    change = state[width + inputs : width + inputs + response.shape[0]]
    known, driving = state[: forward.shape[0]], state[width : width + gain.shape[0]]
    film = np.zeros((films, 3))
    path = np.empty((ahead.time_s.shape[1], width))

    for member in range(start, stop):
        which = member if ahead.rows.size > 1 else 0
        rows = ahead.rows[which]
        time, speed, load = ahead.time_s[which], ahead.speed_rpm[which], ahead.load_n[which]
        ambient, given = ahead.ambient_c[which], ahead.inputs[which]
        temperatures = out[member]
        capacity, coefficient, friction, share = bind_network(net, values[member])
        film_node, film_law = film_edges(net, coefficient)
        node[0] = net.temperature_node
        # What a member before this one left, were it not finite, would stay: 0 times NaN is NaN.
        state[:] = 0.0
        now[:] = 0.0
        film[:] = 0.0
        for j in range(films):
            node[1 + j] = film_node[j]
        for i in range(count):
            temperatures[0, i] = initial[member, i]
        point = friction_at_point(kind, friction, 0.0, 0.0)
        point_speed, point_load, point_step = math.nan, math.nan, math.nan
        fresh_until = -math.inf
        turned, fresh, fading_out = revolutions[member], 0.0, 1.0
        begun, bad = 0, -1 if rows > 0 else 0
        for row in range(rows - 1):
            n = abs(speed[row])
            f = max(load[row], 0.0)
            driven = losses > 0 and row > 0 and drives_differ(net.edge_input, given, row)
            if n != point_speed or f != point_load or driven:
                if driven or is_fresh(n, f, point_speed, point_load):
                    fresh_until = time[row] + FRESH_S
                bad = emit(emitted, path, begun + 1, row + 1, limit, temperatures)
                if bad >= 0:
                    break
                begun = row
                if row == 0 and basis.rate.size > 0:
                    _, outside = conductance_matrix(net, coefficient, n, f, given[row])
                    for k in range(count):
                        rate[k] = basis.rate[member, k]
                        for i in range(count):
                            modes[k, i] = basis.modes[member, k, i]
                            inverse[k, i] = basis.inverse[member, k, i]
                else:
                    outside = modal_basis(
                        net, capacity, coefficient, n, f, given[row], rate, modes, inverse
                    )
                point = friction_at_point(kind, friction, n, f)
                point_speed, point_load, point_step = n, f, math.nan
                fresh = running_in(kind, friction, turned)
                for k in range(count):
                    y[k] = 0.0
                    source[0, k] = 0.0
                    for b in range(outer + 1):
                        source[active + b, k] = 0.0
                    for i in range(count):
                        emitted[k, i] = modes[k, i]
                        y[k] += inverse[k, i] * temperatures[row, i]
                        source[0, k] += modes[k, i] * share[i]
                        for b in range(outer):
                            source[active + b, k] += modes[k, i] * outside[b, i]
                        source[disturbed, k] += modes[k, i] * disturbance[member, i]
                    for j in range(films):
                        source[1 + j, k] = -modes[k, film_node[j]]
                for j in range(active):
                    now[j] = temperatures[row, node[j]]
            duration, outside_c = time[row + 1] - time[row], ambient[row]
            set_outside(net.boundary_input, ambient, given, row, heat, active, disturbed)
            if row >= ends[member]:
                heat[disturbed] = 0.0
            elif fading > 0.0:
                heat[disturbed] = math.exp(-fading * (time[row] + 0.5 * duration - time[0]))
            else:
                heat[disturbed] = 1.0
            # A part of shorter steps after a change, then the rest of the row.
            early = min(max(fresh_until - time[row], 0.0), duration)
            for part in range(2):
                span = early if part == 0 else duration - early
                steps = step_count(span, part)
                if steps <= 0:
                    continue
                step = span / steps
                if step != point_step:
                    point_step = step
                    step_functions(rate, step, decay, first, second)
                    prepare_step(functions, source, modes, node, gain, forward, response)
                    if kind == TWO_PART:
                        fading_out = math.exp(-n * step / 60.0 / friction[9])
                for _ in range(steps):
                    heat[0] = heat_at_point_w(kind, point, now[0], fresh)
                    for j in range(films):
                        heat[1 + j] = film_heat_w(film_law, film, j, now[1 + j] - outside_c)
                    combine(later, known, forward)
                    fresh *= fading_out
                    change[0] = heat_at_point_w(kind, point, later[0], fresh) - heat[0]
                    for j in range(1, active):
                        change[j] = film[j - 1, 2] * (later[j] - now[j])
                    advance(now, ones, later, change, response)
                    advance(y, decay, y, driving, gain)
                turned += n * span / 60.0
            for k in range(width):
                path[row + 1, k] = y[k]
        if bad < 0:
            bad = emit(emitted, path, begun + 1, rows, limit, temperatures)
        failed[member] = bad
        for row in range(rows if bad < 0 else 0, temperatures.shape[0]):
            for i in range(count):
                temperatures[row, i] = math.nan
