"""Which low-risk step to run next, which not, and how to approach the target itself."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from service.documents.base import Document, Number, Time
from service.documents.forecasts import RunawayMargin, margin_document
from service.documents.profiles import OperatingPoint, StepLevel

if TYPE_CHECKING:  # web and plant side show advice, and never compute it
    from twin_core.forecasting.advice import Advice
    from twin_core.forecasting.design import Level
    from twin_core.windows import LowRiskRegion

BySensor = Annotated[dict[str, float], Field(examples=[{"t_inner_ring_c": 4.5}])]


class TargetSensor(Document):
    """The present forecast of a sensor at the end of the target, °C; half-width in K."""

    q025: float
    q50: float = Field(examples=[88.1])
    q975: float
    half_width_k: float = Field(examples=[26.1])


class Target(StepLevel):
    """The point asked for, as it is forecast now."""

    inside_low_risk: bool
    sensor: str = Field(
        description="The sensor with the widest interval; of intervals, this one's counts.",
        examples=["t_inner_ring_c"],
    )
    sensors: dict[str, TargetSensor]
    labels: list[str] = Field(examples=[["load law from prior only", "runaway not excluded"]])
    runaway_margin: RunawayMargin | None = Field(
        default=None, description="Held at the target for hours, as it is forecast now."
    )


class AdvisedStep(Document):
    """A feasible step inside the low-risk region."""

    rank: int = Field(examples=[1])
    levels: list[StepLevel]
    duration_s: float = Field(examples=[7200])
    half_width_k: BySensor = Field(
        description="Half the 95 % interval at the target, expected after the step, K."
    )
    cautious_half_width_k: BySensor = Field(
        description="The same if the machine's friction shifts by some per cent between stages."
    )
    runaway_probability: Number = Field(
        default=None,
        description="Of a runaway at the target, cautiously expected after the step if the machine "
        "is what it is taken for; null where the probability was not tested.",
        examples=[0.021],
    )
    narrower_by: float = Field(
        description="Fraction by which the deciding sensor's interval narrows, cautiously.",
        examples=[0.78],
    )
    peak_c: BySensor = Field(description="Highest upper edge during the step, °C.")
    why: str


class ExcludedStep(Document):
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


class Steady(Document):
    """When a reading counts as steady."""

    change_k: float = Field(description="It changes by no more, K.", examples=[0.2])
    within_s: float = Field(description="In this time, s.", examples=[600])


class StopRule(Document):
    """How to approach the target, and when to stop."""

    rules: list[str]
    largest_ratio: float = Field(description="Of one level to the next.", examples=[1.25])
    hold_at_least_s: float = Field(description="Seconds.", examples=[1800])
    steady: Steady
    levels: list[ApproachLevel]


class AdviceDocument(Document):
    """Which low-risk step to run next, which not, and how to approach the target itself."""

    made_at: Time
    model_version: int
    target: Target
    worth_while: bool = Field(
        description="Whether the best step narrows the interval by a tenth or more."
    )
    ranked_by: Literal["runaway", "interval"] = Field(
        default="interval",
        description="Where a runaway at the target is not excluded, steps are ranked by its "
        "probability after them, and those with like odds by the cautious interval; else by the "
        "cautious interval alone.",
    )
    steps: list[AdvisedStep]
    excluded: list[ExcludedStep]
    stop_rule: StopRule


def advice_document(
    advice: "Advice", region: "LowRiskRegion", *, made_at: str, model_version: int
) -> AdviceDocument:
    """Show advice.

    Parameters
    ----------
    advice : Advice
        As it was computed.
    region : LowRiskRegion
        Of the asset.
    made_at, model_version
        When, and with which model.
    """
    from twin_core.forecasting.stepping import (
        LARGEST_RATIO,
        RULES,
        SHORTEST_HOLD_S,
        STEADY_K,
        STEADY_WITHIN_S,
    )

    target = advice.target
    return AdviceDocument(
        made_at=made_at,
        model_version=model_version,
        target=Target(
            speed_rpm=target.speed_rpm,
            load_n=target.load_n,
            duration_s=target.duration_s,
            inside_low_risk=bool(region.contains(target.speed_rpm, target.load_n)),
            sensor=advice.sensor,
            sensors={
                name: TargetSensor(
                    q025=round(found.q025, 2),
                    q50=round(found.q50, 2),
                    q975=round(found.q975, 2),
                    half_width_k=round(found.half_width_k, 2),
                )
                for name, found in advice.now.items()
            },
            labels=list(advice.labels),
            runaway_margin=margin_document(advice.margin),
        ),
        ranked_by="runaway" if advice.by_runaway else "interval",
        worth_while=advice.worth_while,
        steps=[
            AdvisedStep(
                rank=rank,
                levels=[_level(level) for level in step.levels],
                duration_s=step.duration_s,
                half_width_k=_rounded(step.half_width_k),
                cautious_half_width_k=_rounded(step.cautious_half_width_k),
                runaway_probability=(
                    None if step.runaway_probability is None else round(step.runaway_probability, 4)
                ),
                narrower_by=round(step.narrower_by, 3),
                peak_c=_rounded(step.peak_c),
                why=step.why,
            )
            for rank, step in enumerate(advice.steps, start=1)
        ],
        excluded=[
            ExcludedStep(levels=[_level(level) for level in step.levels], reason=step.reason)
            for step in advice.excluded
        ],
        stop_rule=StopRule(
            rules=list(RULES),
            largest_ratio=LARGEST_RATIO,
            hold_at_least_s=SHORTEST_HOLD_S,
            steady=Steady(change_k=STEADY_K, within_s=STEADY_WITHIN_S),
            levels=[
                ApproachLevel(
                    speed_rpm=round(step.speed_rpm, 1),
                    load_n=round(step.load_n, 1),
                    expected_c=_rounded(step.expected_c),
                    stop_above_c=_rounded(step.stop_above_c),
                    runaway_not_excluded=step.runaway_not_excluded,
                    allowed=step.allowed,
                    reason=step.reason,
                )
                for step in advice.stepping
            ],
        ),
    )


def _level(level: "Level") -> StepLevel:
    return StepLevel(speed_rpm=level.speed_rpm, load_n=level.load_n, duration_s=level.duration_s)


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in values.items()}
