"""A thermal network in the configuration: nodes, edges, a heat source, sensors, parameters.

docs/connect/networks.md explains every key. What is wrong is found here, before anything starts.
"""

from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from service.domain.channels import LOAD, SPEED
from service.domain.section import Section
from service.site.configuration import SettingsError, describe_all, read_toml
from service.site.machines.network_edges import EdgeSection, is_boundary
from service.site.machines.network_heat import LinearSource, ShareSection, SourceSection
from service.site.machines.network_losses import CopperLoss, LossSection, SpeedLoss
from service.site.machines.network_values import (
    CoefficientSection,
    InputName,
    ParameterName,
    ParameterSection,
    Positive,
    TemperatureName,
    not_negative,
    positive,
)
from twin_core.network import AMBIENT, CompiledNetwork, Network, Node, Sensor, compile_network
from twin_core.network_model import ErrorModel, RunawayLimits
from twin_core.parameters import ParameterSet

BEARING_14 = "bearing-14"
"""Name of the network that comes with the product; any other is the user's own."""

folder_of_files: ContextVar[Path] = ContextVar("folder_of_files", default=Path())
"""Where the path of a network's file begins: the folder of the configuration."""

_MOST_NODES = 60


class NodeSection(Section):
    """A lump of uniform temperature."""

    capacity_j_k: Positive


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
    """A usual operating point; ``inputs`` are what drives the losses there."""

    speed_rpm: PositiveFloat = 4000.0
    load_n: PositiveFloat = 2650.0
    inputs: dict[InputName, float] = Field(default_factory=dict)


class RunawaySection(Section):
    """From where on a runaway counts as not excluded; the defaults are a bearing's."""

    hot_c: FiniteFloat = RunawayLimits().hot_c
    load_factor: Annotated[FiniteFloat, Field(ge=1.0)] = RunawayLimits().load_factor
    lost_c: FiniteFloat = RunawayLimits().lost_c

    @model_validator(mode="after")
    def _lost_is_hot(self) -> Self:
        if self.lost_c < self.hot_c:
            raise ValueError(f"lost_c = {self.lost_c:g}: expected at least hot_c = {self.hot_c:g}")
        return self


