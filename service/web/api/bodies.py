"""Answers as OpenAPI shows them, with units and examples. Further members are always allowed."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

Time = Annotated[
    str,
    WithJsonSchema(
        {"type": "string", "format": "date-time", "examples": ["2026-11-21T08:00:00.000Z"]}
    ),
]
Number = float | None
Quality = Annotated[
    int,
    Field(
        ge=0,
        le=255,
        description="OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.",
        examples=[192],
    ),
]
Percentiles = Annotated[list[Number], Field(description="One temperature per time, °C.")]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="allow")


class Page(_Answer):
    """What every listing has: `next` is the cursor of the next page, null on the last."""

    next: str | None = Field(None, description="Cursor of the next page; null on the last one.")


# ---------------------------------------------------------------------------- assets
class Limits(_Answer):
    """Limits of one temperature, °C."""

    warning: float = Field(examples=[90])
    alarm: float = Field(examples=[105])


class LowRisk(_Answer):
    """The region whose data may be used for identification."""

    speed_rpm_max: float = Field(examples=[4300])
    load_n_max: float = Field(examples=[3000])


class ActiveModel(_Answer):
    """The model version that the live twin runs on."""

    version: int | None = Field(examples=[2])
    trusted: bool
    identified_at: Time | None


class VerdictSettings(_Answer):
    """When the next step is called safe."""

    safe_below_probability: float = Field(examples=[0.05])


class AlarmSummary(_Answer):
    """The open alarms of an asset, counted."""

    active: int
    unacknowledged: int
    shelved: int
    highest_priority: int = Field(ge=0, le=3, description="1 to 3; 0: none.")
    over_limit: Literal["warning", "alarm"] | None = Field(
        description="The highest measured limit that is exceeded, also while its data are lost."
    )


class AssetDocument(_Answer):
    """Configuration, health and active model of an asset."""

    id: str = Field(examples=["bench-1"])
    name: str = Field(description="Name on the pages.", examples=["Test bench 1"])
    group: str | None = Field(description="Null without one.", examples=["Hall A"])
    bearing: str | None = Field(
        description="Null for a machine with a custom network.", examples=["6311"]
    )
    network: str = Field(examples=["bearing-14"])
    low_risk: LowRisk
    limits: dict[str, Limits]
    channels: list[Any]
    health: dict[str, Any]
    active_model: ActiveModel | None
    alarms: AlarmSummary | None = None
    ambient_assumed_c: Number = Field(
        None, description="Assumed ambient temperature where no channel measures it, °C."
    )
    verdict: VerdictSettings | None = None
    controller: dict[str, Any] | None


class AssetList(Page):
    """All assets of the service."""

    items: list[AssetDocument]


class Tag(_Answer):
    """One value for a SCADA system; null when the quality is bad."""

    value: float | str | bool | None = Field(examples=[63.4])
    unit: str | None = Field(examples=["°C"])
    quality: Quality
    time: Time


class Snapshot(_Answer):
    """Flat tags: measured, estimated (`.twin`), forecast maxima, times to limit, alarm counts."""

    tags: dict[str, Tag]


class NodeState(_Answer):
    """Estimate of one node's temperature."""

    mean_c: Number = Field(description="°C", examples=[71.2])
    std_c: Number = Field(description="Standard deviation, K.", examples=[0.8])
    known: bool = Field(
        False, description="Whether half the 95 % interval is within 8 K; else it is not known."
    )


class State(_Answer):
    """The 13 node temperatures as the twin sees them now."""

    time: Time
    model_version: int | None
    revolutions: float = Field(0.0, description="Of the shaft since the grease was renewed.")
    nodes: dict[str, NodeState]
    missing: list[str] = Field(
        [],
        description="Speed, load and ambient without a usable value now; with any of them "
        "the estimate is uncertain.",
    )


class GreaseRenewed(_Answer):
    """What became of the count of revolutions."""

    time: Time
    revolutions_before: float = Field(examples=[1_482_300])
    revolutions: float = Field(description="Since the grease was renewed.", examples=[0])


# ---------------------------------------------------------------------------- verdict
class VerdictLimit(_Answer):
    """The limit that a verdict is about."""

    channel: str = Field(examples=["t_inner_ring_c"])
    level: Literal["warning", "alarm"]
    value_c: float = Field(description="The limit itself, °C.", examples=[90])


class VerdictOf(_Answer):
    """One word with what stands behind it."""

    word: Literal["safe", "not safe", "recovering", "unknown"]
    reasons: list[str] = Field(
        examples=[["Inner ring over warning 90 °C with 3 % at 6200 rpm, 5500 N"]]
    )
    limit: VerdictLimit | None
    probability: Number = Field(
        description="That this limit is exceeded; 1 when it is exceeded already.", examples=[0.03]
    )
    seconds_to_limit: Number = Field(
        description="Process seconds until it is exceeded at the earliest (2.5 % of the "
        "forecasts); null when fewer exceed it."
    )
    alarm_probability: Number = Field(
        None, description="That the alarm limit of the same channel is exceeded."
    )


class TimeToLimit(_Answer):
    """The limit that is exceeded first along all that is planned.

    Of a channel that is over its warning already it is the alarm limit.
    """

    limit: VerdictLimit
    expected: bool = Field(description="Whether the probability is above that of the verdict safe.")
    probability: float
    earliest_s: Number = Field(description="Seconds from now, 2.5 % of the forecasts.")
    median_s: Number = Field(description="Seconds from now, half of the forecasts.")
    horizon_s: float = Field(description="How far the forecast looks, seconds from now.")


