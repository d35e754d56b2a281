"""A measured temperature too far above the measured ambient temperature."""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition, Seen
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import AlarmContext, AlarmKind, LevelRule, Levels, pairs_of
from service.domain.channels import AMBIENT


class AboveAmbientRule(LevelRule):
    """A temperature that is too far above the ambient one; ``limits`` in K by channel."""

    deadband_k: float = Field(1.0, ge=0, le=50)
    limits: dict[str, Levels] = Field(default_factory=dict)


def _conditions(context: AlarmContext, rule: AboveAmbientRule) -> Iterator[AlarmCondition]:
    ambient_c = context.good_value(AMBIENT)
    for channel, limits in rule.limits.items():
        value = context.good_value(channel)
        yield from KIND.over_limits(
            context,
            rule,
            channel,
            _above(value, ambient_c),
            limits,
            "over {level} {limit:g} K above ambient",
            deadband=rule.deadband_k,
            unit="K",
            between=_between(context, channel),
        )


def _between(context: AlarmContext, channel: str) -> list[Seen]:
    """What the difference was at each sample of a temperature since the last look."""
    ambient = list(context.between.get(AMBIENT, ()))
    if ambient and context.good_value(AMBIENT) is None:
        ambient[-1] = ambient[-1][0], None
    differences: list[Seen] = []
    ambient_c: float | None = None
    for at_us, value_c in context.between.get(channel, ()):
        while ambient and ambient[0][0] <= at_us:
            ambient_c = ambient.pop(0)[1]
        differences.append((at_us, _above(value_c, ambient_c)))
    return differences


def _above(value_c: float | None, ambient_c: float | None) -> float | None:
    return None if value_c is None or ambient_c is None else round(value_c - ambient_c, 3)


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.standstill if level == "warning" else None


def _points(subject: AlarmSubject, rule: AboveAmbientRule) -> Iterator[PossibleAlarm]:
    return pairs_of(rule.limits, "K", "deadband_k")


_GUIDANCE = Guidance(
    alarm_type="deviation",
    probable_causes=(
        "friction higher than usual: grease, preload, damage; "
        "speed or load too high; heat from outside (shaft, motor)"
    ),
    consequence_of_inaction="the bearing reaches its temperature limit on the next warm day",
    operator_action=(
        "lower speed or load; compare with the other rings and the cooling; "
        "plan regreasing or inspection when it stays"
    ),
    identification_method="set by the site from normal operation",
    suppression="warning: at standstill; alarm: never",
)

KIND = AlarmKind(
    "above ambient", AboveAmbientRule, _conditions, _suppressed, points=_points, guidance=_GUIDANCE
)
