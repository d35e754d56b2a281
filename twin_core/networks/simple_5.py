"""The simple network with which Wang et al. check their identification (section 5.1, figure 7).

Five nodes, the fifth being the ambient, seven resistances, a heat that is linear in speed and load,
seven unknowns k1 to k7. Taken from the paper (Appl. Sci. 2025, 15(12), 6671): the unknowns and
their target values, which resistance each of them describes, the heat going to nodes 2 and 3 in
equal parts, sensors on nodes 1 and 2. The paper gives neither the topology nor the known values,
the units of speed and load, the bounds or the profile; those here are ours: a ladder from the
shaft (node 4) to the housing (node 1), n in 10 rpm and F in 10 N, which makes every target value
matter, and five operating points of 90 minutes each.
"""

import math

import numpy as np

from twin_core.network import (
    AMBIENT,
    Coefficient,
    Edge,
    EdgeKind,
    FrictionKind,
    HeatShare,
    HeatSource,
    Network,
    Node,
    Sensor,
    compile_network,
)
from twin_core.network_model import NetworkModel
from twin_core.parameters import Parameter, ParameterSet
from twin_core.simulation import OperatingProfile

TARGETS = {"k1": 1.0, "k2": 0.29, "k3": 50.0, "k4": 0.2, "k5": 0.35, "k6": 0.5, "k7": 0.18}
"""Target values of the paper."""

AMBIENT_C = 22.6

SPEED_UNIT_RPM = 10.0
"""The paper's k1 and k6 count speed in tens of rpm (our reading)."""

_LOAD_UNIT_N = 10.0

# Each box spans two decades around a centre that is off the target by these factors: an optimum
# in the middle of its box would flatter every method that averages over its population.
_OFF_CENTRE = {"k1": 0.6, "k2": 1.7, "k3": 0.7, "k4": 1.5, "k5": 0.55, "k6": 1.6, "k7": 0.65}
_HALF_BOX = 10.0
_BOX_Z = 3.0

_UNITS = {
    "k1": ("W/(10 rpm)", "heat per speed"),
    "k2": ("W/(10 N)", "heat per load"),
    "k3": ("W", "heat at rest"),
    "k4": ("K/W", "R2, between nodes 2 and 3"),
    "k5": ("K/W", "R3, between nodes 3 and 4"),
    "k6": ("K/W", "R6 from the shaft to ambient, at 10 rpm"),
    "k7": ("-", "R6: exponent of speed"),
}

_CAPACITY_J_K = (900.0, 400.0, 350.0, 700.0)

_POINTS = ((1000.0, 10e3), (3000.0, 4e3), (5000.0, 12e3), (2000.0, 14e3), (4000.0, 6e3))
_MINUTES_PER_POINT = 90


def simple_5_network() -> Network:
    """Nodes 1 (housing), 2, 3 and 4 (shaft) in a ladder, both ends open to the ambient."""

    def edge(first: int, second: int, resistance: Coefficient) -> Edge:
        return Edge(_node(first), _node(second), EdgeKind.CONSTANT, (resistance,))

    return Network(
        "simple-5",
        tuple(
            Node(_node(number), Coefficient(capacity))
            for number, capacity in enumerate(_CAPACITY_J_K, start=1)
        ),
        (
            edge(1, 2, Coefficient(0.05)),  # R1
            edge(2, 3, Coefficient(1.0, "k4")),  # R2
            edge(3, 4, Coefficient(1.0, "k5")),  # R3
            edge(1, 3, Coefficient(0.60)),  # R4
            edge(2, 4, Coefficient(0.80)),  # R5
            Edge(  # R6
                _node(4),
                _node(5),
                EdgeKind.SPEED_POWER,
                (Coefficient(1.0, "k6"), Coefficient(SPEED_UNIT_RPM), Coefficient(1.0, "k7")),
            ),
            edge(1, 5, Coefficient(0.08)),  # R7
        ),
        HeatSource(
            FrictionKind.LINEAR,
            (
                Coefficient(1.0 / SPEED_UNIT_RPM, "k1"),
                Coefficient(1.0 / _LOAD_UNIT_N, "k2"),
                Coefficient(1.0, "k3"),
            ),
            _node(2),
            (HeatShare(_node(2), Coefficient(0.5)), HeatShare(_node(3), Coefficient(1.0))),
        ),
        tuple(Sensor(_node(number), ((_node(number), 1.0),)) for number in (1, 2)),
    )


def simple_5_model() -> NetworkModel:
    """The network with k1 to k7, each within two decades; z = -3 and z = 3 are the bounds."""
    parameters = []
    for name, target in TARGETS.items():
        unit, description = _UNITS[name]
        centre = target * _OFF_CENTRE[name]
        parameters.append(
            Parameter(
                name,
                unit,
                description,
                "log",
                centre,
                math.log(_HALF_BOX) / _BOX_Z,
                centre / _HALF_BOX,
                centre * _HALF_BOX,
            )
        )
    names = [parameter.name for parameter in parameters]
    network = simple_5_network()
    return NetworkModel(
        network.name, network, ParameterSet(tuple(parameters)), compile_network(network, names)
    )


def target_values() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The target values in the order of the model's parameters, (7,)."""
    return np.array(list(TARGETS.values()))


def simple_5_profile() -> OperatingProfile:
    """Five operating points of 90 minutes each, sampled every minute: 451 rows."""
    speed, load = np.repeat(np.array(_POINTS), _MINUTES_PER_POINT, axis=0).T
    count = speed.size + 1
    return OperatingProfile(
        np.arange(count) * 60.0,
        np.append(speed, speed[-1]),
        np.append(load, load[-1]),
        np.full(count, AMBIENT_C),
    )


def _node(number: int) -> str:
    return AMBIENT if number == len(_CAPACITY_J_K) + 1 else f"t_node_{number}_c"
