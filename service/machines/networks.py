"""A thermal network in the configuration: nodes, edges, a heat source, sensors, parameters.

docs/networks.md explains every key. Whatever is wrong is found here, before anything starts.
"""

import re
from collections.abc import Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from service.configuration import Section, SettingsError, describe, read_toml
from twin_core.network import (
    AMBIENT,
    Coefficient,
    CompiledNetwork,
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
from twin_core.network_model import ErrorModel
from twin_core.parameters import Parameter, ParameterSet

BEARING_14 = "bearing-14"
"""Name of the network that comes with the product; any other is the user's own."""

folder_of_files: ContextVar[Path] = ContextVar("folder_of_files", default=Path())
"""Where the path of a network's file begins: the folder of the configuration."""

_CHANNEL = re.compile(r"t_[a-z0-9]+(_[a-z0-9]+)*_c")
_PARAMETER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_MOST_NODES = 60


def _temperature_name(name: str) -> str:
    if not _CHANNEL.fullmatch(name):
        raise ValueError("expected the name of a temperature, such as t_housing_c")
    return name


def _parameter_name(name: str) -> str:
    if not _PARAMETER.fullmatch(name):
        raise ValueError("expected letters, digits and underscores, a letter first")
    return name


def _end_of_edge(name: str) -> str:
    return name if name == AMBIENT else _temperature_name(name)


TemperatureName = Annotated[str, AfterValidator(_temperature_name)]
ParameterName = Annotated[str, AfterValidator(_parameter_name)]
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


def _positive(value: CoefficientSection) -> CoefficientSection:
    if not value.factor > 0.0:
        raise ValueError(f"the factor is {value.factor:g}, expected > 0")
    return value


def _not_negative(value: CoefficientSection) -> CoefficientSection:
    if not value.factor >= 0.0:
        raise ValueError(f"the factor is {value.factor:g}, expected 0 or more")
    return value


Number = Annotated[CoefficientSection, BeforeValidator(_coefficient)]
Positive = Annotated[Number, AfterValidator(_positive)]
NotNegative = Annotated[Number, AfterValidator(_not_negative)]
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


class NodeSection(Section):
    """A lump of uniform temperature."""

    capacity_j_k: Positive


class _EdgeSection(Section):
    between: tuple[EdgeEnd, EdgeEnd]

    def _coefficients(self) -> tuple[CoefficientSection, ...]:
        """All fields of the kind in order; they are the coefficients of `EdgeKind`."""
        names = [name for name in type(self).model_fields if name not in ("between", "kind")]
        return tuple(getattr(self, name) for name in names)

    def edge(self, kind: str) -> Edge:
        """Return it as the network knows it; the ambient always comes second."""
        first, second = self.between
        if first == AMBIENT:
            first, second = second, first
        return Edge(
            first,
            second,
            EdgeKind[kind.replace("-", "_").upper()],
            tuple(c.coefficient() for c in self._coefficients()),
        )


class ConstantEdge(_EdgeSection):
    """A constant resistance."""

    kind: Literal["constant"]
    resistance_k_w: Positive


class ContactEdge(_EdgeSection):
    """Rolling contact: R = fixed + constant + moving / sqrt(F n)."""

    kind: Literal["contact"]
    fixed_k_w: NotNegative = ZERO
    constant_k_w: NotNegative = ZERO
    moving_k_w: Positive


class ConvectiveEdge(_EdgeSection):
    """Convection: R = base / Nu, Nu = at_rest + factor n^exponent."""

    kind: Literal["convective"]
    base_k_w: Positive
    nusselt_at_rest: NotNegative
    nusselt_factor: NotNegative
    nusselt_exponent: Number


class ConvectiveReferenceEdge(_EdgeSection):
    """Convection: R = base / Nu, Nu = at_rest + (at_3000_rpm - at_rest) (n / 3000)^exponent."""

    kind: Literal["convective-reference"]
    base_k_w: Positive
    nusselt_at_rest: NotNegative
    nusselt_at_3000_rpm: Positive
    nusselt_exponent: Number


class FilmEdge(_EdgeSection):
    """A surface to the ambient: conductance at 12 K, growing with a power of the difference."""

    kind: Literal["film"]
    conductance_w_k: Positive
    exponent: Number


class ShaftSinkEdge(_EdgeSection):
    """A rotating surface: conductance = at_rest + at_6000_rpm (n / 6000)^(2/3)."""

    kind: Literal["shaft-sink"]
    at_rest_w_k: NotNegative
    at_6000_rpm_w_k: NotNegative


class SpeedPowerEdge(_EdgeSection):
    """R = resistance (n / reference)^exponent."""

    kind: Literal["speed-power"]
    resistance_k_w: Positive
    reference_rpm: Positive
    exponent: Number


EdgeSection = Annotated[
    ConstantEdge
    | ContactEdge
    | ConvectiveEdge
    | ConvectiveReferenceEdge
    | FilmEdge
    | ShaftSinkEdge
    | SpeedPowerEdge,
    Discriminator("kind"),
]


class ShareSection(Section):
    """What a node gets of the heat that the shares before it have left; the last gets the rest."""

    node: TemperatureName
    of_rest: NotNegative | None = None


class _SourceSection(Section):
    shares: tuple[ShareSection, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _the_last_takes_the_rest(self) -> Self:
        for number, share in enumerate(self.shares):
            last = number == len(self.shares) - 1
            if last and share.of_rest is not None:
                raise ValueError(
                    f"shares[{number}].of_rest: the last share takes the rest; expected no of_rest"
                )
            if not last and share.of_rest is None:
                raise ValueError(
                    f"shares[{number}].of_rest: missing; expected a fraction, as only the last "
                    "share takes the rest"
                )
            if share.of_rest is not None and not share.of_rest.parameter:
                fraction = share.of_rest.factor
                if not 0.0 <= fraction <= 1.0:
                    raise ValueError(f"shares[{number}].of_rest = {fraction:g}: expected 0 to 1")
        return self

    def heat_shares(self) -> tuple[HeatShare, ...]:
        """Return the shares as the network knows them."""
        return tuple(
            HeatShare(
                share.node,
                Coefficient(1.0) if share.of_rest is None else share.of_rest.coefficient(),
            )
            for share in self.shares
        )

    def source(self, kind: FrictionKind, lubricant: str | None) -> HeatSource:
        """Return it as the network knows it; all other fields are the law's coefficients."""
        names = [
            name
            for name in type(self).model_fields
            if name not in ("shares", "kind", "lubricant_node")
        ]
        return HeatSource(
            kind,
            tuple(getattr(self, name).coefficient() for name in names),
            self.shares[0].node if lubricant is None else lubricant,
            self.heat_shares(),
        )


class LinearSource(_SourceSection):
    """Heat in W = per_rpm n + per_n F + constant, whatever the temperature."""

    kind: Literal["linear"]
    per_rpm_w: Number = ZERO
    per_n_w: Number = ZERO
    constant_w: Number = ZERO

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.LINEAR, None)


class PalmgrenSource(_SourceSection):
    """Palmgren's friction, equations (1) to (4) of the paper."""

    kind: Literal["palmgren"]
    lubricant_node: TemperatureName
    f2: Positive
    pitch_diameter_mm: Positive
    static_load_rating_n: Positive
    viscosity_mm2_s: Positive
    viscosity_fall_per_k: Number
    viscosity_reference_c: Number

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.PALMGREN, self.lubricant_node)


