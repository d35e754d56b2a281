"""Names, coefficients and parameters of a network in the configuration."""

import re
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, PositiveFloat, model_validator

from service.domain.channels import OPERATING_CHANNELS
from service.domain.section import Section
from twin_core.network import AMBIENT, Coefficient
from twin_core.parameters import Parameter

_CHANNEL = re.compile(r"t_[a-z0-9]+(_[a-z0-9]+)*_c")
_BOUNDARY = re.compile(r"(?!t_)[a-z][a-z0-9]*(_[a-z0-9]+)*_c")
_INPUT = re.compile(r"(?!t_)[a-z][a-z0-9]*(_[a-z0-9]+)*")
_PARAMETER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def _temperature_name(name: str) -> str:
    if not _CHANNEL.fullmatch(name):
        raise ValueError("expected the name of a temperature, such as t_housing_c")
    return name


def _parameter_name(name: str) -> str:
    if not _PARAMETER.fullmatch(name):
        raise ValueError("expected letters, digits and underscores, a letter first")
    return name


def _end_of_edge(name: str) -> str:
    if name == AMBIENT or (_BOUNDARY.fullmatch(name) and name not in OPERATING_CHANNELS):
        return name
    try:
        return _temperature_name(name)
    except ValueError:
        raise ValueError(
            f"expected a node such as t_housing_c, {AMBIENT!r}, or the channel of another "
            "boundary's temperature such as coolant_c"
        ) from None


def _input_name(name: str) -> str:
    if not _INPUT.fullmatch(name) or name in OPERATING_CHANNELS:
        raise ValueError("expected the name of a channel of its own, such as current_a or power_w")
    return name


TemperatureName = Annotated[str, AfterValidator(_temperature_name)]
ParameterName = Annotated[str, AfterValidator(_parameter_name)]
InputName = Annotated[str, AfterValidator(_input_name)]
EdgeEnd = Annotated[str, AfterValidator(_end_of_edge)]


class CoefficientSection(Section):
    """A number, times a parameter if one is named."""

    factor: float = 1.0
    parameter: str = ""

    def coefficient(self) -> Coefficient:
        """Return it as the network knows it."""
        return Coefficient(self.factor, self.parameter)


def _coefficient(value: object) -> object:
    if isinstance(value, str):
        return CoefficientSection(parameter=_parameter_name(value))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return CoefficientSection(factor=value)
    if not isinstance(value, Mapping | CoefficientSection):
        raise ValueError(
            "expected a number, the name of a parameter, or { parameter = ..., factor = ... }"
        )
    return value


def positive(value: CoefficientSection) -> CoefficientSection:
    """Refuse a coefficient that is not above 0."""
    if not value.factor > 0.0:
        raise ValueError(f"the factor is {value.factor:g}, expected > 0")
    return value


def not_negative(value: CoefficientSection) -> CoefficientSection:
    """Refuse a coefficient below 0."""
    if not value.factor >= 0.0:
        raise ValueError(f"the factor is {value.factor:g}, expected 0 or more")
    return value


Number = Annotated[CoefficientSection, BeforeValidator(_coefficient)]
Positive = Annotated[Number, AfterValidator(positive)]
NotNegative = Annotated[Number, AfterValidator(not_negative)]
ZERO = CoefficientSection(factor=0.0)


class ParameterSection(Section):
    """An unknown: its prior, and its physical bounds."""

    unit: str = "-"
    description: str = ""
    transform: Literal["log", "linear"] = "log"
    centre: float
    spread: PositiveFloat
    lower: float | None = None
    upper: float | None = None

    @model_validator(mode="after")
    def _make_a_parameter(self) -> Self:
        self.parameter("x")
        return self

    def parameter(self, name: str) -> Parameter:
        """Return it as the model knows it."""
        bounds = {k: v for k, v in (("lower", self.lower), ("upper", self.upper)) if v is not None}
        return Parameter(
            name, self.unit, self.description, self.transform, self.centre, self.spread, **bounds
        )
