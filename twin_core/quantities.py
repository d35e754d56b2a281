"""What a parameter vector means physically: groups of parameters, and quantities at a point.

Parameters of a fit trade against each other; the physical quantities that they make up do so much
less. Which group a parameter belongs to follows from where the network uses it, so that any
network has groups and quantities without naming its parameters here.
"""

import contextlib
import functools
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from twin_core.network import AMBIENT, LOSSES, Edge, EdgeKind
from twin_core.network_model import NetworkModel
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import (
    SimulationError,
    heat_balance_slopes_w_k,
    heat_balance_w,
    kernels,
    steady_state,
)

FloatArray = NDArray[np.float64]

Group = Literal[
    "friction",
    "heat split",
    "contact",
    "convection inside",
    "convection outside",
    "shaft sink",
    "joints",
    "capacity",
]
GROUPS: tuple[Group, ...] = get_args(Group)

_AMBIENT_C = 22.0
_DIFFERENCE_Z = 1e-2
_SMALLEST = 1e-9


@dataclass(frozen=True, slots=True)
class ReferencePoint:
    """Where quantities are compared: speed in rpm, load in N, lubricant temperature in degC."""

    speed_rpm: float
    load_n: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical quantity of a machine at a reference point; always positive."""

    name: str  # unique, such as ``friction``, ``contact`` or the name of a sensor
    group: Group | None  # the parameters that make it up; None for one that depends on all of them
    unit: str
    text: str  # for people, with the point


def parameter_groups(model: NetworkModel) -> dict[str, Group]:
    """Group of every parameter, by where the network uses it.

    A parameter that is used in several places belongs to the first of them in the order of
    `GROUPS`.
    """
    network = model.network
    found: dict[str, Group] = {}
    uses: list[tuple[str, Group]] = [
        (coefficient.parameter, "friction") for coefficient in network.source.coefficients
    ]
    uses += [(share.fraction.parameter, "heat split") for share in network.source.shares]
    uses += [
        (coefficient.parameter, "friction" if edge.kind in LOSSES else _group_of(edge))
        for edge in network.edges
        for coefficient in edge.coefficients
    ]
    uses += [(node.capacity.parameter, "capacity") for node in network.nodes]
    for name, group in sorted(uses, key=lambda use: GROUPS.index(use[1])):
        found.setdefault(name, group)
    return {name: found[name] for name in model.parameters.names}


def _group_of(edge: Edge) -> Group:
    if edge.kind is EdgeKind.CONTACT:
        return "contact"
    if edge.kind is EdgeKind.SHAFT_SINK:
        return "shaft sink"
    if edge.second == AMBIENT:
        return "convection outside"
    return "joints" if edge.kind is EdgeKind.CONSTANT else "convection inside"


def reference_point(
    model: NetworkModel, z: FloatArray, speed_rpm: float, load_n: float
) -> ReferencePoint:
    """Reference point at an operating point: with the lubricant as warm as it gets there.

    `z` (p,) standard coordinates. The temperature is in whole tens of degC, so that it stays the
    same from version to version; 60 where the model has no steady state.
    """
    values = model.parameters.values_from_z(z)
    model = model.at_reference(_AMBIENT_C)
    node = model.node_names.index(model.network.source.temperature_node)
    try:
        warm = steady_state(model, values, speed_rpm, load_n, _AMBIENT_C, LONG_RUN_IN)[node]
    except SimulationError:
        warm = 60.0
    return ReferencePoint(speed_rpm, load_n, float(np.round(warm, -1)))


# Comparing two versions asks for them hundreds of times.
@functools.lru_cache(maxsize=32)
def quantities(model: NetworkModel, point: ReferencePoint) -> tuple[Quantity, ...]:
    """The quantities of a model: friction, conductances by group, capacity, steady rises.

    A group that has no parameter of its own has no quantity: it cannot move.
    """
    groups = set(parameter_groups(model).values())
    at = f"at {point.speed_rpm:.0f} rpm, {point.load_n:.0f} N"
    described = [
        Quantity("friction", "friction", "W", f"friction heat {at}, {point.temperature_c:.0f} degC")
    ]
    texts: dict[Group, str] = {
        "contact": f"contact conductance {at}",
        "convection inside": f"conductance of the films in the bearing {at}",
        "convection outside": "conductance from the outside to the air at a difference of 12 K",
        "shaft sink": f"conductance from the shaft ends to the air {at}",
        "joints": "conductance of the joints",
    }
    described += [Quantity(group, group, "W/K", text) for group, text in texts.items()]
    described.append(Quantity("capacity", "capacity", "J/K", "heat capacity of all parts"))
    described = [one for one in described if one.group in groups]
    described += [
        Quantity(name, None, "K", f"steady rise of {name} above ambient {at}")
        for name in model.sensor_names
    ]
    return tuple(described)


def evaluate(model: NetworkModel, z: FloatArray, point: ReferencePoint) -> FloatArray:
    """Values of `quantities` at one parameter vector.

    `z` (p,) standard coordinates; `z` (p,) standard coordinates; `point`: running-in counts as
    over. Returns (k,) in the units of the quantities; NaN for steady rises that do not exist.
    """
    found = _without_rises(model, z, point)
    at_rest = model.at_reference(_AMBIENT_C)
    try:
        steady = _steady_c(at_rest, at_rest.parameters.values_from_z(z), point)
    except SimulationError:
        return found
    rises = model.sensor_matrix(model.sensor_names) @ (steady - _AMBIENT_C)
    found[-rises.size :] = np.maximum(rises, _SMALLEST)
    return found


def _steady_c(model: NetworkModel, values: FloatArray, point: ReferencePoint) -> FloatArray:
    return steady_state(model, values, point.speed_rpm, point.load_n, _AMBIENT_C, LONG_RUN_IN)


def _without_rises(model: NetworkModel, z: FloatArray, point: ReferencePoint) -> FloatArray:
    """Values of `quantities`, NaN for the steady rises, which come last."""
    model = model.at_reference(_AMBIENT_C)
    values = model.parameters.values_from_z(z)
    capacity, coefficient, _, _ = kernels.bind_network(model.compiled, values)
    conductance = kernels.edge_conductances(
        model.compiled, coefficient, point.speed_rpm, point.load_n
    )
    of_group: dict[Group, list[float]] = {group: [] for group in GROUPS}
    for number, edge in enumerate(model.network.edges):
        if edge.kind not in LOSSES and any(one.parameter for one in edge.coefficients):
            of_group[_group_of(edge)].append(float(conductance[number]))
    warm = np.full(len(model.node_names), point.temperature_c)
    _, heat_w = heat_balance_w(
        model, values, warm, point.speed_rpm, point.load_n, _AMBIENT_C, LONG_RUN_IN
    )
    found = []
    for one in quantities(model, point):
        if one.name == "friction":
            found.append(heat_w)
        elif one.name == "capacity":
            found.append(float(capacity.sum()))
        elif one.group is None:
            found.append(np.nan)
        elif one.group == "joints":
            # joints lie in series as a rule: the mean of their resistances, not the sum
            resistances = [1.0 / each for each in of_group["joints"]]
            found.append(len(resistances) / sum(resistances))
        else:
            found.append(sum(of_group[one.group]))
    return np.asarray(np.maximum(np.array(found), _SMALLEST))


def log_gradient(
    model: NetworkModel,
    z: FloatArray,
    point: ReferencePoint,
    positions: NDArray[np.intp] | None = None,
) -> FloatArray:
    """Derivatives (k, p) of the logarithms of `quantities` by the standard coordinates.

    `positions`: which coordinates, in order; all by default.
    """
    columns = []
    rises = _RiseSlopes(model, z, point)
    for position in range(z.size) if positions is None else positions.tolist():
        step = np.zeros(z.size)
        step[position] = _DIFFERENCE_Z
        high = np.minimum(z + step, model.parameters.z_upper)
        low = np.maximum(z - step, model.parameters.z_lower)
        span = max(float(high[position] - low[position]), _DIFFERENCE_Z)
        logarithms = (np.log(_without_rises(model, end, point)) for end in (high, low))
        column = np.subtract(*logarithms) / span
        column[-len(model.sensor_names) :] = rises.along(high, low, span)
        columns.append(column)
    return np.array(columns).T


class _RiseSlopes:
    """Derivatives of the logarithms of the steady rises, by those of the heat balance there."""

    def __init__(self, model: NetworkModel, z: FloatArray, point: ReferencePoint) -> None:
        self._model = model.at_reference(_AMBIENT_C)
        self._at = (point.speed_rpm, point.load_n, _AMBIENT_C, LONG_RUN_IN)
        values = model.parameters.values_from_z(z)
        self._weights: FloatArray | None = None
        with contextlib.suppress(SimulationError, np.linalg.LinAlgError):
            self._steady_c = _steady_c(self._model, values, point)
            slopes = heat_balance_slopes_w_k(self._model, values, self._steady_c, *self._at)
            sensors = model.sensor_matrix(model.sensor_names)
            rises = np.maximum(sensors @ (self._steady_c - _AMBIENT_C), _SMALLEST)
            # The balance stays closed: d(temperatures) = -slopes^-1 d(net heat).
            self._weights = -np.linalg.solve(slopes.T, sensors.T).T / rises[:, None]

    def along(self, high: FloatArray, low: FloatArray, span: float) -> FloatArray:
        """Derivatives (sensors,) from one end of a step of the coordinates to the other."""
        if self._weights is None:
            return np.full(len(self._model.sensor_names), np.nan)
        values_from_z = self._model.parameters.values_from_z
        (above, _), (below, _) = (
            heat_balance_w(self._model, values_from_z(end), self._steady_c, *self._at)
            for end in (high, low)
        )
        return np.asarray(self._weights @ (above - below) / span)
