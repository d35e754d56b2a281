"""The variables of an FMU: names, units, starts, and the numbers by which C knows them."""

from dataclasses import dataclass
from typing import Final, Literal

from adapters.configuration import first_repeated
from service.domain.channels import AMBIENT, LOAD, SPEED
from service.offline.fmu.errors import FmuError
from service.offline.model_file import IdentifiedModel
from service.offline.simulation import initial_revolutions, output_names

Causality = Literal["input", "output", "local", "parameter", "independent"]
Variability = Literal["continuous", "fixed", "tunable"]

# As in sources/instance.h.
FIRST_DERIVATIVE: Final = 1000
FIRST_INPUT: Final = 2000
FIRST_PARAMETER: Final = 3000
INITIAL_TEMPERATURE: Final = 4000
INITIAL_REVOLUTIONS: Final = 4001
INDEPENDENT_TIME: Final = 9999

INITIAL_TEMPERATURE_C: Final = 20.0
"""Start of `initial_temperature_c` and of temperatures outside, unless another is given."""

_OPERATION = ((SPEED, "rpm", "speed of the shaft"), (LOAD, "N", "load on the bearing"))
_BY_ENDING = {"_c": "degC", "_a": "A", "_w": "W", "_v": "V", "_rpm": "rpm", "_n": "N"}


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the model description.

    - ``name``, ``reference``: unique; the reference is the one of sources/instance.h.
    - ``causality``, ``variability``: as the standard has them.
    - ``start``: None where the model calculates it.
    - ``unit``: empty without one.
    - ``state``: reference of the continuous state of which this is the derivative, or None.
    - ``range``: smallest and largest value that makes sense, or None.
    """

    name: str
    reference: int
    causality: Causality
    variability: Variability
    description: str
    unit: str = ""
    start: float | None = None
    state: int | None = None
    range: tuple[float, float] | None = None


def variables_of(identified: IdentifiedModel) -> tuple[Variable, ...]:
    """List the variables of a model: outputs, other states, derivatives, inputs, parameters.

    Raises `FmuError` if two of them have the same name.
    """
    model = identified.model
    nodes = model.node_names
    sensors = [name for name in output_names(identified) if name not in nodes]
    found = [
        Variable(
            name,
            nodes.index(name) if name in nodes else len(nodes) + 1 + sensors.index(name),
            "output",
            "continuous",
            "true temperature, without any error of a sensor",
            "degC",
        )
        for name in output_names(identified)
    ]
    turned = "revolutions since the grease was fresh"
    found.append(Variable("revolutions", len(nodes), "local", "continuous", turned))
    for reference, name in enumerate((*nodes, "revolutions")):
        unit = "1/s" if name == "revolutions" else "K/s"
        found.append(
            Variable(
                f"der({name})",
                FIRST_DERIVATIVE + reference,
                "local",
                "continuous",
                f"derivative of {name}",
                unit,
                state=reference,
            )
        )
    found += _inputs(identified)
    found += _parameters(identified)
    names = [variable.name for variable in found]
    taken = first_repeated(["time", *names])
    if taken is not None:
        raise FmuError(
            f"network {model.name!r}: the name {taken!r} is taken in an FMU; expected another "
            "name of the channel"
        )
    return tuple(found)


def _inputs(identified: IdentifiedModel) -> list[Variable]:
    """Operating point, as far as the network asks for it, and a network's own channels."""
    section = identified.machine.network
    unused = () if section is None else section.unused_channels
    boundaries = identified.model.network.boundaries
    found = [
        Variable(name, FIRST_INPUT + place, "input", "continuous", text, unit, 0.0)
        for place, (name, unit, text) in enumerate(_OPERATION)
        if name not in unused
    ]
    found.append(
        Variable(
            AMBIENT,
            FIRST_INPUT + len(_OPERATION),
            "input",
            "continuous",
            "temperature of the surroundings",
            "degC",
            INITIAL_TEMPERATURE_C,
        )
    )
    for place, name in enumerate(identified.model.input_names, len(_OPERATION) + 1):
        is_boundary = name in boundaries
        found.append(
            Variable(
                name,
                FIRST_INPUT + place,
                "input",
                "continuous",
                "temperature of a boundary" if is_boundary else "drives a loss",
                next((unit for end, unit in _BY_ENDING.items() if name.endswith(end)), ""),
                INITIAL_TEMPERATURE_C if is_boundary else 0.0,
            )
        )
    return found


def _parameters(identified: IdentifiedModel) -> list[Variable]:
    """The initial state, then what was identified."""
    found = [
        Variable(
            "initial_temperature_c",
            INITIAL_TEMPERATURE,
            "parameter",
            "fixed",
            "temperature of the whole machine at the start",
            "degC",
            INITIAL_TEMPERATURE_C,
        ),
        Variable(
            "initial_revolutions",
            INITIAL_REVOLUTIONS,
            "parameter",
            "fixed",
            "revolutions since the grease was fresh, at the start",
            "",
            initial_revolutions(identified),
        ),
    ]
    parameters = identified.model.parameters
    ranges = zip(parameters.lower.tolist(), parameters.upper.tolist(), strict=True)
    for place, (one, value, (low, high)) in enumerate(
        zip(parameters.parameters, identified.values.tolist(), ranges, strict=True)
    ):
        found.append(
            Variable(
                f"parameter.{one.name}",
                FIRST_PARAMETER + place,
                "parameter",
                "tunable",
                one.description,
                "" if one.unit == "-" else one.unit,
                value,
                range=(min(low, value), max(high, value)),
            )
        )
    return found
