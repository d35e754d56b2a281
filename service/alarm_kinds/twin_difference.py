"""A measured temperature that is hotter than the model alone says."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import (
    DAY_S,
    AlarmContext,
    AlarmKind,
    LevelRule,
    Levels,
    pairs_of,
)


class TwinDifferenceRule(LevelRule):
    """A temperature that is hotter than the model alone says, in K."""

    on_delay_s: float = Field(600.0, ge=0, le=DAY_S)
    off_delay_s: float = Field(600.0, ge=0, le=DAY_S)
    deadband_k: float = Field(0.5, ge=0, le=50)
    limits: Levels = Levels(warning=5.0, alarm=8.0)


def _conditions(context: AlarmContext, rule: TwinDifferenceRule) -> Iterator[AlarmCondition]:
    for channel, difference_k in context.differences_k.items():
        yield from KIND.over_limits(
            context,
            rule,
            channel,
            difference_k,
            rule.limits,
            "{limit:g} K hotter than the model alone ({level})",
            deadband=rule.deadband_k,
            unit="K",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.standstill or context.no_data(channel) or context.not_comparable


def _points(subject: AlarmSubject, rule: TwinDifferenceRule) -> Iterator[PossibleAlarm]:
    return pairs_of(dict.fromkeys(subject.temperatures, rule.limits), "K", "deadband_k")


_GUIDANCE = Guidance(
    alarm_type="deviation",
    probable_causes=(
        "friction higher than when the model was identified: grease, preload, damage; "
        "cooling worse; load or speed signal wrong; sensor drifts"
    ),
    consequence_of_inaction=(
        "the change grows unseen until a temperature limit is exceeded; forecasts are too cold"
    ),
    operator_action=(
        "compare with the other temperatures and check cooling and load signal; "
        "plan regreasing or inspection; identify again when the machine was changed"
    ),
    identification_method="comparison with the identified model",
    suppression=(
        "at standstill; while the channel sends no data; "
        "while the operation is unknown or the model is not trusted"
    ),
)

KIND = AlarmKind(
    "twin difference",
    TwinDifferenceRule,
    _conditions,
    _suppressed,
    points=_points,
    guidance=_GUIDANCE,
)
