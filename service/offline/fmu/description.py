"""``modelDescription.xml`` of FMI 2.0 and 3.0, and the build description of 3.0."""

from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from service.offline.fmu.variables import INDEPENDENT_TIME, Variable

IDENTIFIER: Final = "bearing_twin"
"""Name of the library, and of the model in C."""

_TOOL = "Bearing Twin"
_BASE_UNITS = {
    "degC": {"K": "1", "offset": "273.15"},
    "K/s": {"K": "1", "s": "-1"},
    "1/s": {"s": "-1"},
    "rpm": {"rad": "1", "s": "-1", "factor": "0.10471975511965977"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "W": {"kg": "1", "m": "2", "s": "-3"},
    "W/K": {"kg": "1", "m": "2", "s": "-3", "K": "-1"},
    "K/W": {"kg": "-1", "m": "-2", "s": "3", "K": "1"},
    "J/K": {"kg": "1", "m": "2", "s": "-2", "K": "-1"},
    "A": {"A": "1"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
}
# Derivatives are smooth but for changes of the inputs; a solver of higher order pays.
_EXPERIMENT = {"startTime": "0", "stopTime": "3600", "tolerance": "1e-10", "stepSize": "60"}

#: As in sources/fmi2.c and fmi3.c.
_LOG_CATEGORY = {"name": "logStatusError", "description": "why something is refused"}


def description(
    fmi: int, name: str, token: str, variables: Sequence[Variable], sources: Sequence[str]
) -> bytes:
    """Return ``modelDescription.xml``.

    ``token``: by which the library knows whether the description is its own; ``sources``: names of
    the C files, which the description of FMI 2.0 lists.
    """
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0" if fmi == 2 else "3.0",
            "modelName": name,
            "guid" if fmi == 2 else "instantiationToken": token,
            "description": "Temperatures of a rolling bearing from an identified thermal network",
            "generationTool": _TOOL,
            "variableNamingConvention": "structured",
        },
    )
    if fmi == 2:
        root.set("numberOfEventIndicators", "0")
    copies = {
        "canGetAndSetFMUstate" if fmi == 2 else "canGetAndSetFMUState": "true",
        "canSerializeFMUstate" if fmi == 2 else "canSerializeFMUState": "true",
    }
    for kind in ("ModelExchange", "CoSimulation"):
        interface = SubElement(root, kind, {"modelIdentifier": IDENTIFIER} | copies)
        if fmi == 2:  # it allocates its memory itself
            interface.set("canNotUseMemoryManagementFunctions", "true")
        if kind == "CoSimulation":
            interface.set("canHandleVariableCommunicationStepSize", "true")
        if fmi == 2:
            files = SubElement(interface, "SourceFiles")
            for source in sources:
                SubElement(files, "File", {"name": source})
    units = SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables if variable.unit}):
        definition = SubElement(units, "Unit", {"name": unit})
        if unit in _BASE_UNITS:
            SubElement(definition, "BaseUnit", _BASE_UNITS[unit])
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", _LOG_CATEGORY)
    SubElement(root, "DefaultExperiment", _EXPERIMENT)
    listed = SubElement(root, "ModelVariables")
    for variable in variables:
        if fmi == 2:
            _scalar_2(listed, variable, variables)
        else:
            _float64_3(listed, variable)
    if fmi == 3:
        time = {"name": "time", "valueReference": str(INDEPENDENT_TIME)}
        kind_of_time = {"causality": "independent", "variability": "continuous"}
        SubElement(listed, "Float64", time | kind_of_time)
    structure = SubElement(root, "ModelStructure")
    (_structure_2 if fmi == 2 else _structure_3)(structure, variables)
    return _document(root)


def build_description(sources: Sequence[str]) -> bytes:
    """Return ``buildDescription.xml``, by which an importer of FMI 3.0 compiles the sources."""
    root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = SubElement(root, "BuildConfiguration", {"modelIdentifier": IDENTIFIER})
    files = SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for source in sources:
        SubElement(files, "SourceFile", {"name": source})
    SubElement(configuration, "Library", {"name": "m", "external": "true"})
    return _document(root)


def _document(root: Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def _attributes(variable: Variable) -> dict[str, str]:
    found = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    # The standard forbids it for inputs, which have a start and nothing else.
    if variable.causality != "input":
        found["initial"] = "calculated" if variable.start is None else "exact"
    return found


def _value(variable: Variable) -> dict[str, str]:
    found = {"unit": variable.unit} if variable.unit else {}
    if variable.range is not None:
        low, high = variable.range
        found |= {"min": repr(low), "max": repr(high)}
    return found if variable.start is None else found | {"start": repr(float(variable.start))}


def _scalar_2(listed: Element, variable: Variable, variables: Sequence[Variable]) -> None:
    scalar = SubElement(listed, "ScalarVariable", _attributes(variable))
    value = _value(variable)
    if variable.state is not None:
        # FMI 2.0 names variables by their place, from 1 on.
        value["derivative"] = str(_place(variables, variable.state))
    SubElement(scalar, "Real", value)


def _float64_3(listed: Element, variable: Variable) -> None:
    value = _value(variable)
    if variable.state is not None:
        value["derivative"] = str(variable.state)
    SubElement(listed, "Float64", _attributes(variable) | value)


def _place(variables: Sequence[Variable], reference: int) -> int:
    return next(k for k, one in enumerate(variables, 1) if one.reference == reference)


def _unknowns(variables: Sequence[Variable]) -> tuple[list[Variable], list[Variable]]:
    """Outputs and derivatives."""
    outputs = [one for one in variables if one.causality == "output"]
    return outputs, [one for one in variables if one.state is not None]


def _initial(variables: Sequence[Variable]) -> list[Variable]:
    """What the model calculates at the start."""
    return [one for one in variables if one.start is None]


def _structure_2(structure: Element, variables: Sequence[Variable]) -> None:
    outputs, derivatives = _unknowns(variables)
    for name, listed in (
        ("Outputs", outputs),
        ("Derivatives", derivatives),
        ("InitialUnknowns", _initial(variables)),
    ):
        part = SubElement(structure, name)
        for variable in listed:
            SubElement(part, "Unknown", {"index": str(_place(variables, variable.reference))})


def _structure_3(structure: Element, variables: Sequence[Variable]) -> None:
    outputs, derivatives = _unknowns(variables)
    for name, listed in (
        ("Output", outputs),
        ("ContinuousStateDerivative", derivatives),
        ("InitialUnknown", _initial(variables)),
    ):
        for variable in listed:
            SubElement(structure, name, {"valueReference": str(variable.reference)})
