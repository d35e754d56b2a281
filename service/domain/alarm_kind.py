"""What an alarm kind is: its settings, its conditions, and when it means nothing.

How to add one is described in ``CONTRIBUTING.md``: one file in ``service/alarm_kinds``.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Generic, Literal, Protocol, Self, TypeVar, cast

from pydantic import Field, model_validator

from adapters.samples import Sample
from service.domain.alarm_condition import AlarmCondition, Priority, Seen, SinceLastLook
from service.domain.alarm_guidance import (
    AlarmName,
    AlarmOverride,
    AlarmSubject,
    Guidance,
    PossibleAlarm,
    WarningAndAlarm,
)
from service.domain.causes import STALE_DATA, source_channel
from service.domain.channels import OPERATING_CHANNELS, label
from service.domain.section import Section

DAY_S = 86_400.0
LEVELS = ("warning", "alarm")
SENSOR_FAULT = "sensor fault"
CLOCK_AHEAD = "clock ahead"


# ---------------------------------------------------------------------------------- settings
class AlarmRule(Section):
    """What all kinds of alarms have in common; times are process seconds."""

    enabled: bool = True
    on_delay_s: float = Field(10.0, ge=0, le=DAY_S)
    off_delay_s: float = Field(60.0, ge=0, le=DAY_S)
    latched: bool = False
    #: An acknowledged alarm that stands so long is raised again; 0: never.
    re_alarm_s: float = Field(8 * 3600.0, ge=0, le=30 * DAY_S)


class PlainRule(AlarmRule):
    """An alarm of one level."""

    priority: Priority = 2

    def priority_of(self, level: str) -> Priority:
        """Give the priority, which is the same for every level."""
        return self.priority


class LevelRule(AlarmRule):
    """A warning and an alarm."""

    warning_priority: Priority = 2
    alarm_priority: Priority = 1

    def priority_of(self, level: str) -> Priority:
        """Give the priority of a level."""
        return self.alarm_priority if level == "alarm" else self.warning_priority


class Levels(Section):
    """Where a warning and an alarm are raised."""

    warning: float = Field(gt=0, le=500)
    alarm: float = Field(gt=0, le=500)

    @model_validator(mode="after")
    def _warning_comes_first(self) -> Self:
        if self.warning >= self.alarm:
            raise ValueError(f"warning {self.warning:g} must be below alarm {self.alarm:g}")
        return self


# ---------------------------------------------------------------------- what a kind looks at
class WithSource(Protocol):
    """What is known of a channel."""

    @property
    def source(self) -> str:
        """Name of the source that it is read from."""


class LatestReadings(Protocol):
    """The latest samples of an asset."""

    @property
    def latest(self) -> Mapping[str, Sample]:
        """The latest sample of each channel, good or not."""

    def good_value(self, channel: str, now_us: int) -> float | None:
        """Value of a channel if it is good and fresh."""

    def is_silent(self, channel: str, now_us: int) -> bool:
        """Whether a channel has sent nothing for too long."""

    def reason(self, channel: str, now_us: int) -> str:
        """Why a channel has no good value; empty when it has one."""

    def clock_ahead_s(self, channel: str) -> float | None:
        """Seconds by which the clock is ahead that sent the latest sample; None: it is not."""


class SilentSources(Protocol):
    """Which sources and channels have fallen silent."""

    @property
    def channels(self) -> Mapping[str, list[str]]:
        """The channels of every source."""

    def is_lost(self, source: str) -> bool | None:
        """Whether a whole source is silent; None while it is waited for."""

    def is_lost_alone(self, channel: str) -> bool | None:
        """Whether a channel is silent while its source is not; None if that is open."""


class SequentialTest(Protocol):
    """A sequential test for a shift, see `twin_core.cusum.Cusum`."""

    @property
    def high(self) -> float:
        """Sum of the values above zero."""

    @property
    def low(self) -> float:
        """Sum of the values below zero."""

    @property
    def value(self) -> float:
        """The greater of the two sums."""


class PredictedCrossing(Protocol):
    """How likely and when a forecast exceeds a limit."""

    @property
    def probability(self) -> float:
        """Of exceeding it within the horizon."""

    @property
    def median_s(self) -> float | None:
        """Seconds until half of the members have exceeded it."""

    @property
    def earliest_s(self) -> float | None:
        """Seconds until 2.5 % of the members have exceeded it."""


ForecastRecord = Callable[[str, float | None], str]
"""Says how forecasts of a channel so many seconds ahead have done; empty: unknown."""


def no_record(channel: str, lead_time_s: float | None) -> str:
    """Say nothing of earlier forecasts."""
    return ""


@dataclass(slots=True)
class AlarmContext:
    """What is known of an asset at one moment; what several kinds ask for is found once.

    - ``is_present``: whether the condition of another alarm of the asset is there, delays included:
      takes its kind, channel and level.
    - ``inputs``: what the network needs of the operation besides speed, load and ambient.
    - ``distrust``: why the model's word counts for nothing now; None where it counts.
    - ``rates_k_per_min``: how fast temperatures rise; None where unknown.
    - ``differences_k``: measured minus the model alone, by channel; None where unknown.
    - ``residual_tests``: what the observer did not expect, by channel.
    - ``residual_threshold``: above it such a test says that something has changed.
    - ``crossings``: how likely the forecast exceeds a limit, by channel and level; of a new
      forecast only.
    - ``record``: how earlier forecasts have done, for the text of a predicted alarm.
    - ``identified``: whether the model was identified; else its forecasts raise no alarm.
    - ``overrides``: what single alarms have otherwise than their kind says.
    - ``between``: what temperatures and ambient were since the last look.
    """

    asset: str
    limits: Mapping[str, WarningAndAlarm]
    channels: Mapping[str, WithSource]
    readings: LatestReadings
    sources: SilentSources
    now_us: int
    is_present: Callable[[str, str, str], bool]
    at_standstill: bool = False
    inputs: tuple[str, ...] = ()
    distrust: str | None = None
    temperatures: tuple[str, ...] = ()
    rates_k_per_min: Mapping[str, float | None] = field(default_factory=dict)
    differences_k: Mapping[str, float | None] = field(default_factory=dict)
    residual_tests: Mapping[str, SequentialTest] = field(default_factory=dict)
    residual_threshold: float = 0.0
    crossings: Mapping[str, Mapping[str, PredictedCrossing]] = field(default_factory=dict)
    record: ForecastRecord = no_record
    identified: bool = True
    overrides: Mapping[AlarmName, AlarmOverride] = field(default_factory=dict)
    between: SinceLastLook = field(default_factory=SinceLastLook)
    _values: dict[str, float | None] = field(default_factory=dict, init=False)
    _no_data: dict[str, str | None] = field(default_factory=dict, init=False)
    _unknown: tuple[str | None] | None = field(default=None, init=False)

    def good_value(self, channel: str) -> float | None:
        """Value of a channel if it is good and fresh."""
        if channel not in self._values:
            self._values[channel] = self.readings.good_value(channel, self.now_us)
        return self._values[channel]

    # -------------------------------------------------------------- reasons for suppression
    @property
    def standstill(self) -> str | None:
        """The reason "standstill", while the machine is at standstill."""
        return "standstill" if self.at_standstill else None

    def no_data(self, channel: str) -> str | None:
        """Reason that the channel sends nothing, which has an alarm of its own."""
        if channel not in self._no_data:
            missing = self._has_no_data(channel)
            self._no_data[channel] = f"no data for {label(channel).lower()}" if missing else None
        return self._no_data[channel]

    def wrong_clock(self, channel: str) -> str | None:
        """Reason that the clock of the channel's source is ahead, which has an alarm of its own."""
        facts = self.channels.get(channel)
        if facts is None or self.readings.clock_ahead_s(channel) is None:
            return None
        if not self.is_present(CLOCK_AHEAD, source_channel(facts.source), ""):
            return None
        return f"the clock of {facts.source} is ahead"

    @property
    def not_comparable(self) -> str | None:
        """Reason that the model is not trusted, or does not know the operation."""
        if self._unknown is None:
            self._unknown = (self._unknown_operation(),)
        return self.distrust or self._unknown[0]

    def _unknown_operation(self) -> str | None:
        for channel in (*OPERATING_CHANNELS, *self.inputs):
            if channel in self.channels and (
                self.no_data(channel) or self.is_present(SENSOR_FAULT, channel, "")
            ):
                return f"no usable {label(channel).lower()}"
        return None

    def _has_no_data(self, channel: str) -> bool:
        """Whether a stale-data alarm is there: the channel's own, or that of its source."""
        if self.is_present(STALE_DATA, channel, ""):
            return True
        facts = self.channels.get(channel)
        return facts is not None and self.is_present(STALE_DATA, source_channel(facts.source), "")


