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
        sample = context.readings.latest.get(channel)
        silent = context.readings.is_silent(channel, context.now_us)
        faulty = sample is not None and not silent and not is_good(sample.quality)
        why = f" ({context.readings.reason(channel, context.now_us)})" if faulty else ""
        yield KIND.condition(
            context,
            rule,
            channel,
            "",
            None if sample is None or silent else faulty,
            f"{label(channel)}: no usable value from {facts.source}{why}",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.no_data(channel)


KIND = AlarmKind(SENSOR_FAULT, Settings, _conditions, _suppressed)
