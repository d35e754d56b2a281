"""The clock of a source is ahead of the service's: its samples are moved back and are uncertain.

The alarm is one for all assets that are read from the source: an asset only says here whether its
own channels of the source have such a clock.
"""

from collections.abc import Iterator

from pydantic import Field

from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import CLOCK_AHEAD, DAY_S, AlarmContext, AlarmKind, PlainRule
from service.domain.causes import STALE_DATA, source_channel, source_of


class ClockAheadRule(PlainRule):
    """A source with a wrong clock."""

    # Before the sensor faults of its channels, which it explains.
    on_delay_s: float = Field(5.0, ge=0, le=DAY_S)
    off_delay_s: float = Field(10.0, ge=0, le=DAY_S)


def _conditions(context: AlarmContext, rule: ClockAheadRule) -> Iterator[AlarmCondition]:
    for source, channels in context.sources.channels.items():
        ahead = {
            channel: ahead_s
            for channel in channels
            if (ahead_s := context.readings.clock_ahead_s(channel)) is not None
            and not context.readings.is_silent(channel, context.now_us)
        }
        is_silent = not ahead and context.sources.is_lost(source) is not False
        by = f" by {max(ahead.values()):.0f} s" if ahead else ""
        yield KIND.condition(
            context,
            rule,
            source_channel(source),
            "",
            None if is_silent else bool(ahead),
            f"{source}: clock ahead{by}, values uncertain",
            covers=tuple(ahead),
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    if context.is_present(STALE_DATA, channel, ""):
        return f"source {source_of(channel)} lost"
    return None


def _points(subject: AlarmSubject, rule: ClockAheadRule) -> Iterator[PossibleAlarm]:
    return (PossibleAlarm(source_channel(source)) for source in subject.sources)


_GUIDANCE = Guidance(
    alarm_type="instrument diagnostic",
    alarm_class="instrument",
    probable_causes=(
        "gateway or server without a time server, clock set by hand, wrong time zone; "
        "clock of the service behind"
    ),
    consequence_of_inaction=(
        "limits raise no alarm, and the verdict is unknown: a hot bearing may stay unseen"
    ),
    operator_action="run no heavier step; have the clock of the device set, and its time server",
    suppression="while the whole source is lost",
)

KIND = AlarmKind(
    CLOCK_AHEAD, ClockAheadRule, _conditions, _suppressed, points=_points, guidance=_GUIDANCE
)