class NetworkSection(Section):
    """A thermal network of the user's own."""

    name: str = Field(min_length=1, max_length=64)
    parameters: dict[ParameterName, ParameterSection] = Field(min_length=1)
    nodes: dict[TemperatureName, NodeSection] = Field(min_length=1, max_length=_MOST_NODES)
    edges: tuple[EdgeSection, ...] = Field(min_length=1)
    source: SourceSection | None = None
    losses: tuple[LossSection, ...] = ()
    sensors: dict[TemperatureName, Annotated[SensorSection, BeforeValidator(_weights)]] = Field(
        min_length=1
    )
    errors: ErrorSection = ErrorSection()
    reference: ReferenceSection = ReferenceSection()
    runaway: RunawaySection | None = None

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Self:
        for name, sensor in self.sensors.items():
            if name in self.nodes and sensor.weights != {name: 1.0}:
                raise ValueError(
                    f"sensors.{name}: a node has this name; expected it to read that node alone"
                )
        if self.source is None and not self.losses:
            raise ValueError("source: missing; expected a law of heat, or losses")
        drives = tuple(name for name in self.inputs if name not in self.boundaries)
        for name in drives:
            if name not in self.reference.inputs:
                raise ValueError(f"reference.inputs.{name}: missing; expected a usual value")
        for name in self.reference.inputs:
            if name not in drives:
                raise ValueError(
                    f"reference.inputs.{name}: drives no loss; expected "
                    f"{', '.join(drives) or 'nothing'}"
                )
        self.compiled()
        self._parameters_stay_physical()
        return self

    def _parameters_stay_physical(self) -> None:
        """Where a coefficient must not be negative, nor may a parameter that stands for it."""
        lowest = dict(zip(self.parameters, self.parameter_set().lower.tolist(), strict=True))
        heat = self.heat
        places: list[tuple[str, Section]] = [("source", heat)]
        places += [(f"nodes.{name}", node) for name, node in self.nodes.items()]
        places += [(f"edges[{number}]", edge) for number, edge in enumerate(self.edges)]
        places += [(f"losses[{number}]", loss) for number, loss in enumerate(self.losses)]
        places += [(f"source.shares[{k}]", share) for k, share in enumerate(heat.shares)]
        for place, section in places:
            for field, information in type(section).model_fields.items():
                value = getattr(section, field)
                checks = {positive, not_negative}
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

    @property
    def heat(self) -> SourceSection:
        """The friction heat; none where only losses are given."""
        if self.source is not None:
            return self.source
        return LinearSource(kind="linear", shares=(ShareSection(node=next(iter(self.nodes))),))

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Channels that are temperatures of boundaries besides the ambient."""
        ends = (end for edge in self.edges for end in edge.between)
        return tuple(dict.fromkeys(end for end in ends if is_boundary(end) and end != AMBIENT))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that act on the network besides speed, load and ambient."""
        driving = (loss.channel for loss in self.losses)
        return tuple(dict.fromkeys((*self.boundaries, *(name for name in driving if name))))

    @property
    def mean_square_inputs(self) -> tuple[str, ...]:
        """Inputs whose square is heat: currents."""
        return tuple(loss.channel for loss in self.losses if isinstance(loss, CopperLoss))

    @property
    def unused_channels(self) -> tuple[str, ...]:
        """What no law of the network asks for, of speed and load; a file need not have it."""
        heat = self.heat
        linear = heat if isinstance(heat, LinearSource) else None
        by_speed = any(edge.kind not in ("constant", "film") for edge in self.edges)
        by_speed |= any(isinstance(loss, SpeedLoss) for loss in self.losses)
        by_speed |= linear is None or linear.per_rpm_w.factor != 0.0
        by_load = any(edge.kind == "contact" for edge in self.edges)
        by_load |= linear is None or linear.per_n_w.factor != 0.0
        return tuple(name for name, used in ((SPEED, by_speed), (LOAD, by_load)) if not used)

    def network(self) -> Network:
        """Return the network as data.

        Raises `ValueError` if the parts do not fit together; names the part and what was expected.
        """
        return Network(
            self.name,
            tuple(Node(name, node.capacity_j_k.coefficient()) for name, node in self.nodes.items()),
            (
                *(edge.edge(edge.kind) for edge in self.edges),
                *(loss.edge() for loss in self.losses),
            ),
            self.heat.heat_source(),
            tuple(
                Sensor(name, tuple(sensor.weights.items())) for name, sensor in self.sensors.items()
            ),
            self.inputs,
        )

    def parameter_set(self) -> ParameterSet:
        """Return the parameters."""
        return ParameterSet(
            tuple(section.parameter(name) for name, section in self.parameters.items())
        )

    def error_model(self) -> ErrorModel:
        """Return the error model."""
        return ErrorModel(**self.errors.model_dump())

    def runaway_limits(self) -> RunawayLimits | None:
        """Return the limits given, or a bearing's where the heat is a bearing's friction."""
        if self.runaway is not None:
            return RunawayLimits(**self.runaway.model_dump())
        return None if self.heat.kind == "linear" else RunawayLimits()

    def compiled(self) -> CompiledNetwork:
        """Return the network as flat arrays; raises ValueError as `network` does."""
        return compile_network(self.network(), tuple(self.parameters))


def network_table(value: object) -> object:
    """Turn the name or the file of a network into its table; None for `BEARING_14`.

    Raises `ValueError` if the value is neither, or the file cannot be used.
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

    Raises `SettingsError` if it cannot be read or is wrong; a line for each error names the file
    and the key.
    """
    document = {"name": file.stem} | read_toml(file)
    try:
        return NetworkSection.model_validate(document)
    except ValidationError as error:
        raise SettingsError(*(f"{file}: {line}" for line in describe_all(error))) from error
