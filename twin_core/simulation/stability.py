"""Loop gain of a steady state: how much of a rise the friction gives back to itself."""

import math

from twin_core.simulation.compiling import compiled
from twin_core.simulation.laws import film_excess_w, friction_heat_w
from twin_core.simulation.linear import solve_in_place

_SCAN_STEP_K = 2.0
_SCAN_STEPS = 150
_NUDGE_K = 1e-3


@compiled
def loop_gain(held, matrix, ambient, revolutions, rows, temperature, room):  # type: ignore[no-untyped-def]
    """Loop gain dQ/dT R at steady temperatures (nodes,).

    Q is the friction heat, T the lubricant's temperature, R its rise per watt of that heat in the
    network linearised there, films included. Above 1 any rise feeds itself: the determinant of the
    heat balance's Jacobian is that of the network without friction, times 1 - gain. Fills `room`
    (sensors,) with how many K hotter a sensor of the weights `rows` (sensors, nodes) becomes until
    the gain is 1, infinite where that does not happen within 300 K. R is kept on the way there:
    films carry more when hotter, so the room is rather larger.
    """
    kind, friction, point, _, lubricant, share, film_node, film_law = held
    conductance = matrix.copy()
    for j in range(film_node.size):
        node = film_node[j]
        _, slope = film_excess_w(film_law[j, 0], film_law[j, 1], temperature[node] - ambient)
        conductance[node, node] += slope
    rise = share.copy()
    solve_in_place(conductance, rise.reshape((rise.size, 1)))
    resistance = rise[lubricant]
    gain, before, above, found = 0.0, 0.0, 0.0, math.inf
    for step in range(_SCAN_STEPS):
        above = _SCAN_STEP_K * step
        now = temperature[lubricant] + above
        heat = friction_heat_w(kind, friction, point, now, revolutions)
        warmer = friction_heat_w(kind, friction, point, now + _NUDGE_K, revolutions)
        here = resistance * (warmer - heat) / _NUDGE_K
        if step == 0:
            gain = here
        if here >= 1.0:
            part = (1.0 - before) / (here - before) if step > 0 else 0.0
            found = above - _SCAN_STEP_K * (1.0 - part) if step > 0 else 0.0
            break
        # Heat that falls with temperature falls at every temperature, in all laws.
        if here <= 0.0:
            break
        before = here
    for s in range(room.size):
        room[s] = math.inf
        if found < math.inf:
            weight = 0.0
            for i in range(rise.size):
                weight += rows[s, i] * rise[i]
            room[s] = found * weight / resistance
    return gain
