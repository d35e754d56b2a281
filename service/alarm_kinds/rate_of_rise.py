"""A measured temperature that rises faster than any healthy operation makes it."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_kind import AlarmContext, AlarmKind, LevelRule, Levels


class Settings(LevelRule):
    """A temperature that rises too fast, in K/min over a window."""

    window_s: float = Field(300.0, ge=60, le=3600)
    deadband_k_per_min: float = Field(0.5, ge=0, le=50)
    limits: Levels = Levels(warning=4.0, alarm=8.0)


def _conditions(context: AlarmContext, rule: Settings) -> Iterator[AlarmCondition]:
    for channel, rate in context.rates_k_per_min.items():
        yield from KIND.over_limits(
            context,
            rule,
            channel,
            rate,
            rule.limits,
            "rises by more than {limit:g} K/min ({level})",
            deadband=rule.deadband_k_per_min,
            unit="K/min",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.standstill or context.no_data(channel)


KIND = AlarmKind("rate of rise", Settings, _conditions, _suppressed)
