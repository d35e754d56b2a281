"""A measured temperature that rises faster than any healthy operation makes it."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import AlarmContext, AlarmKind, LevelRule, Levels, pairs_of


class RateOfRiseRule(LevelRule):
    """A temperature that rises too fast, in K/min over a window."""

    window_s: float = Field(300.0, ge=60, le=3600)
    deadband_k_per_min: float = Field(0.5, ge=0, le=50)
    limits: Levels = Levels(warning=4.0, alarm=8.0)


def _conditions(context: AlarmContext, rule: RateOfRiseRule) -> Iterator[AlarmCondition]:
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


def _points(subject: AlarmSubject, rule: RateOfRiseRule) -> Iterator[PossibleAlarm]:
    return pairs_of(dict.fromkeys(subject.temperatures, rule.limits), "K/min", "deadband_k_per_min")


_GUIDANCE = Guidance(
    alarm_type="rate-of-change",
    probable_causes=(
        "the bearing begins to seize; thermal runaway of friction; lubricant lost; "
        "a step of speed or load that is far too large"
    ),
    consequence_of_inaction="the bearing seizes within minutes, before a limit is reached",
    operator_action=(
        "unload and stop the machine at once; turn it by hand and inspect the grease "
        "before it starts again"
    ),
    identification_method="faster than any healthy start",
    suppression="at standstill; while the channel sends no data",
)

KIND = AlarmKind(
    "rate of rise", RateOfRiseRule, _conditions, _suppressed, points=_points, guidance=_GUIDANCE
)
