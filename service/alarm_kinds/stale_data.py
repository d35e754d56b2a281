"""No sample for too long: one alarm of a source that has fallen silent, else of the channel.

The alarm of a source is one for all assets that are read from it: an asset only says here whether
its own part of the source is silent. What has never sent anything is waited for; it raises nothing.
"""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import DAY_S, AlarmContext, AlarmKind, PlainRule
from service.domain.causes import STALE_DATA, has_own_alarm, source_channel
from service.domain.channels import label


class StaleDataRule(PlainRule):
    """A channel or a whole source without any value."""

    off_delay_s: float = Field(10.0, ge=0, le=DAY_S)


def _conditions(context: AlarmContext, rule: StaleDataRule) -> Iterator[AlarmCondition]:
    for source, channels in context.sources.channels.items():
        if not has_own_alarm(source, channels):
            continue
        what = f"{len(channels)} channels" if len(channels) > 1 else label(channels[0]).lower()
        yield KIND.condition(
            context,
            rule,
            source_channel(source),
            "",
            context.sources.is_lost(source),
            f"No data from {source} ({what})",
            covers=tuple(channels),
        )
    for channel, facts in context.channels.items():
        yield KIND.condition(
            context,
            rule,
            channel,
            "",
            context.sources.is_lost_alone(channel),
            f"{label(channel)}: no data from {facts.source}",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    if channel in context.channels:
        source = context.channels[channel].source
        if context.is_present(STALE_DATA, source_channel(source), ""):
            return f"source {source} lost"
    return None


def _points(subject: AlarmSubject, rule: StaleDataRule) -> Iterator[PossibleAlarm]:
    for source, channels in subject.sources.items():
        if has_own_alarm(source, channels):
            yield PossibleAlarm(source_channel(source))
    for channel in subject.channels:
        yield PossibleAlarm(channel)


_GUIDANCE = Guidance(
    alarm_type="instrument diagnostic",
    alarm_class="instrument",
    probable_causes="device without power, network or bus cut, gateway or program stopped",
    consequence_of_inaction=(
        "limits raise no alarm, and the verdict is unknown: a hot bearing may stay unseen"
    ),
    operator_action=(
        "run no heavier step; check power and network of the device; "
        "stop the machine if the temperatures stay unknown"
    ),
    suppression="of a channel: while its whole source is lost",
)

KIND = AlarmKind(
    STALE_DATA, StaleDataRule, _conditions, _suppressed, points=_points, guidance=_GUIDANCE
)
