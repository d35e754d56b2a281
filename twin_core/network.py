"""Thermal networks as data: nodes, edges, heat sources, sensors; compiled to flat arrays.

Every coefficient of an edge or a source is a number, optionally multiplied by a named parameter
of the model. That is all the binding there is between a network and what is identified.

Units: temperatures in degC, resistances in K/W, conductances in W/K, speed in rpm, load in N.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

AMBIENT = "ambient"
"""Name of the boundary node: its temperature is given, it has no heat capacity."""

MAX_COEFFICIENTS = 4


class EdgeKind(IntEnum):
    """How an edge conducts; *c* are its coefficients in order.

    ``CONSTANT``
        R = c0.
    ``CONTACT``
        R = c0 + c1 + c2 / sqrt(F n): fixed part (half of the balls' own resistance), Kc1, Kc2;
        equation (8) of the paper with both exponents -1/2 as its equation (7) demands.
    ``CONVECTIVE``
        R = c0 / Nu with c0 = L / (k S) and Nu = c1 + c2 n^c3; equations (9), (11), (13), (14),
        (16).
    ``CONVECTIVE_REFERENCE``
        As before with Nu = c1 + (c2 - c1) (n / 3000)^c3: c2 is Nu at 3000 rpm.
    ``FILM``
        Conductance c0 (|Ta - Tb| / 12 K)^c1: natural convection and radiation; c0 at 12 K.
    ``SHAFT_SINK``
        Conductance c0 + c1 (n / 6000)^(2/3): a shaft end to air, rotating.
    ``SPEED_POWER``
        R = c0 (n / c1)^c2: the speed-dependent resistance of the paper's simple network.

    Three more are heats of a node and no conductances; *u* is the value of their channel.

    ``COPPER``
        Heat c0 (1 + c1 (T - 20 degC)) u^2 of a current u in a resistance c0 at 20 degC. Its part
        with T acts as a conductance of -c0 c1 u^2.
    ``POWER``
        Heat c0 c1 (u / c1)^c2 of a measured power u, or of what drives one: c0 u with c2 = 1.
    ``SPEED_LOSS``
        Heat c0 (n / c1)^c2: iron and windage.
    """

    CONSTANT = 0
    CONTACT = 1
    CONVECTIVE = 2
    CONVECTIVE_REFERENCE = 3
    FILM = 4
    SHAFT_SINK = 5
    SPEED_POWER = 6
    COPPER = 7
    POWER = 8
    SPEED_LOSS = 9


LOSSES = (EdgeKind.COPPER, EdgeKind.POWER, EdgeKind.SPEED_LOSS)
"""Kinds that are heats of a node."""

COEFFICIENT_COUNT = {
    EdgeKind.CONSTANT: 1,
    EdgeKind.CONTACT: 3,
    EdgeKind.CONVECTIVE: 4,
    EdgeKind.CONVECTIVE_REFERENCE: 4,
    EdgeKind.FILM: 2,
    EdgeKind.SHAFT_SINK: 2,
    EdgeKind.SPEED_POWER: 3,
    EdgeKind.COPPER: 2,
    EdgeKind.POWER: 3,
    EdgeKind.SPEED_LOSS: 3,
}


class FrictionKind(IntEnum):
    """Which law gives the heat (:mod:`twin_core.friction` explains them and their coefficients)."""

    PALMGREN = 0
    TWO_PART = 1
    LINEAR = 2


FRICTION_COEFFICIENT_COUNT = {
    FrictionKind.PALMGREN: 6,
    FrictionKind.TWO_PART: 10,
    FrictionKind.LINEAR: 3,
}


@dataclass(frozen=True, slots=True)
class Coefficient:
    """A number, multiplied by a parameter if one is named."""

    factor: float
    parameter: str = ""


@dataclass(frozen=True, slots=True)
class Node:
    """A state node."""

    name: str
    capacity: Coefficient  # heat capacity in J/K


@dataclass(frozen=True, slots=True)
class Edge:
    """A thermal resistance between two nodes; the second may be a boundary.

    A boundary is :data:`AMBIENT` or one of the network's inputs, a temperature. The second of a
    heat (:data:`LOSSES`) is the input that drives it, empty for one of the speed.
    """

    first: str
    second: str
    kind: EdgeKind
    coefficients: tuple[Coefficient, ...]


@dataclass(frozen=True, slots=True)
class HeatShare:
    """A node's share of what is left of the heat after the shares named before it."""

    node: str
    fraction: Coefficient


@dataclass(frozen=True, slots=True)
class HeatSource:
    """The friction heat and where it goes."""

    #: The law.
    kind: FrictionKind
    coefficients: tuple[Coefficient, ...]
    temperature_node: str  # the node whose temperature sets the viscosity
    #: In order, each a fraction of the rest; the last one takes all that is left.
    shares: tuple[HeatShare, ...]


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor reads a weighted mean of node temperatures."""

    name: str
    weights: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Network:
    """A thermal network.

    Raises `ValueError` if the parts do not fit together; names the part and what was expected.
    """

    name: str
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    source: HeatSource
    sensors: tuple[Sensor, ...]
    #: Names of the channels that act on the network besides speed, load and ambient.
    inputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = self.node_names
        _check_unique(self.name, "node", names)
        _check_unique(self.name, "sensor", [sensor.name for sensor in self.sensors])
        _check_unique(self.name, "node or input", [*names, *self.inputs])
        if AMBIENT in names:
            raise ValueError(f"network {self.name!r}: {AMBIENT!r} is the boundary, not a node")
        for edge in self.edges:
            label = f"network {self.name!r}: edge {edge.first}-{edge.second}"
            self._check_node(edge.first, label, boundary=False)
            if edge.kind is not EdgeKind.SPEED_LOSS:
                self._check_node(edge.second, label, boundary=True)
            if edge.first == edge.second:
                raise ValueError(f"{label}: expected two different nodes")
            if edge.kind is EdgeKind.FILM and edge.second != AMBIENT:
                raise ValueError(f"{label}: a film leads to {AMBIENT!r}")
            _check_count(label, edge.kind.name, edge.coefficients, COEFFICIENT_COUNT[edge.kind])
        label = f"network {self.name!r}: heat source"
        self._check_node(self.source.temperature_node, label, boundary=False)
        for share in self.source.shares:
            self._check_node(share.node, label, boundary=False)
        if not self.source.shares:
            raise ValueError(f"{label}: expected at least one node that receives the heat")
        kind = self.source.kind
        _check_count(label, kind.name, self.source.coefficients, FRICTION_COEFFICIENT_COUNT[kind])
        for sensor in self.sensors:
            for node, _ in sensor.weights:
                self._check_node(node, f"network {self.name!r}: sensor {sensor.name}", False)
        self._check_connected()

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The inputs that are temperatures of boundaries."""
        seconds = {edge.second for edge in self.edges if edge.kind not in LOSSES}
        return tuple(name for name in self.inputs if name in seconds)

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of the state nodes in order."""
        return tuple(node.name for node in self.nodes)

    def _check_node(self, name: str, label: str, boundary: bool) -> None:
        known = (*self.node_names, *((AMBIENT, *self.inputs) if boundary else ()))
        if name not in known:
            raise ValueError(
                f"{label}: unknown node {name!r}, expected one of {', '.join(self.node_names)}"
            )

    def _check_connected(self) -> None:
        """Every node must reach the ambient, or its temperature would have no limit."""
        reached = {AMBIENT, *self.boundaries}
        grown = True
        while grown:
            grown = False
            for edge in self.edges:
                if edge.kind in LOSSES:
                    continue
                pair = {edge.first, edge.second}
                if pair & reached and not pair <= reached:
                    reached |= pair
                    grown = True
        for name in self.node_names:
            if name not in reached:
                raise ValueError(f"network {self.name!r}: node {name!r} has no path to {AMBIENT!r}")


class CompiledNetwork(NamedTuple):
    """A network as flat arrays for the kernels.

    ``*_parameter`` arrays hold the index of the parameter that multiplies the coefficient of the
    same place, or -1. Node index N (the number of nodes) is the ambient, the indices from there on
    are the other boundaries. ``inputs`` (k,) are the values at which the network's inputs are held
    where no profile gives them; ``edge_input`` is the one that drives an edge's heat,
    ``boundary_input`` (boundaries without the ambient,) those that are boundaries; -1 is none.
    """

    capacity: NDArray[np.float64]
    capacity_parameter: NDArray[np.int64]
    edge_nodes: NDArray[np.int64]
    edge_kind: NDArray[np.int64]
    edge_coefficient: NDArray[np.float64]
    edge_parameter: NDArray[np.int64]
    friction_kind: int
    friction_coefficient: NDArray[np.float64]
    friction_parameter: NDArray[np.int64]
    temperature_node: int
    share_node: NDArray[np.int64]
    share_fraction: NDArray[np.float64]
    share_parameter: NDArray[np.int64]
    edge_input: NDArray[np.int64]
    boundary_input: NDArray[np.int64]
    inputs: NDArray[np.float64]


def compile_network(network: Network, parameter_names: Sequence[str]) -> CompiledNetwork:
    """Turn *network* into flat arrays.

    `parameter_names`: names in the order of the parameter vector. Raises `ValueError` if a
    coefficient names a parameter that is not in *parameter_names*, or a parameter is used nowhere.
    """
    position = {name: index for index, name in enumerate(parameter_names)}
    used: set[str] = set()

    def bind(coefficients: Sequence[Coefficient]) -> tuple[list[float], list[int]]:
        for coefficient in coefficients:
            name = coefficient.parameter
            if name and name not in position:
                raise ValueError(
                    f"network {network.name!r}: unknown parameter {name!r}, expected one of "
                    f"{', '.join(parameter_names)}"
                )
            used.add(name)
        return (
            [coefficient.factor for coefficient in coefficients],
            [position.get(coefficient.parameter, -1) for coefficient in coefficients],
        )

    node_index = {name: index for index, name in enumerate(network.node_names)}
    capacity, capacity_parameter = bind([node.capacity for node in network.nodes])
    edge_coefficient = np.zeros((len(network.edges), MAX_COEFFICIENTS))
    edge_parameter = np.full((len(network.edges), MAX_COEFFICIENTS), -1, dtype=np.int64)
    for row, edge in enumerate(network.edges):
        factors, indices = bind(edge.coefficients)
        edge_coefficient[row, : len(factors)] = factors
        edge_parameter[row, : len(indices)] = indices
    friction, friction_parameter = bind(network.source.coefficients)
    fraction, share_parameter = bind([share.fraction for share in network.source.shares])
    unused = [name for name in parameter_names if name not in used]
    if unused:
        raise ValueError(
            f"network {network.name!r}: parameter {unused[0]!r} is not used by any coefficient"
        )
    return CompiledNetwork(
        capacity=np.array(capacity),
        capacity_parameter=np.array(capacity_parameter, dtype=np.int64),
        edge_nodes=_edge_nodes(network),
        edge_kind=np.array([int(edge.kind) for edge in network.edges], dtype=np.int64),
        edge_coefficient=edge_coefficient,
        edge_parameter=edge_parameter,
        friction_kind=int(network.source.kind),
        friction_coefficient=np.array(friction),
        friction_parameter=np.array(friction_parameter, dtype=np.int64),
        temperature_node=node_index[network.source.temperature_node],
        share_node=np.array([node_index[s.node] for s in network.source.shares], dtype=np.int64),
        share_fraction=np.array(fraction),
        share_parameter=np.array(share_parameter, dtype=np.int64),
        edge_input=_edge_inputs(network),
        boundary_input=np.array(
            [network.inputs.index(name) for name in network.boundaries], dtype=np.int64
        ),
        inputs=np.full(len(network.inputs), np.nan),
    )


def _edge_inputs(network: Network) -> NDArray[np.int64]:
    """Which of the inputs drives the loss of an edge; -1 where none does."""
    inputs = [
        network.inputs.index(edge.second)
        if edge.kind in LOSSES and edge.second in network.inputs
        else -1
        for edge in network.edges
    ]
    return np.array(inputs, dtype=np.int64)


def _edge_nodes(network: Network) -> NDArray[np.int64]:
    """Both ends of every edge: nodes, then the ambient and the other boundaries."""
    ends = [*network.node_names, AMBIENT, *network.boundaries]
    return np.array(
        [
            [ends.index(edge.first), ends.index(AMBIENT if edge.kind in LOSSES else edge.second)]
            for edge in network.edges
        ],
        dtype=np.int64,
    )


def _check_unique(network: str, what: str, names: Sequence[str]) -> None:
    twice = next((name for name, times in Counter(names).items() if times > 1), None)
    if twice is not None:
        raise ValueError(f"network {network!r}: {what} {twice!r} is defined more than once")


def _check_count(label: str, kind: str, coefficients: Sequence[Coefficient], expected: int) -> None:
    if len(coefficients) != expected:
        raise ValueError(
            f"{label}: {len(coefficients)} coefficients, expected {expected} for kind {kind}"
        )