class VerdictDocument(_Answer):
    """Whether the machine is safe now, and whether its next step is."""

    time: Time
    now: VerdictOf
    next_step: VerdictOf = Field(
        description="Of the next planned step; with none planned, of the present one to its end."
    )
    time_to_limit: TimeToLimit | None = Field(
        description="Null while an input of `next_step` is missing."
    )
    missing: list[str] = Field(
        description="Inputs that are not there: channels, `twin` (it does not run), `limits`, "
        "`identified model`, `forecast`.",
        examples=[["speed_rpm"]],
    )


# ---------------------------------------------------------------------------- forecasts
class Quantiles(_Answer):
    """Quantiles of a temperature over time: of the measured value for sensors, else of the true."""

    q025: Percentiles
    q25: Percentiles
    q50: Percentiles
    q75: Percentiles
    q975: Percentiles


class Crossing(_Answer):
    """When and how probably a limit is crossed within the horizon."""

    probability: Number = Field(examples=[0.42])
    median_s: Number = Field(description="Seconds from now; null when it never crosses.")
    earliest_s: Number = Field(description="Seconds from now (2.5 %); null when it never crosses.")


class WhatIf(_Answer):
    """A forecast of the asked-for sensors and nodes."""

    time_s: list[float] = Field(description="Seconds from the present moment.")
    nodes: dict[str, Quantiles]
    limits: dict[str, Limits]
    time_to_limit: dict[str, dict[str, Crossing]]
    missing: list[str] = Field(
        [],
        description="Speed, load and ambient without a usable value now; with any of them "
        "the forecast starts from an uncertain state.",
    )


class LiveForecast(WhatIf):
    """The latest live forecast: of the controller's plan, else of the present point held."""

    made_at: Time
    model_version: int | None
    profile: list[Any]


# ---------------------------------------------------------------------------- measurements
class MeasurementItem(_Answer):
    """One sample (`value`) or one bucket (`mean`, `min`, `max`, `count`) in the channel's unit."""

    channel: str = Field(examples=["t_inner_ring_c"])
    time: Time
    quality: Quality
    value: Number = None
    mean: Number = None
    min: Number = None
    max: Number = None
    count: int | None = Field(None, description="Good samples in the bucket.")


class Measurements(Page):
    """History with quality, ascending by time, then by channel."""

    resolution: str = Field(
        description="What `items` are: raw samples, or buckets of this length.", examples=["1min"]
    )
    items: list[MeasurementItem]


class Rejected(_Answer):
    """A sample that was not taken, and why."""

    index: int = Field(description="Place in `samples`, from 0.")
    detail: str


class Pushed(_Answer):
    """What became of the samples; the answer means that those taken are on the disk."""

    accepted: int = Field(description="Newly stored.", examples=[2])
    duplicates: int = Field(description="Already stored: sent again.", examples=[0])
    rejected: list[Rejected]


# ---------------------------------------------------------------------------- identification
class WindowDocument(_Answer):
    """A low-risk window with its operating points and score."""

    start: Time
    end: Time


class WindowList(Page):
    """Low-risk windows found in the store."""

    items: list[WindowDocument]


class JobDocument(_Answer):
    """One identification job."""

    id: str = Field(examples=["3f2b8c0e9d5a4a7f8e1c2b3d4e5f6a7b"])
    status: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float = Field(ge=0, le=1)
    best_fitness: Number
    evaluations: int
    created_at: Time
    started_at: Time | None
    ended_at: Time | None
    error: str | None
    model_version: int | None
    phase: str | None = Field(
        None, description="Of a running job: search, refinement, sampling or gates."
    )
    seconds_left: Number = Field(
        None, description="Wall seconds that a running job still takes; null while not known."
    )
    active_fitness: Number = Field(
        None, description="Best fitness to beat: of the active version on the same data."
    )
    convergence: list[list[float]] = Field(
        default=[], description="Pairs of evaluations and best fitness; of a single job only."
    )


class JobList(Page):
    """Identification jobs, newest first."""

    items: list[JobDocument]


class ModelDocument(_Answer):
    """One model version with its parameters, the data it comes from and its scores."""

    version: int = Field(ge=1)
    status: Literal["candidate", "active", "retired", "rejected"]
    reason: str | None
    parameters: Any
    identifiability: Any = Field(
        None,
        description="Rank and condition of the sensitivities, and the combinations of parameters "
        "that the data inform; null for versions of older releases.",
    )
    paper_view: Any = Field(
        None, description="The paper's 15 numbers, of the model paper-reduced only."
    )
    windows: Any
    scores: Any
    naive: Any
    drift: Any = Field(
        None, description="Comparison with earlier versions; see `GET …/drift`. Null: none made."
    )


class ModelList(Page):
    """Model versions, newest first."""

    items: list[ModelDocument]


class ActivationLine(_Answer):
    """One change of the active version."""

    time: Time
    version: int = Field(ge=1, description="The version that became the active one.")
    who: str
    comment: str


class ActivationList(Page):
    """The activation journal, newest first."""

    items: list[ActivationLine]


# ---------------------------------------------------------------------------- session, health
class Alive(_Answer):
    """The process answers."""

    status: Literal["alive"] = "alive"


class ReadyCheck(_Answer):
    """One thing that the service needs."""

    name: str = Field(examples=["source:pt100"])
    status: Literal["ok", "degraded", "failed"]
    detail: str | None


class Ready(_Answer):
    """Whether the service does its work."""

    status: Literal["ready", "degraded", "not ready"]
    checks: list[ReadyCheck]
