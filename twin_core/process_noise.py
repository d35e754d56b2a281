"""What an observer's model may be wrong about."""

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin_core.models import ThermalModel
from twin_core.network import LOSSES, EdgeKind
from twin_core.network_model import ErrorModel
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
less than the priors. Heat flows are those in the steady state of the model's reference point."""

JOINT_ERROR = 0.5
"""How far a body that exchanges heat through joints alone may lie from where the model has it, by
the part of its difference to each body that it is joined to. It lies somewhere between them, all
alike where: the standard deviation of that is .29 of the whole difference, to which a third would
come. Of a dry joint only the order of magnitude is known, nor does the network say which part of a
long neighbour a joint touches, which shows while a warm machine becomes warmer: with a third bands
then covered 83 % of the sleeves' temperatures, with a half all (benches of three families)."""

DEVIATION_K = 0.25
"""Slow deviation of any node that no parameter expresses (standard deviation, bearing)."""

KNOWN_WITHIN_K = 3.5
"""A node without a sensor counts as known where half its 95 % band is at most this, of a bearing's
model. On benches of three families the estimates of such nodes are 2 K off at most on average; what
is known less well is off by up to 15 K."""

HALF_WIDTH_95 = 1.959964

_AGREEMENT_K = 0.1

LONG_RUN_IN = 1e9
"""Revolutions of a bearing whose running-in is over, assumed where they are not known."""


def disturbance_structure(model: ThermalModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heats that independent unit disturbances bring to the nodes, per watt of friction heat.

    Returns (nodes, nodes), a factor L of the covariance L L', for the parameters `values` (p,).
    Raises `SimulationError` if the model has no steady state at the reference point.
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
    that no sensor deviates: (nodes, nodes), a factor S of the covariance S S', in K per kelvin of
    the sensors' mean rise over ambient, for the parameters `values` (p,). Raises `SimulationError`
    if the model has no steady state at the reference point.
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


@lru_cache(maxsize=64)
def between_joints(model: ThermalModel) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bodies that exchange heat through joints alone, such as a sleeve between ring and shaft.

    Data show, if anything, a scale of resistances, which leaves such a body where it is; what
    moves it is the ratio of its joints. See `JOINT_ERROR`.

    Returns `bodies`, `neighbours`: shape (pairs,): the places of the body and of what it is joined
    to, among the model's nodes.
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


def joint_variance(
    joints: tuple[NDArray[np.int64], NDArray[np.int64]], temperatures_c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Variance of bodies between joints, for where between their neighbours they lie.

    `joints`: from `between_joints`; `temperatures_c` (..., nodes) in degC. Returns (..., nodes) in
    K2; zero of all other nodes. See `JOINT_ERROR`.
    """
    bodies, neighbours = joints
    variance = np.zeros(temperatures_c.shape)
    for body, neighbour in zip(bodies.tolist(), neighbours.tolist(), strict=True):
        apart_k = temperatures_c[..., neighbour] - temperatures_c[..., body]
        variance[..., body] += (JOINT_ERROR * apart_k) ** 2
    return variance


def known_within_k(model: ThermalModel) -> float:
    """Half the widest 95 % band with which a node of a model counts as known, K."""
    return KNOWN_WITHIN_K * max(model.errors.scale, 1.0)


def reading_errors(model: ThermalModel, names: Iterable[str]) -> dict[str, ErrorModel]:
    """How far readings may lie from a model with the right parameters, by sensor or node.

    That of a body between joints that these alone leave unknown (`KNOWN_WITHIN_K`; the sleeves, not
    the cage of a 6311) is as doubtful as its place between them, with the prior's parameters at the
    reference point: a model that must follow it bends what is right elsewhere.

    Raises `SimulationError` if such a body is read and the model has no steady state at the
    reference point.
    """
    errors = dict.fromkeys(names, model.errors)
    joints = between_joints(model)
    bodies = {model.node_names[body]: body for body in set(joints[0].tolist())}
    read = errors.keys() & bodies.keys()
    if read:
        held = model.at_reference(0.0)
        values = model.parameters.centre
        rise = steady_state(held, values, *held.reference_point, 0.0, LONG_RUN_IN)
        joint_k = np.sqrt(joint_variance(joints, rise))
        unknown_k = known_within_k(model) / HALF_WIDTH_95
        for name in (name for name in read if joint_k[bodies[name]] > unknown_k):
            slow_k = float(np.hypot(model.errors.slow_k, joint_k[bodies[name]]))
            errors[name] = replace(model.errors, slow_k=slow_k)
    return errors
