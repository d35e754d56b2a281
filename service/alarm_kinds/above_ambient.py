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
    """What the difference was at each sample of the two since the last look; each holds."""
    seen, before = context.between.seen, context.between.before
    present = {name: before.get(name) for name in (channel, AMBIENT)}
    changes = [(at_us, name, value) for name in present for at_us, value in seen.get(name, ())]
    differences: list[Seen] = []
    for at_us, name, value in sorted(changes, key=lambda change: change[0]):
        present[name] = value
        differences.append((at_us, _above(present[channel], present[AMBIENT])))
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
