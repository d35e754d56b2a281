"""A forecast that exceeds a limit ahead with a probability worth an operator's attention."""

from collections.abc import Iterable, Iterator
from typing import Self

from pydantic import Field, model_validator

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import (
    DAY_S,
    LEVELS,
    AlarmContext,
    AlarmKind,
    LevelRule,
    pairs_of,
)
from service.domain.channels import label
from service.domain.words import percent

#: From this probability on a limit "will" be exceeded; below it "may" be.
CERTAIN_FROM = 0.95


class ForecastLimitRule(LevelRule):
    """A limit that the forecast exceeds ahead."""

    on_delay_s: float = Field(0.0, ge=0, le=DAY_S)
    off_delay_s: float = Field(120.0, ge=0, le=DAY_S)
    raise_probability: float = Field(0.20, gt=0, le=1)
    clear_probability: float = Field(0.10, ge=0, le=1)

    @model_validator(mode="after")
    def _clears_below(self) -> Self:
        if self.clear_probability > self.raise_probability:
            raise ValueError(
                f"clear_probability {self.clear_probability:g} must not be above "
                f"raise_probability {self.raise_probability:g}"
            )
        return self


def _conditions(context: AlarmContext, rule: ForecastLimitRule) -> Iterator[AlarmCondition]:
    """Between the probability that raises and the one that clears, an alarm stays as it is.

    A model that was never identified raises none: the verdict is unknown then, and the two agree.
    """
    for channel, levels in context.crossings.items():
        limits = context.limits[channel]
        for level, crossing in levels.items():
            limit_c = limits.warning if level == "warning" else limits.alarm
            active: bool | None = None
            if not context.identified:
                active = False
            elif crossing.probability >= rule.raise_probability:
                active = True
            elif crossing.probability < rule.clear_probability:
                active = False
            record = ""
            if active is not False:
                at_s = crossing.earliest_s if crossing.median_s is None else crossing.median_s
                said = context.record(channel, at_s)
                record = f"; {said}" if said else ""
            yield KIND.condition(
                context,
                rule,
                channel,
                level,
                active,
                _message(channel, level, limit_c, crossing.probability) + record,
                limit_value=limit_c,
                unit="°C",
                predicted=True,
                lead_time_s=crossing.earliest_s,
                probability=crossing.probability,
            )


def _message(channel: str, level: str, limit_c: float, probability: float) -> str:
    """Say what is expected, never more certain than the forecast is."""
    if probability >= CERTAIN_FROM:
        return f"{label(channel)} will exceed {level} {limit_c:g} °C"
    return f"{label(channel)} may exceed {level} {limit_c:g} °C, {percent(probability)}"


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    if context.is_present("measured limit", channel, level):
        return "the limit is already exceeded"
    return context.not_comparable


def _kept(context: AlarmContext) -> Iterable[tuple[str, str]]:
    """A forecast comes later than the first step."""
    return ((channel, level) for channel in context.limits for level in LEVELS)


def _points(subject: AlarmSubject, rule: ForecastLimitRule) -> Iterator[PossibleAlarm]:
    return pairs_of(subject.limits, "°C")


_GUIDANCE = Guidance(
    alarm_type="predicted (calculated)",
    probable_causes=(
        "the present point, or a planned step, is too heavy for the present cooling; "
        "ambient rises; friction grows"
    ),
    consequence_of_inaction="the temperature exceeds the limit within the forecast's horizon",
    operator_action=(
        "before the time to the limit is over: lower speed or load, or change the planned "
        "step; try the change as a what-if first"
    ),
    identification_method="forecast of the twin; the limit is that of the measured alarm",
    suppression=(
        "while the limit is already exceeded; while speed, load or ambient is unknown; "
        "while the model is not trusted; no alarm before the model was identified"
    ),
)

KIND = AlarmKind(
    "forecast limit",
    ForecastLimitRule,
    _conditions,
    _suppressed,
    _kept,
    judged="forecast",
    points=_points,
    guidance=_GUIDANCE,
)