def pairs_of(
    limits: Mapping[str, WarningAndAlarm], unit: str, deadband_key: str = ""
) -> Iterator[PossibleAlarm]:
    """Give the warning and the alarm of each channel."""
    for channel, pair in limits.items():
        for level in LEVELS:
            yield PossibleAlarm(channel, level, pair, unit, deadband_key)


# ------------------------------------------------------------------------------------ a kind
Rule = TypeVar("Rule", bound=AlarmRule)
Setting = TypeVar("Setting")


def _or(changed: Setting | None, otherwise: Setting) -> Setting:
    return otherwise if changed is None else changed


def _never(context: AlarmContext, channel: str, level: str) -> None:
    """No reason for suppression."""


def _nothing_else(context: AlarmContext) -> Iterable[tuple[str, str]]:
    """No channel and level but those of the present conditions."""
    return ()


def _no_points(subject: AlarmSubject, rule: AlarmRule) -> Iterator[PossibleAlarm]:
    """No alarm that can be named before it comes."""
    return iter(())


_UNCHANGED = AlarmOverride()
_NO_GUIDANCE = Guidance()


@lru_cache(maxsize=4096)
def _over(channel: str, text: str, level: str, limit: float) -> str:
    """Say that a value is over its limit: the same words every second, for all assets alike."""
    return f"{label(channel)} {text.format(level=level, limit=limit)}"


