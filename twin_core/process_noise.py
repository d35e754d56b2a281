"""What an observer's model may be wrong about, and how that spreads over a step."""

import numpy as np
from numpy.typing import NDArray

from twin_core.models import ThermalModel
from twin_core.network import LOSSES, EdgeKind
from twin_core.simulation import heat_balance_w, kernels, steady_state

FRICTION_ERROR = 0.12
SPLIT_ERROR = 0.10
RESISTANCE_ERROR = {
    EdgeKind.CONSTANT: 0.5,
    EdgeKind.CONTACT: 0.8,
    EdgeKind.CONVECTIVE: 0.8,
    EdgeKind.CONVECTIVE_REFERENCE: 0.8,
    EdgeKind.FILM: 0.25,
    EdgeKind.SHAFT_SINK: 1.0,
    EdgeKind.SPEED_POWER: 0.5,
    EdgeKind.COPPER: 0.0,
    EdgeKind.POWER: 0.0,
    EdgeKind.SPEED_LOSS: 0.0,
}
NODE_ERROR = 0.01
"""Standard deviations of the heat disturbances: of the friction heat as a whole, to which the
losses count; of each node's share of it; of the heat through an edge, by its kind; of any node's
heat, as a part of the friction heat. They are those of a model that has met its bench, somewhat
less than the priors. Heat flows are taken in the steady state of the model's reference point."""

JOINT_ERROR = 1.0 / 3.0
"""How far a body that exchanges heat through joints alone may lie from where the model has it, by
the part of its difference to each body that it is joined to. It lies somewhere between them, all
alike where: the standard deviation of that is .29 of the whole difference, and this comes to .24 to
.33. Of a dry joint only the order of magnitude is known, nor does the network say which part of a
long neighbour a joint touches."""

_AGREEMENT_K = 0.1

LONG_RUN_IN = 1e9
"""Revolutions of a bearing whose running-in is over, assumed where they are not known."""


