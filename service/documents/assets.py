"""What an asset is, how it is, and the temperatures that the twin sees."""

from typing import Literal

from pydantic import Field

from service.documents.alarms import AlarmSummary
from service.documents.base import Document, Number, Page, Time
from service.documents.limits import Limits, LowRisk
from service.documents.measurements import SampleItem
from service.documents.profiles import ForecastStep


class ActiveModel(Document):
    """The model version that the live twin runs on."""

    version: int = Field(examples=[2])
    model: str = Field(description="Name of the thermal network.", examples=["bearing-14"])
    trusted: bool = Field(description="False while its estimate or forecast fails.")
    identified: bool = Field(description="False for the priors.")
    identified_at: Time | None


class VerdictSettings(Document):
    """When the next step is called safe."""

    safe_below_probability: float = Field(
        description="Of exceeding a warning limit.", examples=[0.05]
    )


class ChannelDocument(Document):
    """One channel of an asset."""

    name: str = Field(examples=["t_inner_ring_c"])
    source: str = Field(
        description="Name of its source; `push` for a pushed one, `twin` for an estimate.",
        examples=["pt100"],
    )
    unit: str = Field(description="Empty for a number without one.", examples=["°C"])
    reason: str | None = Field(
        description="Why its value is not good now; null when it is.",
        examples=["stale: no new value"],
    )
    max_age_s: Number = Field(
        description="Process seconds after which a value is stale; null for an estimate."
    )


class HealthOfAsset(Document):
    """Whether the twin runs, and which channels have no good data."""

    status: Literal["good", "degraded"]
    twin_running: bool
    channels_without_good_data: list[str] = Field(examples=[["t_node_5_c"]])


class IdentificationSettings(Document):
    """What is done with new data."""

    ladder: Literal["observe", "suggest", "apply"] = Field(
        description="`suggest` identifies automatically; `apply` activates what passes the gates."
    )


class Controller(Document):
    """What the controller of the bench reports; null where no channel is configured."""

    phase: Number = Field(description="Of its program.")
    speed_setpoint_rpm: Number = Field(description="rpm")
    load_setpoint_n: Number = Field(description="Radial load, N.")
    plan: list[ForecastStep] | None = Field(
        description="What is left of its plan; null before the first plan was read."
    )


class AssetDocument(Document):
    """Configuration, health and active model of an asset."""

    id: str = Field(examples=["bench-1"])
    name: str = Field(description="Name on the pages.", examples=["Test bench 1"])
    group: str | None = Field(description="Null without one.", examples=["Line A"])
    family: str | None = Field(
        description="Machines of one type; null without one.", examples=["Axle box 2019"]
    )
    bearing: str | None = Field(
        description="Null for a machine with a custom network.", examples=["6311"]
    )
    network: str = Field(examples=["bearing-14"])
    clock_rate: float = Field(
        description="Process seconds per wall second; 1 on a real machine.", examples=[1]
    )
    low_risk: LowRisk
    limits: dict[str, Limits] = Field(description="By sensor or node.")
    channels: list[ChannelDocument]
    alarms: AlarmSummary
    ambient_assumed_c: Number = Field(
        description="Assumed ambient temperature where no channel measures it, °C."
    )
    verdict: VerdictSettings
    health: HealthOfAsset
    active_model: ActiveModel
    identification: IdentificationSettings
    controller: Controller | None


class AssetList(Page):
    """All assets of the service."""

    items: list[AssetDocument]


class NodeState(Document):
    """Estimate of one node's temperature."""

    mean_c: Number = Field(description="°C", examples=[71.2])
    std_c: Number = Field(description="Standard deviation, K.", examples=[0.8])
    known: bool = Field(
        description="Whether half the 95 % interval is within 3.5 K (more with wide `[errors]`); "
        "else it is not known, and not to be shown as a temperature."
    )
    reason: str | None = Field(
        description="Why the node is not known; null where it is.",
        examples=["±14 K: no sensor shows it"],
    )


class State(Document):
    """The node temperatures as the twin sees them now."""

    time: Time
    model_version: int
    revolutions: float = Field(description="Of the shaft since the grease was renewed.")
    nodes: dict[str, NodeState]
    missing: list[str] = Field(
        description="Speed, load and ambient without a usable value now; with any of them "
        "the estimate is uncertain.",
    )


class StateMessage(State):
    """The state with the estimates of the sensors, so that a chart needs no polling."""

    samples: list[SampleItem]


class GreaseRenewed(Document):
    """What became of the count of revolutions."""

    time: Time
    revolutions_before: float = Field(examples=[1_482_300])
    revolutions: float = Field(description="Since the grease was renewed.", examples=[0])
