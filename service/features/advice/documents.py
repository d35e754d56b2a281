"""Which low-risk step to run next, which not, and how to approach the target itself."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from service.documents.base import Document, Number, Time
from service.documents.forecasts import RunawayMargin, margin_document
from service.documents.profiles import OperatingPoint, StepLevel

if TYPE_CHECKING:  # web and plant side show advice, and never compute it
    from twin_core.forecasting.advice import Advice
    from twin_core.forecasting.stepping import SteppingLevel
    from twin_core.profiles import Step
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


class NextStep(Document):
    """What to do next for a forecast that is narrow enough, in words and as a step of the list."""

    text: str = Field(
        examples=["15 min at 3300 N, 5800 rpm: ± 12.5 K at 5500 N, 5800 rpm becomes ± 5.0 K."]
    )
    asked_half_width_k: Number = Field(
        default=None, description="What was asked, K; null where nothing was.", examples=[5]
    )
    reached: bool = Field(
        description="Whether the forecast is as narrow as was asked, so that no step is needed."
    )
    rank: int | None = Field(
        default=None,
        description="Of the step in `steps`: the best of at most 20 min, a longer one where none "
        "of these is worth while; null where none is needed or none is worth while.",
        examples=[1],
    )


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
        "cautious interval alone. Steps that reach the asked half-width are alike but for how long "
        "they take.",
    )
    next_step: NextStep
    steps: list[AdvisedStep]
    excluded: list[ExcludedStep]
    stop_rule: StopRule


def advice_document(
    advice: "Advice", region: "LowRiskRegion", *, made_at: str, model_version: int
) -> AdviceDocument:
    """Show advice."""
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
        next_step=_next_step(advice),
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
        stop_rule=_stop_rule(advice.stepping),
    )


def _stop_rule(levels: Sequence["SteppingLevel"]) -> StopRule:
    from twin_core.forecasting.stepping import (
        LARGEST_RATIO,
        RULES,
        SHORTEST_HOLD_S,
        STEADY_K,
        STEADY_WITHIN_S,
    )

    return StopRule(
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
            for step in levels
        ],
    )


def _next_step(advice: "Advice") -> NextStep:
    """Say in plain words what to do next, or that nothing more is needed."""
    step, asked_k, target = advice.next_step, advice.asked_k, advice.target
    now = (
        f"± {advice.now[advice.sensor].half_width_k:.1f} K at {target.load_n:.0f} N, "
        f"{target.speed_rpm:.0f} rpm"
    )
    if advice.reached:
        text = f"{now}: the asked ± {asked_k:g} K is reached, nothing more is needed."
    elif step is None:
        text = f"{now}: no low-risk step that is allowed now narrows it by a tenth or more."
    else:
        after_k = step.cautious_half_width_k[advice.sensor]
        text = f"{_in_words(step.levels)}: {now} becomes ± {after_k:.1f} K"
        text += f"; asked are ± {asked_k:g} K." if asked_k and after_k > asked_k else "."
    if advice.by_runaway:
        text += " A thermal runaway there is not excluded."
    return NextStep(
        text=text,
        asked_half_width_k=asked_k,
        reached=advice.reached,
        rank=None if step is None else advice.steps.index(step) + 1,
    )


def _in_words(levels: Sequence["Step"]) -> str:
    return ", then ".join(
        f"{level.duration_s / 60.0:.0f} min at {level.load_n:.0f} N, {level.speed_rpm:.0f} rpm"
        for level in levels
    )


def _level(level: "Step") -> StepLevel:
    return StepLevel(speed_rpm=level.speed_rpm, load_n=level.load_n, duration_s=level.duration_s)


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in values.items()}
