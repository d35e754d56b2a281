"""A sensor that sends, but nothing usable: its latest sample is not good."""

from collections.abc import Iterator

from pydantic import Field

from adapters.samples import is_good
from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_kind import DAY_S, SENSOR_FAULT, AlarmContext, AlarmKind, PlainRule
from service.domain.channels import label


class Settings(PlainRule):
    """A sensor without a usable value."""

    off_delay_s: float = Field(10.0, ge=0, le=DAY_S)


def _conditions(context: AlarmContext, rule: Settings) -> Iterator[AlarmCondition]:
    for channel, facts in context.channels.items():
        faulty: bool | None = False
        why = ""
        if context.good_value(channel) is None:
            sample = context.readings.latest.get(channel)
            if sample is None or context.readings.is_silent(channel, context.now_us):
                faulty = None
            elif not is_good(sample.quality):
                faulty = True
                why = f" ({context.readings.reason(channel, context.now_us)})"
        yield KIND.condition(
            context,
            rule,
            channel,
            "",
            faulty,
            f"{label(channel)}: no usable value from {facts.source}{why}",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.no_data(channel)


KIND = AlarmKind(SENSOR_FAULT, Settings, _conditions, _suppressed)
