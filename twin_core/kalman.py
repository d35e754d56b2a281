"""The compiled Kalman filter of machines of one network form, one machine per row of every array.

The state of a machine is [T, d]: its node temperatures and its heat disturbances, see
`twin_core.observer`. As a disturbance answers to nothing but itself, the transition is
[[A, B], [0, fade I]], and the covariance is kept as the three blocks of [[TT, TD], [TD', DD]].
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation import OperatingProfiles
from twin_core.simulation.assembly import driving_value, modal_basis
from twin_core.simulation.compiling import compiled
from twin_core.simulation.kernels import Basis, Starts, simulate_range
from twin_core.simulation.laws import (
    COPPER,
    edge_conductance,
    friction_at_point,
    friction_heat_w,
    loss_at_zero_w,
)
from twin_core.simulation.linear import product, solve_in_place, transposed

FloatArray = NDArray[np.float64]

DISTURBANCE_TIME_S = 5400.0
DISTURBANCE_FADE_S = 3600.0
DISTURBANCE_AT_REST_W = 1.0
DISTURBANCE_LIMIT_K = 2.0
DISTURBANCE_LIMIT_K_W = 0.05
"""After a stop the heat that scales the disturbances fades over an hour to 1 W, as the heat flows
in the machine do. No disturbance is larger than what moves its node by 2 K, and 0.05 K per watt
of that heat, against its neighbours: at standstill the cage hangs on so little that one watt
would be 50 K."""
HEAT_NOISE_W_SQRT_S = 4.0
"""White heat noise per node, in W s^(1/2): 0.17 K per square root of a minute on a ring."""
NOISE_LIMIT_K = 0.3
"""In the long run the heat noise alone moves no node by more than this."""

SENSOR_NOISE_K = 0.05
SENSOR_RESOLUTION_K = 0.1
SENSOR_DRIFT_K = 0.1
SENSOR_DRIFT_TIME_S = 60.0
"""White noise, quantisation step, and a part of the error that lasts for about a minute."""

_A = 1.0 / DISTURBANCE_TIME_S


class Machines(NamedTuple):
    """What does not change of n machines."""

    values: FloatArray  # (n, p) parameters
    #: Their networks with the parameters applied, see `twin_core.simulation.assembly.bind_network`.
    capacity: FloatArray
    coefficient: FloatArray
    friction: FloatArray
    #: (n, nodes, nodes) what disturbances bring to the nodes, and (n, nodes) the size of its rows.
    structure: FloatArray
    structure_size: FloatArray


class Modes(NamedTuple):
    """Modes of the operating points that n machines are at, kept until these change."""

    #: (n, 2) speed and load, and (n, k) inputs; NaN before the first step.
    point: FloatArray
    given: FloatArray
    #: (n, nodes) and (n, nodes, nodes), see `twin_core.simulation.assembly.modal_basis`.
    rate: FloatArray
    modes: FloatArray
    inverse: FloatArray
    tie_w_k: FloatArray  # (n, nodes) what ties each node to all others
    ambient_c: FloatArray  # (n,) ambient temperature of the last step


class Estimates(NamedTuple):
    """States of n machines."""

    #: (n, nodes) means.
    temperatures_c: FloatArray
    disturbances: FloatArray
    #: (n, nodes, nodes) blocks of the covariance.
    tt: FloatArray
    td: FloatArray
    dd: FloatArray
    #: (n,) revolutions since greasing, and the heat that scales the disturbances.
    revolutions: FloatArray
    heat_w: FloatArray
    #: (n, readable) time since the last reading of every sensor and node, long if there was none.
    elapsed_s: FloatArray


@compiled
def generated_heat_w(  # type: ignore[no-untyped-def]
    net, coefficient, friction, temperature, speed, load, given, revolutions
):
    """Heat of friction and losses in W."""
    kind = net.friction_kind
    point = friction_at_point(kind, friction, speed, load)
    heat = 0.0
    for e in range(net.edge_kind.size):
        loss = net.edge_kind[e]
        if loss >= COPPER:
            driving = driving_value(net.edge_input, e, given)
            heat += loss_at_zero_w(loss, coefficient[e], speed, driving)
            slope = -edge_conductance(loss, coefficient[e], speed, 0.0, driving)
            heat += slope * temperature[net.edge_nodes[e, 0]]
    return heat + friction_heat_w(
        kind, friction, point, temperature[net.temperature_node], revolutions
    )


@compiled
def disturbance_heats_w(structure, size, tie_w_k, heat_w):  # type: ignore[no-untyped-def]
    """Heats in W that independent disturbances of one bring to the nodes, (nodes, nodes)."""
    count = size.size
    result = np.empty((count, count))
    limit_k = DISTURBANCE_LIMIT_K + DISTURBANCE_LIMIT_K_W * heat_w
    for i in range(count):
        scale = min(DISTURBANCE_AT_REST_W + heat_w, limit_k * tie_w_k[i] / size[i])
        for j in range(count):
            result[i, j] = structure[i, j] * scale
    return result


@compiled
def decay_integral(rate, step):  # type: ignore[no-untyped-def]
    """Integral of exp(-rate s) over a step."""
    exponent = rate * step
    if exponent < 1e-12:
        return step
    return -step * math.expm1(-exponent) / exponent


@compiled
def transition_and_noise(  # type: ignore[no-untyped-def]
    step, rate, modes, inverse, disturbance, density
):
    """Transition and process noise of temperatures and heat disturbances over a step.

    In the modal coordinates y of the operating point dy/dt = -lam y + D d + B w and dd/dt = -a d +
    sqrt(2 a) v with white w and v, so that every d has variance one in the long run; every integral
    is a sum of exponentials. The feedback of temperature on the friction heat is left out.

    `rate` (nodes,) is lam in 1/s, T the sum of y_k modes[k], y = inverse T; `disturbance` (nodes,
    nodes) the heats in W of disturbances of one, `density` (nodes,) that of the white heat in W2 s.
    Gives A and B (nodes, nodes), fade, the noise of TT and TD (nodes, nodes), and that of each d.
    """
    count = rate.size
    fade = math.exp(-_A * step)
    own = decay_integral(2.0 * _A, step)
    decayed = np.empty((count, count))
    driven = np.empty((count, count))
    crossed = np.empty((count, count))
    white = np.empty((count, count))
    near = np.empty(count)
    mixed = np.empty(count)
    response = product(modes, disturbance)
    for k in range(count):
        # A mode exactly as fast as the disturbance would divide by zero; a part in 1e4 is moot.
        near[k] = _A * 1.0002 if abs(rate[k] - _A) < 1e-4 * _A else rate[k]
        mixed[k] = decay_integral(_A + near[k], step)
        decay = math.exp(-near[k] * step)
        for j in range(count):
            response[k, j] /= near[k] - _A
            decayed[k, j] = decay * inverse[k, j]
            driven[k, j] = (fade - decay) * response[k, j]
            crossed[k, j] = 2.0 * _A * (own - mixed[k]) * response[k, j]
            white[k, j] = modes[k, j] * density[j]
    noise = product(white, transposed(modes))
    spread = product(response, transposed(response))
    for k in range(count):
        for j in range(count):
            pair = decay_integral(near[k] + near[j], step)
            noise[k, j] *= pair
            noise[k, j] += 2.0 * _A * spread[k, j] * (own - mixed[k] - mixed[j] + pair)
    across = transposed(modes)
    return (
        product(across, decayed),
        product(across, driven),
        fade,
        product(product(across, noise), modes),
        product(across, crossed),
        2.0 * _A * own,
    )


@compiled
def disturb_range(  # type: ignore[no-untyped-def]
    net, machines, known, estimates, steps, given, rows, drives, heat, scale
):
    """Begin a step of every machine: its modes, and the heats of its disturbances.

    `steps` (4, n) and `given` (n, inputs) are as in `advance_range`. Fills rows (4, n, 2) and
    drives (n, 2, inputs) with the profiles of the step, heat (n, nodes) with the mean heats in W
    over it, and scale (n,) with the heat that scales the disturbances.
    """
    count = net.capacity.size
    for i in range(steps.shape[1]):
        step, n, f = steps[0, i], abs(steps[1, i]), max(steps[2, i], 0.0)
        rows[0, i, 0], rows[0, i, 1] = 0.0, step
        rows[1, i, :], rows[2, i, :], rows[3, i, :] = n, f, steps[3, i]
        for k in range(given.shape[1]):
            drives[i, :, k] = given[i, k]
        if step <= 0.0:
            continue
        capacity, coefficient = machines.capacity[i], machines.coefficient[i]
        modes, tie = known.modes[i], known.tie_w_k[i]
        moved = n != known.point[i, 0] or f != known.point[i, 1]
        for k in range(given.shape[1]):
            moved = moved or given[i, k] != known.given[i, k]
        if moved:
            modal_basis(
                net,
                capacity,
                coefficient,
                n,
                f,
                given[i],
                known.rate[i],
                modes,
                known.inverse[i],
            )
            # The diagonal of C^1/2 V lam V' C^1/2.
            for j in range(count):
                tie[j] = 0.0
                for k in range(count):
                    tie[j] += modes[k, j] * modes[k, j] * known.rate[i, k]
                tie[j] *= capacity[j] * capacity[j]
            known.point[i, 0], known.point[i, 1] = n, f
            for k in range(given.shape[1]):
                known.given[i, k] = given[i, k]
        now_w = generated_heat_w(
            net,
            coefficient,
            machines.friction[i],
            estimates.temperatures_c[i],
            n,
            f,
            given[i],
            estimates.revolutions[i],
        )
        scale[i] = max(now_w, estimates.heat_w[i])
        disturbance = disturbance_heats_w(
            machines.structure[i], machines.structure_size[i], tie, scale[i]
        )
        mean_fading = decay_integral(_A, step) / step
        for j in range(count):
            heat[i, j] = 0.0
            for k in range(count):
                heat[i, j] += disturbance[j, k] * estimates.disturbances[i, k]
            heat[i, j] *= mean_fading


@compiled
def predict_range(  # type: ignore[no-untyped-def]
    machines, known, estimates, steps, failed, scale, path
):
    """Advance the machines, each by its own step; of those that failed nothing changes.

    `steps` are as in `advance_range`, `scale` is what `disturb_range` gave, `path` (n, 2, nodes)
    the simulated temperatures.
    """
    count = known.rate.shape[1]
    density = np.empty(count)
    for i in range(steps.shape[1]):
        step = steps[0, i]
        if step <= 0.0 or failed[i] >= 0:
            continue
        modes, tie = known.modes[i], known.tie_w_k[i]
        disturbance = disturbance_heats_w(
            machines.structure[i], machines.structure_size[i], tie, scale[i]
        )
        for j in range(count):
            # White heat of density s alone gives a node the variance s / (2 G C) in the long run.
            limit = 2.0 * NOISE_LIMIT_K**2 * tie[j] * machines.capacity[i, j]
            density[j] = min(HEAT_NOISE_W_SQRT_S**2, limit)
        a, b, fade, noise, cross, own = transition_and_noise(
            step, known.rate[i], modes, known.inverse[i], disturbance, density
        )
        tt, td, dd = estimates.tt[i], estimates.td[i], estimates.dd[i]
        x, more = product(a, tt), product(b, transposed(td))
        y, other = product(a, td), product(b, dd)
        for j in range(count):
            for k in range(count):
                x[j, k] += more[j, k]
                y[j, k] += other[j, k]
        new, more = product(x, transposed(a)), product(y, transposed(b))
        for j in range(count):
            for k in range(count):
                new[j, k] += more[j, k]
        for j in range(count):
            for k in range(count):
                tt[j, k] = 0.5 * (new[j, k] + new[k, j] + noise[j, k] + noise[k, j])
                td[j, k] = fade * y[j, k] + cross[j, k]
                dd[j, k] *= fade * fade
            dd[j, j] += own
            estimates.temperatures_c[i, j] = path[i, 1, j]
            estimates.disturbances[i, j] *= fade
        estimates.heat_w[i] = scale[i] * math.exp(-step / DISTURBANCE_FADE_S)
        estimates.revolutions[i] += abs(steps[1, i]) * step / 60.0
        known.ambient_c[i] = steps[3, i]
        for k in range(estimates.elapsed_s.shape[1]):
            estimates.elapsed_s[i, k] += step


def advance_range(
    net: Any,
    machines: Machines,
    known: Modes,
    estimates: Estimates,
    steps: FloatArray,
    given: FloatArray,
) -> NDArray[np.bool_]:
    """Advance every machine by its own step at its operating point; a step of zero does nothing.

    Not compiled itself: the simulation that it calls would be compiled once more, within it.

    `known`, `estimates`: change; `steps` (4, n): the steps' lengths, the speeds, loads and
    ambients; `given` (n, inputs). Returns (n,) which ran away; of those nothing changes.
    """
    size, count = estimates.temperatures_c.shape
    rows, drives = np.empty((4, size, 2)), np.empty((size, 2, given.shape[1]))
    heat, scale = np.empty((size, count)), np.empty(size)
    failed, two, path = np.full(size, -1), np.full(size, 2), np.empty((size, 2, count))
    disturb_range(net, machines, known, estimates, steps, given, rows, drives, heat, scale)
    ahead = OperatingProfiles(rows[0], rows[1], rows[2], rows[3], drives, two)
    basis = Basis(known.rate, known.modes, known.inverse)
    starts = Starts(estimates.temperatures_c, estimates.revolutions, heat, 0.0)
    for start, stop in _moving(steps[0]):
        simulate_range(net, machines.values, ahead, starts, two, basis, start, stop, failed, path)
    predict_range(machines, known, estimates, steps, failed, scale, path)
    return failed >= 0


def _moving(step_s: FloatArray) -> list[tuple[int, int]]:
    """First and one after the last of each row of machines that have a step."""
    moves = step_s > 0.0
    if moves.all():
        return [(0, step_s.size)]
    edges = np.flatnonzero(np.diff(moves, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


@compiled
def reading_variance(elapsed_s):  # type: ignore[no-untyped-def]
    """Variance of a reading in K2; a quickly repeated one repeats most of the slow error."""
    repeats = max(SENSOR_DRIFT_TIME_S / max(elapsed_s, 1e-3), 1.0)
    return SENSOR_NOISE_K**2 + SENSOR_RESOLUTION_K**2 / 12.0 + SENSOR_DRIFT_K**2 * repeats


@compiled
def update_range(rows, columns, readings, estimates):  # type: ignore[no-untyped-def]
    """Take in the readings of every machine.

    `rows` (sensors, nodes) are the sensors' weights of the nodes, `columns` (sensors,) their
    places in the estimates' `elapsed_s`, `readings` (n, sensors) what they read in degC, NaN where
    nothing. Returns the innovations and their standard deviations in K (n, sensors), NaN where
    there is none.
    """
    sensors, count = rows.shape
    difference, expected = np.empty(readings.shape), np.empty(readings.shape)
    chosen = np.empty(sensors, np.int64)
    for i in range(readings.shape[0]):
        given = 0
        for s in range(sensors):
            difference[i, s] = math.nan
            expected[i, s] = math.nan
            if math.isfinite(readings[i, s]):
                chosen[given] = s
                given += 1
        if given == 0:
            continue
        temperature, state = estimates.temperatures_c[i], estimates.disturbances[i]
        tt, td, dd = estimates.tt[i], estimates.td[i], estimates.dd[i]
        # The covariance of the readings with [T, d], and that of the readings.
        to = np.zeros((given, 2 * count))
        spread = np.zeros((given, given))
        missed = np.empty(given)
        for m in range(given):
            row = rows[chosen[m]]
            missed[m] = readings[i, chosen[m]]
            for k in range(count):
                missed[m] -= row[k] * temperature[k]
                if row[k] != 0.0:
                    for j in range(count):
                        to[m, j] += row[k] * tt[k, j]
                        to[m, count + j] += row[k] * td[k, j]
        for m in range(given):
            for q in range(given):
                for k in range(count):
                    spread[m, q] += to[m, k] * rows[chosen[q], k]
            place = columns[chosen[m]]
            spread[m, m] += reading_variance(estimates.elapsed_s[i, place])
            difference[i, chosen[m]] = missed[m]
            expected[i, chosen[m]] = math.sqrt(spread[m, m])
        gain, left = to.copy(), spread.copy()
        solve_in_place(left, gain)
        # The Joseph form, multiplied out: symmetric, and an error of the gain counts squared.
        left = product(spread, gain)
        for m in range(given):
            for j in range(2 * count):
                left[m, j] -= to[m, j]
        for j in range(count):
            for m in range(given):
                temperature[j] += gain[m, j] * missed[m]
                state[j] += gain[m, count + j] * missed[m]
            for k in range(count):
                for m in range(given):
                    gain_t, gain_d, d = gain[m, j], gain[m, count + j], count + k
                    tt[j, k] += gain_t * left[m, k] - to[m, j] * gain[m, k]
                    td[j, k] += gain_t * left[m, d] - to[m, j] * gain[m, d]
                    dd[j, k] += gain_d * left[m, d] - to[m, count + j] * gain[m, d]
        for m in range(given):
            estimates.elapsed_s[i, columns[chosen[m]]] = 0.0
    return difference, expected
