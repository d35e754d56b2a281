"""Readings that fall to one side of what the twin expects, again and again."""

from collections.abc import Iterable, Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition, Priority
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import DAY_S, AlarmContext, AlarmKind, PlainRule
from service.domain.channels import label


class TwinResidualRule(PlainRule):
    """A machine that does not do what its model says, found by a sequential test."""

    priority: Priority = 3
    on_delay_s: float = Field(0.0, ge=0, le=DAY_S)
    off_delay_s: float = Field(0.0, ge=0, le=DAY_S)
    #: All temperatures of the asset together, while the machine runs.
    false_alarms_per_1000_h: float = Field(0.5, gt=0, le=100)


def _conditions(context: AlarmContext, rule: TwinResidualRule) -> Iterator[AlarmCondition]:
    threshold = context.residual_threshold
    for channel, test in context.residual_tests.items():
        side = "hotter" if test.high >= test.low else "colder"
        value = test.value
        yield KIND.condition(
            context,
            rule,
            channel,
            "",
            value > threshold,
            f"{label(channel)} repeatedly {side} than the twin expects",
            value=round(value, 2),
            limit_value=threshold,
            deadband=0.5 * threshold,
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.standstill or context.no_data(channel) or context.not_comparable


def _kept(context: AlarmContext) -> Iterable[tuple[str, str]]:
    """The tests begin when there is an identified model."""
    return ((channel, "") for channel in context.temperatures)


def _points(subject: AlarmSubject, rule: TwinResidualRule) -> Iterator[PossibleAlarm]:
    return (PossibleAlarm(channel) for channel in subject.temperatures)


_GUIDANCE = Guidance(
    alarm_type="statistical",
    alarm_class="condition monitoring",
    probable_causes=(
        "a slow change of friction or cooling: grease bleeds, filter or fan dirty; sensor drifts"
    ),
    consequence_of_inaction="the change grows for hours or days until other alarms come",
    operator_action=(
        "check cooling and the sensor at the next stop; plan regreasing; "
        "identify again when the machine was changed"
    ),
    identification_method="sequential test of the observer's residuals",
    suppression=(
        "at standstill; while the channel sends no data; "
        "while the operation is unknown or the model is not trusted"
    ),
)

KIND = AlarmKind(
    "twin residual",
    TwinResidualRule,
    _conditions,
    _suppressed,
    _kept,
    points=_points,
    guidance=_GUIDANCE,
)
