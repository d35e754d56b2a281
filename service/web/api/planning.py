"""Answers that help to plan a test, as OpenAPI shows them: safe operating envelope and advice."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from service.web.api.bodies import LowRisk, Number, Time

Matrix = Annotated[
    list[list[Number]],
    Field(description="One row per load, one column per speed.", examples=[[[41.2, 44.9]]]),
]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="allow")


# ---------------------------------------------------------------------------- envelope
class SteadyMap(_Answer):
    """Quantiles of what the sensor will read in the steady state, °C; 500 where it runs away."""

    q025: Matrix
    q50: Matrix
    q975: Matrix


class LimitMap(_Answer):
    """When and how probably a limit is reached, each point held from the present state."""

    limit_c: float = Field(description="°C", examples=[90])
    probability: Matrix = Field(
        description="Share of the members that reach it within the horizon."
    )
    steady_probability: Matrix = Field(
        description="Probability that the steady state is at or over it, smooth over the map."
    )
    median_s: Matrix = Field(
        description="Seconds until half of the members have reached it; null where fewer do."
    )
    earliest_s: Matrix = Field(
        description="Seconds until 2.5 % of the members have reached it; null where fewer do."
    )


class SensorMaps(_Answer):
    """Maps of one sensor; `limits` holds `warning` and `alarm`, or nothing if it has none."""

    steady_c: SteadyMap
    limits: dict[str, LimitMap]


class RunawayMap(_Answer):
    """Thermal runaway: beyond the limit (130 °C of a bearing), or without a steady state."""

    probability: Matrix = Field(description="Share of the members that run away.")
    not_excluded: list[list[bool]] = Field(
        description="True where the upper edge passes 100 °C, the load is beyond 1.5 times what "
        "the data hold, or members run away."
    )


class OperatingPoint(_Answer):
    """A point of the map."""

    speed_rpm: float = Field(examples=[4200])
    load_n: float = Field(examples=[2650])


class PresentPoint(OperatingPoint):
    """Where the machine is now, and what is measured there."""

    measured_c: dict[str, Number] = Field(
        {},
        description="Good and fresh readings by sensor, °C; `labels` say where the map is low.",
    )


class EnvelopeDocument(_Answer):
    """Steady temperatures and times to the limits over speed and load."""

    made_at: Time
    model_version: int
    ambient_c: float = Field(description="Assumed to stay, °C.", examples=[23.1])
    horizon_s: float = Field(
        description="How long each point is held for the times, s.", examples=[28800]
    )
    members: int = Field(examples=[80])
    speed_rpm: list[float] = Field(description="Columns of all maps.", examples=[[350, 700]])
    load_n: list[float] = Field(description="Rows of all maps.", examples=[[450, 900]])
    sensors: dict[str, SensorMaps]
    runaway: RunawayMap
    present: PresentPoint
    low_risk: LowRisk
    labels: list[str] = Field(
        description="What the result rests on.",
        examples=[["not identified yet: prior parameters only"]],
    )


# ---------------------------------------------------------------------------- advice
BySensor = Annotated[dict[str, Number], Field(examples=[{"t_inner_ring_c": 4.5}])]


class StepLevel(OperatingPoint):
    """A span at constant speed and load."""

    duration_s: float = Field(examples=[3600])


class TargetSensor(_Answer):
    """The present forecast of a sensor at the end of the target, °C; half-width in K."""

    q025: float
    q50: float = Field(examples=[88.1])
    q975: float
    half_width_k: float = Field(examples=[26.1])


class Target(StepLevel):
    """The point asked for, as it is forecast now."""

    inside_low_risk: bool
    sensor: str = Field(
        description="The sensor with the widest interval; steps are ranked by it.",
        examples=["t_inner_ring_c"],
    )
    sensors: dict[str, TargetSensor]
    labels: list[str] = Field(examples=[["load law from prior only", "runaway not excluded"]])


class AdvisedStep(_Answer):
    """A feasible step inside the low-risk region."""

    rank: int = Field(examples=[1])
    levels: list[StepLevel]
    duration_s: float = Field(examples=[7200])
    half_width_k: BySensor = Field(
        description="Half the 95 % interval at the target, expected after the step."
    )
    cautious_half_width_k: BySensor = Field(
        description="The same if the machine's friction shifts by some per cent between stages; "
        "steps are ranked by it."
    )
    narrower_by: float = Field(
        description="Fraction by which the deciding sensor's interval narrows, cautiously.",
        examples=[0.78],
    )
    peak_c: BySensor = Field(description="Highest upper edge during the step, °C.")
    why: str


class ExcludedStep(_Answer):
    """A step that must not be run, and why."""

    levels: list[StepLevel]
    reason: str = Field(
        examples=["changes speed and load at once against the data (5800 rpm, 2650 N)"]
    )


class ApproachLevel(OperatingPoint):
    """One level on the way to the target."""

    expected_c: BySensor = Field(description="Median of the steady reading, °C.")
    stop_above_c: BySensor = Field(
        description="Upper edge (97.5 %), °C: a reading above it means stop and go back."
    )
    runaway_not_excluded: bool
    allowed: bool = Field(
        description="False from the level on whose upper edge reaches an alarm limit."
    )
    reason: str


class StopRule(_Answer):
    """How to approach the target, and when to stop."""

    rules: list[str]
    largest_ratio: float = Field(description="Of one level to the next.", examples=[1.25])
    hold_at_least_s: float = Field(examples=[1800])
    steady: dict[str, Any] = Field(examples=[{"change_k": 0.2, "within_s": 600}])
    levels: list[ApproachLevel]


class AdviceDocument(_Answer):
    """Which low-risk step to run next, which not, and how to approach the target itself."""

    made_at: Time
    model_version: int
    target: Target
    worth_while: bool = Field(
        description="Whether the best step narrows the interval by a tenth or more."
    )
    steps: list[AdvisedStep]
    excluded: list[ExcludedStep]
    stop_rule: StopRule