def disturbance_structure(model: ThermalModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heats that independent unit disturbances bring to the nodes, per watt of friction heat.

    Parameters
    ----------
    model, values
        The model and its parameters, shape (p,).

    Returns
    -------
    ndarray
        Shape (nodes, nodes), a factor L of the covariance L L'.

    Raises
    ------
    SimulationError
        If the model has no steady state at the reference point.
    """
    model = model.at_reference(0.0)
    compiled = model.compiled
    nodes, edges = len(model.node_names), compiled.edge_kind.size
    speed, load = model.reference_point
    rise = steady_state(model, values, speed, load, 0.0, LONG_RUN_IN)
    _, friction = heat_balance_w(model, values, rise, speed, load, 0.0, LONG_RUN_IN)
    _, coefficient, _, _ = kernels.bind_network(compiled, values)
    share = heat_shares(model, values, rise)
    conductance = kernels.edge_conductances(compiled, coefficient, speed, load)
    # Heat through an edge leaves its first node and enters its second; boundaries are row N.
    incidence = np.zeros((nodes + 1, edges))
    incidence[compiled.edge_nodes[:, 0], np.arange(edges)] = 1.0
    incidence[np.minimum(compiled.edge_nodes[:, 1], nodes), np.arange(edges)] = -1.0
    error = np.array([RESISTANCE_ERROR[EdgeKind(kind)] for kind in compiled.edge_kind.tolist()])
    flow = conductance * (np.append(rise, 0.0) @ incidence) / friction
    through = incidence[:nodes] * (error * flow)
    covariance = (
        np.diag(NODE_ERROR**2 + (SPLIT_ERROR * share) ** 2)
        + FRICTION_ERROR**2 * np.outer(share, share)
        + through @ through.T
    )
    factor: NDArray[np.float64] = np.linalg.cholesky(covariance)
    return factor


def heat_shares(
    model: ThermalModel, values: NDArray[np.float64], temperatures_c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Shares (nodes,) of the heat of friction and losses, at the model's reference point."""
    _, coefficient, _, share = kernels.bind_network(model.compiled, values)
    if not any(edge.kind in LOSSES for edge in model.network.edges):
        return np.asarray(share)
    speed, load = model.reference_point
    losses = kernels.loss_heats_w(model.compiled, coefficient, temperatures_c, speed)
    _, total = heat_balance_w(model, values, temperatures_c, speed, load, 0.0, LONG_RUN_IN)
    return np.asarray((share * (total - losses.sum()) + losses) / total)


def hidden_spread(model: ThermalModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far unmeasured nodes may lie from a model that agrees with all its sensors.

    The steady deviations that the heat disturbances cause at the model's reference point, given
    that no sensor deviates.

    Parameters
    ----------
    model, values
        The model and its parameters, shape (p,).

    Returns
    -------
    ndarray
        Shape (nodes, nodes): a factor S of the covariance S S', in K per kelvin of the sensors'
        mean rise over ambient.

    Raises
    ------
    SimulationError
        If the model has no steady state at the reference point.
    """
    model = model.at_reference(0.0)
    speed, load = model.reference_point
    structure = disturbance_structure(model, values)
    rise = steady_state(model, values, speed, load, 0.0, LONG_RUN_IN)
    _, friction = heat_balance_w(model, values, rise, speed, load, 0.0, LONG_RUN_IN)
    _, jacobian = kernels.heat_balance_linearised(model.compiled, values, rise, speed, load, 0.0)
    response = np.linalg.solve(jacobian, structure * friction)
    sensors = model.sensor_matrix(model.sensor_names)
    seen = sensors @ response
    floor = _AGREEMENT_K**2 * np.eye(len(seen))
    response -= response @ seen.T @ np.linalg.solve(seen @ seen.T + floor, seen)
    result: NDArray[np.float64] = response / float(np.mean(sensors @ rise))
    return result


def between_joints(model: ThermalModel) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bodies that exchange heat through joints alone, such as a sleeve between ring and shaft.

    Data tell, if anything, a scale of resistances, which leaves such a body where it is; what
    moves it is the ratio of its joints. See `JOINT_ERROR`.

    Returns
    -------
    bodies, neighbours : ndarray
        Shape (pairs,): the places of the body and of what it is joined to, among the model's nodes.
    """
    compiled = model.compiled
    nodes = len(model.node_names)
    joint = compiled.edge_kind == EdgeKind.CONSTANT
    ends = compiled.edge_nodes[joint]
    # Not those with a film, a grease, a contact, a source, a joint to the ambient, or a sensor.
    others = compiled.edge_nodes[~joint].ravel()
    outside = ends[ends[:, 1] >= nodes, 0]
    seen = np.abs(model.sensor_matrix(model.sensor_names)) > 0.5
    sensed = np.flatnonzero(seen.any(axis=0))
    boundaries = np.arange(nodes, nodes + 1 + compiled.boundary_input.size)
    known = np.concatenate((others, compiled.share_node, outside, boundaries, sensed))
    bodies = np.setdiff1d(ends, known)
    pairs = np.concatenate((ends, ends[:, ::-1]))
    pairs = pairs[np.isin(pairs[:, 0], bodies)]
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def transition_and_noise(
    dt_s: float,
    rate: NDArray[np.float64],
    modes: NDArray[np.float64],
    inverse: NDArray[np.float64],
    disturbance_w: NDArray[np.float64],
    disturbance_time_s: float,
    noise_density: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition matrix and process noise of temperatures and heat disturbances.

    The state is [T, d], both (nodes,). In the modal coordinates y of the operating point
    dy/dt = -lam y + D d + B w and dd/dt = -a d + sqrt(2 a) v with white w and v, so that every d
    has variance one in the long run; every integral is a sum of exponentials. The feedback of
    temperature on the friction heat is left out.

    Parameters
    ----------
    dt_s
        Length of the step, > 0.
    rate, modes, inverse
        lam in 1/s (nodes,), T = modes @ y, y = inverse @ T.
    disturbance_w
        Column j is the heat in W that disturbance j brings to the nodes when it is one,
        shape (nodes, nodes).
    disturbance_time_s
        1 / a.
    noise_density
        Density of the white heat at each node in W2 s, shape (nodes,).

    Returns
    -------
    transition, noise : ndarray
        Shape (2 nodes, 2 nodes) each.
    """
    nodes = rate.size
    a = 1.0 / disturbance_time_s
    # A mode exactly as fast as the disturbance would divide by zero; a part in 1e4 is moot.
    rate = np.where(np.abs(rate - a) < 1e-4 * a, a * 1.0002, rate)
    response = modes.T @ disturbance_w / (rate - a)[:, None]
    decay, fade = np.exp(-rate * dt_s), float(np.exp(-a * dt_s))
    transition = np.zeros((2 * nodes, 2 * nodes))
    transition[:nodes, :nodes] = (modes * decay) @ inverse
    transition[:nodes, nodes:] = modes @ (response * (fade - decay)[:, None])
    transition[nodes:, nodes:] = fade * np.eye(nodes)

    pair = _integral(rate[:, None] + rate[None, :], dt_s)
    mixed = _integral(a + rate, dt_s)
    own = float(_integral(np.array(2.0 * a), dt_s))
    driven = 2.0 * a * (response @ response.T) * (own - mixed[:, None] - mixed[None, :] + pair)
    white = (modes.T * noise_density) @ modes * pair
    cross = modes @ (2.0 * a * response * (own - mixed)[:, None])
    noise = np.zeros((2 * nodes, 2 * nodes))
    noise[:nodes, :nodes] = modes @ (driven + white) @ modes.T
    noise[:nodes, nodes:] = cross
    noise[nodes:, :nodes] = cross.T
    noise[nodes:, nodes:] = 2.0 * a * own * np.eye(nodes)
    return transition, (noise + noise.T) / 2.0


def _integral(total: NDArray[np.float64], dt_s: float) -> NDArray[np.float64]:
    """Integral of exp(-total s) over the step."""
    exponent = total * dt_s
    small = exponent < 1e-12
    safe = np.where(small, 1.0, exponent)
    result: NDArray[np.float64] = dt_s * np.where(small, 1.0, -np.expm1(-safe) / safe)
    return result
