"""A measured temperature at or above its warning or alarm limit."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import AlarmContext, AlarmKind, LevelRule, pairs_of


class MeasuredLimitRule(LevelRule):
    """A temperature over its limit in ``[assets.limits]``."""

    # 1 % of a range of 0 to 100 degrees.
    deadband_k: float = Field(1.0, ge=0, le=50)


def _conditions(context: AlarmContext, rule: MeasuredLimitRule) -> Iterator[AlarmCondition]:
    for channel, limits in context.limits.items():
        yield from KIND.over_limits(
            context,
            rule,
            channel,
            context.good_value(channel),
            limits,
            "over {level} {limit:g} °C",
            deadband=rule.deadband_k,
            unit="°C",
            between=context.between.seen.get(channel, ()),
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    """The alarm level never: a speed sensor that wrongly shows zero must not silence it."""
    return context.standstill if level == "warning" else None


def _points(subject: AlarmSubject, rule: MeasuredLimitRule) -> Iterator[PossibleAlarm]:
    measured = {name: pair for name, pair in subject.limits.items() if name in subject.channels}
    return pairs_of(measured, "°C", "deadband_k")


_GUIDANCE = Guidance(
    alarm_type="absolute",
    probable_causes=(
        "speed or load too high for the present cooling; too much, too little or old grease; "
        "cooling lost (fan, ambient); bearing damaged or preloaded"
    ),
    consequence_of_inaction=(
        "warning: the temperature reaches the alarm limit; "
        "alarm: grease ages fast and leaves the contact, the bearing can seize"
    ),
    operator_action=(
        "warning: lower speed or load to those of the last step without this alarm, check cooling; "
        "alarm: unload and stop the machine, find the cause before it starts again"
    ),
    identification_method="limit of the bearing's maker, lowered by the site",
    suppression="warning: at standstill; alarm: never",
)

KIND = AlarmKind(
    "measured limit",
    MeasuredLimitRule,
    _conditions,
    _suppressed,
    points=_points,
    guidance=_GUIDANCE,
)