class TwoPartSource(_SourceSection):
    """The friction law of the default model: a viscous part and a load-dependent part."""

    kind: Literal["two-part"]
    lubricant_node: TemperatureName
    moment_nmm: Positive
    speed_exponent: Number
    speed_curvature: Number = ZERO
    viscosity_exponent: Number
    speed_viscosity: Number = ZERO
    load_share: NotNegative
    viscous_load_exponent: Number = ZERO
    load_exponent: Number
    running_in: NotNegative = ZERO
    running_in_revolutions: Positive = CoefficientSection(factor=1.0e6)

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.TWO_PART, self.lubricant_node)


SourceSection = Annotated[
    LinearSource | PalmgrenSource | TwoPartSource,
    Discriminator("kind"),
]


def _weights(value: object) -> object:
    """A sensor on one node may be given by the node's name."""
    return {"weights": {value: 1.0}} if isinstance(value, str) else value


class SensorSection(Section):
    """A sensor that reads a weighted mean of nodes."""

    weights: dict[TemperatureName, float] = Field(min_length=1)

    @model_validator(mode="after")
    def _is_a_mean(self) -> Self:
        total = sum(self.weights.values())
        if abs(total - 1.0) > 1e-3:
            raise ValueError(f"weights sum up to {total:g}, expected 1")
        return self


class ErrorSection(Section):
    """What is left between a sensor and the network with the right parameters."""

    white_k: PositiveFloat = ErrorModel().white_k
    slow_k: PositiveFloat = ErrorModel().slow_k
    slow_s: PositiveFloat = ErrorModel().slow_s
    offset_k: PositiveFloat = ErrorModel().offset_k


