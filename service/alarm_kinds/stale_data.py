"""No sample for too long: one alarm of a source that has fallen silent, else of the channel.

What has never sent anything is waited for; it raises nothing.
"""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmPoint, AlarmSubject, Guidance
from service.domain.alarm_kind import (
    DAY_S,
    STALE_DATA,
    AlarmContext,
    AlarmKind,
    PlainRule,
    source_channel,
)
from service.domain.channels import label


class Settings(PlainRule):
    """A channel or a whole source without any value."""

    off_delay_s: float = Field(10.0, ge=0, le=DAY_S)


def _conditions(context: AlarmContext, rule: Settings) -> Iterator[AlarmCondition]:
    for source, channels in context.sources.channels.items():
        if len(channels) > 1:
            yield KIND.condition(
                context,
                rule,
                source_channel(source),
                "",
                context.sources.is_lost(source),
                f"No data from {source} ({len(channels)} channels)",
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


def _points(subject: AlarmSubject, rule: Settings) -> Iterator[AlarmPoint]:
    for source, channels in subject.sources.items():
        if len(channels) > 1:
            yield AlarmPoint(source_channel(source))
    for channel in subject.channels:
        yield AlarmPoint(channel)


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

KIND = AlarmKind(STALE_DATA, Settings, _conditions, _suppressed, points=_points, guidance=_GUIDANCE)
