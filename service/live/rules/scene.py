"""What every rule looks at, and how it says what it found."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from service.alarms import AlarmCondition, AlarmKind
from service.domain.channels import OPERATING_CHANNELS, label
from service.live.readings import Readings
from service.live.sources import Sources
from service.site.alarm_settings import AlarmsSection, LevelRule, Levels, PlainRule
from service.site.settings import Limits
from service.site.wiring import ChannelFacts

LEVELS = ("warning", "alarm")
_RUNNING_KINDS = frozenset({"rate of rise", "twin difference", "twin residual"})


@dataclass(frozen=True, slots=True)
class Scene:
    """What is known of an asset at one moment.

    Attributes
    ----------
    asset : str
        Which.
    rules : AlarmsSection
        Its configuration of alarms.
    limits : mapping of str to Limits
        Its temperature limits by channel.
    channels : mapping of str to ChannelFacts
        All that is read of it.
    readings : Readings
        The latest samples.
    sources : Sources
        Which of them have fallen silent.
    now_us : int
        Process time.
    is_present : callable
        Whether the condition of another alarm of the asset is there, delays included: takes its
        kind, channel and level.
    stands : bool
        Whether the machine stands.
    inputs : tuple of str
        What the network needs of the operation besides speed, load and ambient.
    distrust : str or None
        Why the model's word counts for nothing now; None where it counts.
    """

    asset: str
    rules: AlarmsSection
    limits: Mapping[str, Limits]
    channels: Mapping[str, ChannelFacts]
    readings: Readings
    sources: Sources
    now_us: int
    is_present: Callable[[AlarmKind, str, str], bool]
    stands: bool = False
    inputs: tuple[str, ...] = ()
    distrust: str | None = None

    def good_value(self, channel: str) -> float | None:
        """Value of a channel if it is good and fresh."""
        return self.readings.good_value(channel, self.now_us)

    def condition(
        self,
        rule: LevelRule | PlainRule,
        kind: AlarmKind,
        channel: str,
        level: str,
        active: bool | None,
        message: str,
        **facts: Any,
    ) -> AlarmCondition:
        """Say how it stands with one alarm, with the delays and priority of its rule."""
        priority = rule.priority_of(level) if isinstance(rule, LevelRule) else rule.priority
        return AlarmCondition(
            asset=self.asset,
            kind=kind,
            channel=channel,
            level=level,
            active=active,
            message=message,
            priority=priority,
            on_delay_s=rule.on_delay_s,
            off_delay_s=rule.off_delay_s,
            latched=rule.latched,
            re_alarm_s=rule.re_alarm_s,
            suppressed_reason=self.suppressed(kind, channel, level),
            **({"value": None} | facts),
        )

    def over_limits(
        self,
        rule: LevelRule,
        kind: AlarmKind,
        channel: str,
        value: float | None,
        limits: Limits | Levels,
        text: str,
        *,
        deadband: float,
        unit: str,
    ) -> Iterator[AlarmCondition]:
        """Say of both levels whether a value, None if it cannot be told, is at or over its limit.

        The message is the channel's name and the text with `level` and `limit` put in.
        """
        for level in LEVELS:
            limit = getattr(limits, level)
            yield self.condition(
                rule,
                kind,
                channel,
                level,
                None if value is None else value >= limit,
                f"{label(channel)} {text.format(level=level, limit=limit)}",
                value=value,
                limit_value=limit,
                deadband=deadband,
                unit=unit,
            )

    # ------------------------------------------------------------------ suppressed by design
    def suppressed(self, kind: AlarmKind, channel: str, level: str) -> str | None:
        """Why an alarm would mean nothing now; the rules of suppression by design, all of them.

        The alarm level of a measured limit is never suppressed: a speed sensor that wrongly says
        zero must not silence a hot bearing.
        """
        if self.stands and (
            kind in _RUNNING_KINDS
            or (kind in ("measured limit", "above ambient") and level == "warning")
        ):
            return "standstill"
        if kind == "forecast limit" and self.is_present("measured limit", channel, level):
            return "the limit is exceeded already"
        if kind == "stale data" and channel in self.channels:
            source = self.channels[channel].source
            if self.is_present("stale data", source_channel(source), ""):
                return f"source {source} lost"
        if kind in ("sensor fault", *_RUNNING_KINDS) and self._has_no_data(channel):
            return f"no data for {label(channel).lower()}"
        if kind in ("forecast limit", "twin difference", "twin residual"):
            return self.distrust or self._blind()
        return None

    def _blind(self) -> str | None:
        """Name what the twin would have to know of the operation and does not."""
        for channel in (*OPERATING_CHANNELS, *self.inputs):
            if channel in self.channels and (
                self._has_no_data(channel) or self.is_present("sensor fault", channel, "")
            ):
                return f"no usable {label(channel).lower()}"
        return None

    def _has_no_data(self, channel: str) -> bool:
        """Whether a stale-data alarm is there: the channel's own, or that of its source."""
        if self.is_present("stale data", channel, ""):
            return True
        source = self.channels[channel].source if channel in self.channels else None
        return source is not None and self.is_present("stale data", source_channel(source), "")


def source_channel(source: str) -> str:
    """Name under which a whole source stands among the channels of alarms."""
    return f"source:{source}"
