"""One asset of the configuration: bearing or network, channels, limits, alarms, controller."""

import re
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PositiveFloat,
    ValidationInfo,
    create_model,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from service.alarm_kinds import AlarmsSection, above_ambient
from service.domain.channels import (
    AMBIENT,
    CONTROLLER_CHANNELS,
    NODES,
    OBSERVED_CHANNELS,
    OPERATING_CHANNELS,
    RING_SENSORS,
    STANDARD,
)
from service.domain.section import Section
from service.domain.texts import EXPECTED, is_one_line
from service.site.configuration import TomlTable
from service.site.machines.bearings import BearingSection, bearing_table
from service.site.machines.networks import BEARING_14, NetworkSection, network_table
from twin_core.windows import LowRiskRegion


class LowRiskSection(Section):
    """The region of speed and load whose data may be used for identification."""

    speed_rpm_max: PositiveFloat
    load_n_max: PositiveFloat

    @property
    def region(self) -> LowRiskRegion:
        """The same for the twin."""
        return LowRiskRegion(self.speed_rpm_max, self.load_n_max)


class LimitsSection(Section):
    """Warning and alarm temperature of one measured point, in degrees Celsius."""

    warning: float = Field(ge=-50, le=500)
    alarm: float = Field(ge=-50, le=500)

    @model_validator(mode="after")
    def _warning_comes_first(self) -> Self:
        if self.warning >= self.alarm:
            raise ValueError(
                f"warning {self.warning:g} must be below alarm {self.alarm:g} (degrees Celsius)"
            )
        return self


class IdentificationSection(Section):
    """How far the twin may go automatically: observe, suggest or apply (activate)."""

    ladder: Literal["observe", "suggest", "apply"] = "apply"


class VerdictSection(Section):
    """When the next step is called safe."""

    #: Below this probability of exceeding a warning limit within the step.
    safe_below_probability: float = Field(0.05, gt=0, le=0.5)


class _ControllerSection(Section):
    """Channels of the bench controller; each is checked by the driver of its source."""

    plan: TomlTable | None = None


if TYPE_CHECKING:
    ControllerSection = _ControllerSection
else:
    ControllerSection = create_model(
        "ControllerSection",
        __base__=_ControllerSection,
        __doc__=_ControllerSection.__doc__,
        **dict.fromkeys(CONTROLLER_CHANNELS, (TomlTable | None, None)),
    )


def _channel_name(name: str, info: ValidationInfo) -> str:
    known = _temperatures(info)
    others = (*OPERATING_CHANNELS, *OBSERVED_CHANNELS, *_inputs(info))
    if known is not None and name not in (*others, *known):
        raise ValueError(f"unknown channel; expected one of {_listed(info)}")
    return name


def _limited(name: str, info: ValidationInfo) -> str:
    known = _temperatures(info)
    if known is not None and name not in (*known, *OBSERVED_CHANNELS):
        raise ValueError(f"limits belong to a temperature such as {known[0]}")
    return name


def _temperatures(info: ValidationInfo) -> tuple[str, ...] | None:
    """What may be measured on an asset; None with a network that has an error of its own."""
    if "network" not in info.data:
        return None
    network = _network_of(info)
    return RING_SENSORS + NODES if network is None else network.temperature_names


def _inputs(info: ValidationInfo) -> tuple[str, ...]:
    network = _network_of(info)
    return () if network is None else tuple(network.inputs)


def _listed(info: ValidationInfo) -> str:
    if _network_of(info) is None:
        named = OPERATING_CHANNELS + OBSERVED_CHANNELS + RING_SENSORS
        return f"{', '.join(named)}, {NODES[0]} to {NODES[-1]}"
    operating = (*OPERATING_CHANNELS, *OBSERVED_CHANNELS, *_inputs(info))
    return ", ".join((*operating, *(_temperatures(info) or ())))


def _network_of(info: ValidationInfo) -> NetworkSection | None:
    """The network of the asset that is being read."""
    network: NetworkSection | None = info.data.get("network")
    return network


