"""The numbers of a model as C: ``model.h`` and ``model.c``, which the fixed sources compute with.

Numbers are hexadecimal, so that not one bit is lost.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from service.offline.fmu.errors import FmuError
from service.offline.fmu.variables import FIRST_INPUT, INITIAL_TEMPERATURE_C, Variable
from service.offline.model_file import IdentifiedModel
from service.offline.simulation import initial_revolutions
from twin_core.network import (
    FRICTION_COEFFICIENT_COUNT,
    MAX_COEFFICIENTS,
    CompiledNetwork,
    EdgeKind,
    FrictionKind,
)

# What sources/laws.c knows; any other kind is refused.
EXPORTED_EDGES: Final = (
    EdgeKind.CONSTANT,
    EdgeKind.CONTACT,
    EdgeKind.CONVECTIVE,
    EdgeKind.CONVECTIVE_REFERENCE,
    EdgeKind.FILM,
    EdgeKind.SHAFT_SINK,
    EdgeKind.SPEED_POWER,
    EdgeKind.COPPER,
    EdgeKind.POWER,
    EdgeKind.SPEED_LOSS,
)
EXPORTED_FRICTION: Final = (FrictionKind.PALMGREN, FrictionKind.TWO_PART, FrictionKind.LINEAR)
_FRICTION_COEFFICIENTS = max(FRICTION_COEFFICIENT_COUNT.values())


def header(identified: IdentifiedModel, token: str) -> str:
    """Return ``model.h``: sizes, kinds and the token."""
    net = identified.model.compiled
    edges = [EdgeKind(kind) for kind in net.edge_kind.tolist()]
    friction = FrictionKind(net.friction_kind)
    has_copper = EdgeKind.COPPER in edges
    sizes = {
        "NODES": net.capacity.size,
        "EDGES": len(edges),
        "FILMS": edges.count(EdgeKind.FILM),
        "SHARES": net.share_node.size,
        "BOUNDARIES": net.boundary_input.size,
        "OWN_INPUTS": len(identified.model.input_names),
        "PARAMETERS": identified.model.parameters.size,
        "SENSORS": len(_other_sensors(identified)),
        "FRICTION_KIND": friction.name,
        "LUBRICANT_NODE": net.temperature_node,
        # Copper may heat itself faster than it cools; nothing else has a rate below zero.
        "BOUNDLESS_RATES": int(has_copper),
        # Only heat that depends on temperature can run away.
        "BOUNDLESS_TEMPERATURES": int(friction is FrictionKind.LINEAR and not has_copper),
    }
    lines = ["/* Sizes of one identified model. */", "#ifndef MODEL_H", "#define MODEL_H", ""]
    lines += [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [f'#define TOKEN "{token}"', "", "#endif", ""]
    return "\n".join(lines)


def numbers(identified: IdentifiedModel, variables: Sequence[Variable]) -> str:
    """Return ``model.c``: the network's coefficients, the sensors' weights and all starts.

    Raises `FmuError` if a part of the network is of a kind that the C sources do not know.
    """
    model, net = identified.model, identified.model.compiled
    for kind in net.edge_kind.tolist():
        if EdgeKind(kind) not in EXPORTED_EDGES:
            raise FmuError(f"network {model.name!r}: no FMU with edges {EdgeKind(kind).name}")
    if FrictionKind(net.friction_kind) not in EXPORTED_FRICTION:
        name = FrictionKind(net.friction_kind).name
        raise FmuError(f"network {model.name!r}: no FMU with the friction law {name}")
    inputs = [0.0] * (3 + len(model.input_names))
    for variable in variables:
        if variable.causality == "input":
            inputs[variable.reference - FIRST_INPUT] = variable.start or 0.0
    rows = [model.sensor_row(name).tolist() for name in _other_sensors(identified)]
    missing = _FRICTION_COEFFICIENTS - net.friction_coefficient.size
    friction = [*_coefficients(net.friction_coefficient, net.friction_parameter)]
    friction += [_coefficient(0.0, -1)] * missing
    parts = [
        "/* Numbers of one identified model. */",
        '#include "instance.h"',
        "",
        _array("Coefficient", "CAPACITY", _coefficients(net.capacity, net.capacity_parameter)),
        _array("Edge", "EDGE", _edges(net)),
        _array("Coefficient", "FRICTION", friction),
        _array("Share", "SHARE", _shares(net)),
        _array("int", "BOUNDARY_INPUT", [str(k) for k in net.boundary_input.tolist()] or ["-1"]),
        _array(
            "double",
            "SENSOR",
            [_row(_hexadecimal(row)) for row in rows or [[0.0] * net.capacity.size]],
            "[NODES]",
        ),
        _array("double", "INPUT_START", _hexadecimal(inputs)),
        _array("double", "PARAMETER_START", _hexadecimal(identified.values.tolist())),
        _array(
            "double",
            "INITIAL_START",
            _hexadecimal([INITIAL_TEMPERATURE_C, initial_revolutions(identified)]),
        ),
    ]
    return "\n".join(parts)


def _other_sensors(identified: IdentifiedModel) -> list[str]:
    """Sensors that are no nodes; the others are states."""
    model = identified.model
    return [name for name in model.sensor_names if name not in model.node_names]


def _edges(net: CompiledNetwork) -> Iterable[str]:
    for edge, kind in enumerate(net.edge_kind.tolist()):
        first, second = net.edge_nodes[edge].tolist()
        coefficients = _coefficients(net.edge_coefficient[edge], net.edge_parameter[edge])
        head = (EdgeKind(kind).name, str(first), str(second), str(int(net.edge_input[edge])))
        yield _row([*head, _row(list(coefficients)[:MAX_COEFFICIENTS])])


def _shares(net: CompiledNetwork) -> Iterable[str]:
    fractions = _coefficients(net.share_fraction, net.share_parameter)
    for node, fraction in zip(net.share_node.tolist(), fractions, strict=True):
        yield _row([str(node), fraction])


def _coefficients(factors: Iterable[float], parameters: Iterable[int]) -> Iterable[str]:
    for factor, parameter in zip(factors, parameters, strict=True):
        yield _coefficient(float(factor), int(parameter))


def _coefficient(factor: float, parameter: int) -> str:
    return _row([factor.hex(), str(parameter)])


def _hexadecimal(values: Iterable[float]) -> list[str]:
    return [float(value).hex() for value in values]


def _row(cells: Sequence[str]) -> str:
    return f"{{{', '.join(cells)}}}"


def _array(kind: str, name: str, cells: Iterable[str], inner: str = "") -> str:
    body = "".join(f"    {cell},\n" for cell in cells)
    return f"const {kind} {name}[]{inner} = {{\n{body}}};\n"
