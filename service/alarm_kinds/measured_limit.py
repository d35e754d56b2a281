"""A measured temperature at or above its warning or alarm limit."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_kind import AlarmContext, AlarmKind, LevelRule


class Settings(LevelRule):
    """A temperature over its limit in ``[assets.limits]``."""

    # 1 % of a range of 0 to 100 degrees.
    deadband_k: float = Field(1.0, ge=0, le=50)


def _conditions(context: AlarmContext, rule: Settings) -> Iterator[AlarmCondition]:
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
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    """The alarm level never: a speed sensor that wrongly shows zero must not silence it."""
    return context.standstill if level == "warning" else None


KIND = AlarmKind("measured limit", Settings, _conditions, _suppressed)