_RING_LIMITS = {
    one.name: dict(zip(("warning", "alarm"), one.limits_c, strict=True))
    for one in STANDARD
    if one.limits_c is not None
}


ModelName = Literal["default", "paper", "paper-reduced"]
"""Models of a bearing; see `twin_core.models`."""


#: Pattern of the id of an asset.
ASSET_ID: Final = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"


def _asset_id(text: str) -> str:
    if not re.fullmatch(ASSET_ID, text):
        raise ValueError("expected letters, digits, '.', '_' and '-', 64 at most")
    return text


class AssetSection(Section):
    """One bearing on a bench or in a motor."""

    id: Annotated[str, AfterValidator(_asset_id)]
    #: What it was made from, if anything; its tables are the template's with what it gives itself.
    template: str = Field("", max_length=64)
    #: What the pages call the asset; its id if absent.
    name: str = Field("", max_length=64)
    #: Assets of one group can be looked at together in the fleet view.
    group: str = Field("", max_length=64)
    #: Assets of one family, machines of one type, can be identified together.
    family: str = Field("", max_length=64)
    network: Annotated[NetworkSection | None, BeforeValidator(network_table)] = None
    bearing: Annotated[BearingSection, BeforeValidator(bearing_table)] | None = Field(
        None, validate_default=True
    )
    model: ModelName = "default"
    low_risk: LowRiskSection
    limits: dict[Annotated[str, AfterValidator(_limited)], LimitsSection] = Field(
        default_factory=dict
    )
    channels: dict[Annotated[str, AfterValidator(_channel_name)], TomlTable]
    controller: ControllerSection = ControllerSection()
    identification: IdentificationSection = IdentificationSection()
    alarms: AlarmsSection = AlarmsSection()
    verdict: VerdictSection = VerdictSection()

    @model_validator(mode="before")
    @classmethod
    def _limit_the_rings(cls, given: Any) -> Any:
        """A bearing has usual limits; what a network of one's own bears only its user knows."""
        if isinstance(given, dict) and given.get("network") in (None, BEARING_14):
            return {"limits": _RING_LIMITS} | given
        return given

    @field_validator("bearing")
    @classmethod
    def _bearing_or_network(
        cls, bearing: BearingSection | None, info: ValidationInfo
    ) -> BearingSection | None:
        # A network that is wrong is not in the data: its own error says so.
        network = info.data.get("network", ...)
        if bearing is None and network is None:
            raise PydanticCustomError("missing", "Field required")
        if bearing is not None and network not in (None, ...):
            raise ValueError(
                "expected no bearing together with a network of your own, or no network"
            )
        return bearing

    @model_validator(mode="after")
    def _above_ambient_is_measured(self) -> Self:
        where = "alarms.above_ambient.limits"
        limits = self.alarms.rule(above_ambient.KIND).limits
        for name in limits:
            if not (name.startswith("t_") and name in self.channels):
                raise ValueError(f"{where}.{name}: expected a temperature among the channels")
        if limits and AMBIENT not in self.channels:
            raise ValueError(f"{where}: the channel ambient_c is missing; expected it too")
        return self

    @property
    def network_name(self) -> str:
        """Name of the asset's network."""
        return BEARING_14 if self.network is None else self.network.name

    @property
    def input_names(self) -> tuple[str, ...]:
        """Channels that the asset's network asks for besides speed, load and ambient."""
        return () if self.network is None else self.network.inputs

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """The standard sensors of the asset's network."""
        return RING_SENSORS if self.network is None else tuple(self.network.sensors)

    @property
    def lines_in_names(self) -> list[str]:
        """Say which names are no line of visible characters: one line each.

        Who gives such a name is asked for another; what the store has already is followed as it is.
        """
        names = {"name": self.name, "group": self.group, "family": self.family}
        if self.bearing is not None:
            names["bearing.designation"] = self.bearing.designation
        if self.network is not None:
            names["network.name"] = self.network.name
        return [
            f"{key} = {text!r}: {EXPECTED}" for key, text in names.items() if not is_one_line(text)
        ]