class ReferenceSection(Section):
    """A usual operating point."""

    speed_rpm: PositiveFloat = 4000.0
    load_n: PositiveFloat = 2650.0


class NetworkSection(Section):
    """A thermal network of the user's own."""

    name: str = Field(min_length=1, max_length=64)
    parameters: dict[ParameterName, ParameterSection] = Field(min_length=1)
    nodes: dict[TemperatureName, NodeSection] = Field(min_length=1, max_length=_MOST_NODES)
    edges: tuple[EdgeSection, ...] = Field(min_length=1)
    source: SourceSection
    sensors: dict[TemperatureName, Annotated[SensorSection, BeforeValidator(_weights)]] = Field(
        min_length=1
    )
    errors: ErrorSection = ErrorSection()
    reference: ReferenceSection = ReferenceSection()

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Self:
        for name, sensor in self.sensors.items():
            if name in self.nodes and sensor.weights != {name: 1.0}:
                raise ValueError(
                    f"sensors.{name}: a node has this name; expected it to read that node alone"
                )
        self.compiled()
        self._parameters_stay_physical()
        return self

    def _parameters_stay_physical(self) -> None:
        """Where a coefficient must not be negative, nor may a parameter that stands for it."""
        lowest = dict(zip(self.parameters, self.parameter_set().lower.tolist(), strict=True))
        places: list[tuple[str, Section]] = [("source", self.source)]
        places += [(f"nodes.{name}", node) for name, node in self.nodes.items()]
        places += [(f"edges[{number}]", edge) for number, edge in enumerate(self.edges)]
        places += [(f"source.shares[{k}]", share) for k, share in enumerate(self.source.shares)]
        for place, section in places:
            for field, information in type(section).model_fields.items():
                value = getattr(section, field)
                checks = {_positive, _not_negative}
                bounded = field == "of_rest" or any(
                    isinstance(extra, AfterValidator) and extra.func in checks
                    for extra in information.metadata
                )
                if not bounded or not isinstance(value, CoefficientSection) or not value.parameter:
                    continue
                if lowest[value.parameter] < 0.0:
                    raise ValueError(
                        f"parameters.{value.parameter}: may become {lowest[value.parameter]:g} "
                        f"within 4 spreads of its centre; expected lower = 0 or more, or "
                        f"transform = 'log', as {place}.{field} must not be negative"
                    )

    @property
    def temperature_names(self) -> tuple[str, ...]:
        """All that may be measured, sensors first, then the other nodes."""
        return tuple(dict.fromkeys((*self.sensors, *self.nodes)))

    def network(self) -> Network:
        """Return the network as data.

        Raises
        ------
        ValueError
            If the parts do not fit together; names the part and what was expected.
        """
        return Network(
            self.name,
            tuple(Node(name, node.capacity_j_k.coefficient()) for name, node in self.nodes.items()),
            tuple(edge.edge(edge.kind) for edge in self.edges),
            self.source.heat_source(),
            tuple(
                Sensor(name, tuple(sensor.weights.items())) for name, sensor in self.sensors.items()
            ),
        )

    def parameter_set(self) -> ParameterSet:
        """Return the parameters."""
        return ParameterSet(
            tuple(section.parameter(name) for name, section in self.parameters.items())
        )

    def error_model(self) -> ErrorModel:
        """Return the error model."""
        return ErrorModel(**self.errors.model_dump())

    def compiled(self) -> CompiledNetwork:
        """Return the network as flat arrays; raises ValueError as `network` does."""
        return compile_network(self.network(), tuple(self.parameters))


def network_table(value: object) -> object:
    """Turn the name or the file of a network into its table; None for `BEARING_14`.

    Raises
    ------
    ValueError
        If the value is neither, or the file cannot be used.
    """
    if value == BEARING_14:
        return None
    if not isinstance(value, str):
        return value
    if not value.endswith(".toml"):
        raise ValueError(f"expected {BEARING_14!r}, the path of a TOML file or a table")
    return read_network(folder_of_files.get() / value)


def read_network(file: Path) -> NetworkSection:
    """Read a network from its file.

    Raises
    ------
    SettingsError
        If it cannot be read or is wrong; one line that names the file and the key.
    """
    document: dict[str, Any] = {"name": file.stem} | read_toml(file)
    try:
        return NetworkSection.model_validate(document)
    except ValidationError as error:
        raise SettingsError(f"{file}: {describe(error)}") from error