@dataclass(frozen=True)
class AlarmKind(Generic[Rule]):
    """One kind of alarm.

    - ``name``: as in alarms and the journal; with underscores it is the table of its settings and
      the name of its file.
    - ``rule``: model of its settings; every key has a default.
    - ``conditions``: which conditions there are now, from the context and the settings. A condition
      is True, False, or None where it is unknown (no good sample): an alarm then stays as it
      is. No condition looks at a sample that is not good.
    - ``suppressed``: why an alarm of a channel and level would mean nothing now (suppressed by
      design).
    - ``kept``: channels and levels that `conditions` may name later; an alarm of any other one
      comes from an earlier configuration and is withdrawn.
    - ``judged``: after each ``step`` of the live twin, or after each new ``forecast``.
    - ``points``: every alarm of the kind that an asset can have: the rows of the rationalisation
      sheet.
    - ``guidance``: what the sheet says of the kind until an engineer writes better texts.
    """

    name: str
    rule: type[Rule]
    conditions: Callable[[AlarmContext, Rule], Iterator[AlarmCondition]]
    suppressed: Callable[[AlarmContext, str, str], str | None] = _never
    kept: Callable[[AlarmContext], Iterable[tuple[str, str]]] = _nothing_else
    judged: Literal["step", "forecast"] = "step"
    points: Callable[[AlarmSubject, Rule], Iterator[PossibleAlarm]] = _no_points
    guidance: Guidance = _NO_GUIDANCE

    @property
    def key(self) -> str:
        """Name of the table of its settings, and of its file."""
        return self.name.replace(" ", "_")

    def condition(
        self,
        context: AlarmContext,
        rule: LevelRule | PlainRule,
        channel: str,
        level: str,
        active: bool | None,
        message: str,
        *,
        value: float | None = None,
        limit_value: float | None = None,
        deadband: float = 0.0,
        unit: str | None = None,
        predicted: bool = False,
        lead_time_s: float | None = None,
        probability: float | None = None,
        covers: tuple[str, ...] = (),
    ) -> AlarmCondition:
        """Report the state of one alarm, with the delays and priority of its rule."""
        priority, on_delay_s, off_delay_s = (
            rule.priority_of(level),
            rule.on_delay_s,
            rule.off_delay_s,
        )
        latched, re_alarm_s = rule.latched, rule.re_alarm_s
        overrides = context.overrides
        changed = overrides.get((self.name, channel, level)) if overrides else None
        if changed is not None:
            priority = cast(Priority, _or(changed.priority, priority))
            on_delay_s = _or(changed.on_delay_s, on_delay_s)
            off_delay_s = _or(changed.off_delay_s, off_delay_s)
            deadband = _or(changed.deadband, deadband)
            latched = _or(changed.latched, latched)
            re_alarm_s = _or(changed.re_alarm_s, re_alarm_s)
        # In the order of the fields: by name it takes three times as long, see `AlarmCondition`.
        return AlarmCondition(
            context.asset,
            self.name,
            channel,
            level,
            active,
            value,
            message,
            priority,
            predicted,
            lead_time_s,
            probability,
            on_delay_s,
            off_delay_s,
            limit_value,
            deadband,
            unit,
            latched,
            re_alarm_s,
            self.suppressed(context, channel, level),
            covers,
        )

    def over_limits(
        self,
        context: AlarmContext,
        rule: LevelRule,
        channel: str,
        value: float | None,
        limits: WarningAndAlarm,
        text: str,
        *,
        deadband: float,
        unit: str,
        between: Sequence[Seen] = (),
    ) -> Iterator[AlarmCondition]:
        """Report for both levels whether a value, None if it is not known, is at or over its limit.

        The message is the channel's name and the text with `level` and `limit` put in;
        ``between``: what the value was since the last look.
        """
        for level, usual in zip(LEVELS, (limits.warning, limits.alarm), strict=True):
            limit = usual
            if context.overrides:
                changed = context.overrides.get((self.name, channel, level), _UNCHANGED)
                limit = _or(changed.setpoint, usual)
            condition = self.condition(
                context,
                rule,
                channel,
                level,
                None if value is None else value >= limit,
                _over(channel, text, level, limit),
                value=value,
                limit_value=limit,
                deadband=deadband,
                unit=unit,
            )
            condition.between = between
            yield condition
