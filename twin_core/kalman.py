"""The compiled Kalman filter of machines of one network form, one machine per row of every array.

The state of a machine is [T, d]: its node temperatures and its heat disturbances, see
`twin_core.observer`. As a disturbance answers to nothing but itself, the transition is
[[A, B], [0, fade I]], and the covariance is kept as the three blocks of [[TT, TD], [TD', DD]].
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation.assembly import driving_value, modal_basis
from twin_core.simulation.compiling import compiled
from twin_core.simulation.kernels import simulate_kernel
from twin_core.simulation.laws import (
    COPPER,
    edge_conductance,
    friction_at_point,
    friction_heat_w,
    loss_at_zero_w,
)

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

_A = 1.0 / DISTURBANCE_TIME_S


class Machines(NamedTuple):
    """What does not change of n machines.

    Attributes
    ----------
    values
        (n, p) parameters.
    capacity, coefficient, friction
        Their networks with the parameters applied, see
        `twin_core.simulation.assembly.bind_network`.
    structure, structure_size
        (n, nodes, nodes) what disturbances bring to the nodes, and (n, nodes) the size of its rows.
    """

    values: FloatArray
    capacity: FloatArray
    coefficient: FloatArray
    friction: FloatArray
    structure: FloatArray
    structure_size: FloatArray


class Modes(NamedTuple):
    """Modes of the operating points that n machines are at, kept until these change.

    Attributes
    ----------
    point, given
        (n, 2) speed and load, and (n, k) inputs; NaN before the first step.
    rate, modes, inverse
        (n, nodes) and (n, nodes, nodes), see `twin_core.simulation.assembly.modal_basis`.
    tie_w_k
        (n, nodes) what ties each node to all others.
    """

    point: FloatArray
    given: FloatArray
    rate: FloatArray
    modes: FloatArray
    inverse: FloatArray
    tie_w_k: FloatArray


class Estimates(NamedTuple):
    """States of n machines.

    Attributes
    ----------
    temperatures_c, disturbances
        (n, nodes) means.
    tt, td, dd
        (n, nodes, nodes) blocks of the covariance.
    revolutions, heat_w
        (n,) revolutions since greasing, and the heat that scales the disturbances.
    """

    temperatures_c: FloatArray
    disturbances: FloatArray
    tt: FloatArray
    td: FloatArray
    dd: FloatArray
    revolutions: FloatArray
    heat_w: FloatArray


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
            driving = driving_value(net, e, given)
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
    response = np.dot(modes, disturbance)
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
    noise = np.dot(white, modes.T)
    spread = np.dot(response, response.T)
    for k in range(count):
        for j in range(count):
            pair = decay_integral(near[k] + near[j], step)
            noise[k, j] *= pair
            noise[k, j] += 2.0 * _A * spread[k, j] * (own - mixed[k] - mixed[j] + pair)
    return (
        np.dot(modes.T, decayed),
        np.dot(modes.T, driven),
        fade,
        np.dot(np.dot(modes.T, noise), modes),
        np.dot(modes.T, crossed),
        2.0 * _A * own,
    )


@compiled
def predict_range(  # type: ignore[no-untyped-def]
    net, machines, known, estimates, step_s, speed, load, ambient, given, failed, start, stop
):
    """Advance machines start..stop-1, each by its own step at its own operating point.

    A machine whose model runs away is left as it was, and told in `failed`.
    """
    count = net.capacity.size
    time = np.zeros(2)
    at_speed, at_load, at_ambient = np.empty(2), np.empty(2), np.empty(2)
    at_inputs = np.empty((2, given.shape[1]))
    density = np.empty(count)
    heat = np.empty(count)
    path = np.empty((2, count))
    for i in range(start, stop):
        failed[i] = False
        step = step_s[i]
        if step <= 0.0:
            continue
        n, f = abs(speed[i]), max(load[i], 0.0)
        capacity, coefficient = machines.capacity[i], machines.coefficient[i]
        friction = machines.friction[i]
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
            known.given[i] = given[i]
        temperature, state = estimates.temperatures_c[i], estimates.disturbances[i]
        turned = estimates.revolutions[i]
        now_w = generated_heat_w(net, coefficient, friction, temperature, n, f, given[i], turned)
        heat_w = max(now_w, estimates.heat_w[i])
        disturbance = disturbance_heats_w(
            machines.structure[i], machines.structure_size[i], tie, heat_w
        )
        mean_fading = decay_integral(_A, step) / step
        for j in range(count):
            heat[j] = 0.0
            for k in range(count):
                heat[j] += disturbance[j, k] * state[k]
            heat[j] *= mean_fading
            # White heat of density s alone gives a node the variance s / (2 G C) in the long run.
            density[j] = min(HEAT_NOISE_W_SQRT_S**2, 2.0 * NOISE_LIMIT_K**2 * tie[j] * capacity[j])
        time[1] = step
        at_speed[:] = n
        at_load[:] = f
        at_ambient[:] = ambient[i]
        at_inputs[:] = given[i]
        bad = simulate_kernel(
            net,
            machines.values[i],
            time,
            at_speed,
            at_load,
            at_ambient,
            at_inputs,
            temperature.copy(),
            turned,
            heat,
            0.0,
            2,
            path,
        )
        if bad >= 0:
            failed[i] = True
            continue
        a, b, fade, noise, cross, own = transition_and_noise(
            step, known.rate[i], modes, known.inverse[i], disturbance, density
        )
        tt, td, dd = estimates.tt[i], estimates.td[i], estimates.dd[i]
        x = np.dot(a, tt) + np.dot(b, td.T)
        y = np.dot(a, td) + np.dot(b, dd)
        new = np.dot(x, a.T) + np.dot(y, b.T)
        for j in range(count):
            for k in range(count):
                tt[j, k] = 0.5 * (new[j, k] + new[k, j] + noise[j, k] + noise[k, j])
                td[j, k] = fade * y[j, k] + cross[j, k]
                dd[j, k] *= fade * fade
            dd[j, j] += own
            temperature[j] = path[1, j]
            state[j] *= fade
        estimates.heat_w[i] = heat_w * math.exp(-step / DISTURBANCE_FADE_S)
        estimates.revolutions[i] = turned + n * step / 60.0


@compiled
def update_range(  # type: ignore[no-untyped-def]
    rows, readings, variance, estimates, difference, expected, start, stop
):
    """Take in the readings of machines start..stop-1.

    `rows` (sensors, nodes) are the sensors' weights of the nodes, `readings` and `variance` (n,
    sensors) what they read in degC, NaN where nothing, and how well in K2. Fills `difference` and
    `expected` (n, sensors) with the innovations in K and their variances, NaN where there is none.
    """
    sensors, count = rows.shape
    for i in range(start, stop):
        here = np.flatnonzero(np.isfinite(readings[i]))
        for s in range(sensors):
            difference[i, s] = math.nan
            expected[i, s] = math.nan
        if here.size == 0:
            continue
        chosen = np.empty((here.size, count))
        missed = np.empty(here.size)
        temperature, state = estimates.temperatures_c[i], estimates.disturbances[i]
        for m in range(here.size):
            missed[m] = readings[i, here[m]]
            for j in range(count):
                chosen[m, j] = rows[here[m], j]
                missed[m] -= rows[here[m], j] * temperature[j]
        tt, td, dd = estimates.tt[i], estimates.td[i], estimates.dd[i]
        to_t, to_d = np.dot(chosen, tt), np.dot(chosen, td)
        spread = np.dot(to_t, chosen.T)
        for m in range(here.size):
            spread[m, m] += variance[i, here[m]]
            difference[i, here[m]] = missed[m]
            expected[i, here[m]] = spread[m, m]
        gain_t, gain_d = np.linalg.solve(spread, to_t), np.linalg.solve(spread, to_d)
        # The Joseph form, multiplied out: symmetric, and an error of the gain counts squared.
        left_t, left_d = np.dot(spread, gain_t) - to_t, np.dot(spread, gain_d) - to_d
        for j in range(count):
            for m in range(here.size):
                temperature[j] += gain_t[m, j] * missed[m]
                state[j] += gain_d[m, j] * missed[m]
            for k in range(count):
                for m in range(here.size):
                    tt[j, k] += gain_t[m, j] * left_t[m, k] - to_t[m, j] * gain_t[m, k]
                    td[j, k] += gain_t[m, j] * left_d[m, k] - to_t[m, j] * gain_d[m, k]
                    dd[j, k] += gain_d[m, j] * left_d[m, k] - to_d[m, j] * gain_d[m, k]
