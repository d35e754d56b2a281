"""Readings on a clock that a test moves, and what the kinds of alarms make of them."""

from dataclasses import dataclass, field
from typing import Any

from adapters.samples import Quality, Sample
from service.alarm_kinds import KINDS, AlarmsSection
from service.alarms import AlarmBook, AlarmCondition
from service.domain.alarm_kind import AlarmContext
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.live.sources import Sources
from service.site.asset_section import LimitsSection
from service.site.wiring import ChannelFacts

NOW_US = 1_763_700_000_000_000
RING = "t_inner_ring_c"
LIMITS = {RING: LimitsSection(warning=70, alarm=95)}
FACTS = {
    RING: ChannelFacts("pt100", 10.0),
    "ambient_c": ChannelFacts("pt100", 10.0),
    "speed_rpm": ChannelFacts("drive", 10.0),
}


@dataclass
class Bench:
    """Readings of two channels on a clock that a test moves, and an alarm book behind them."""

    readings: Readings
    book: AlarmBook | None = None
    now_us: int = NOW_US
    present: set[tuple[str, str, str]] = field(default_factory=set)
    facts: dict[str, Any] = field(default_factory=dict)
    section: AlarmsSection = field(default_factory=AlarmsSection)

    def __post_init__(self) -> None:
        self.sources = Sources(FACTS, self.readings)

    def read(self, value: float, quality: int = Quality.GOOD, channel: str = RING) -> None:
        sample = Sample("bench-1", channel, self.now_us, value, quality, self.now_us)
        self.readings.add([sample])

    def context(self, **evidence: Any) -> AlarmContext:
        self.sources.look(self.now_us)
        return AlarmContext(
            "bench-1",
            LIMITS,
            FACTS,
            self.readings,
            self.sources,
            self.now_us,
            lambda kind, channel, level: (kind, channel, level) in self.present,
            **self.facts,
            **evidence,
        )

    def conditions(self, kind: str, **evidence: Any) -> list[AlarmCondition]:
        """The conditions of one kind, from what is known and this evidence."""
        found = KINDS[kind].conditions(self.context(**evidence), self.section.rule(KINDS[kind]))
        return list(found)

    def measured(self) -> dict[str, AlarmCondition]:
        return {condition.level: condition for condition in self.conditions("measured limit")}

    def forecast(self, **crossing: float | None) -> AlarmCondition:
        """The condition of the warning limit for one crossing."""
        given = {"probability": 0.0, "median_s": None, "earliest_s": None} | crossing
        crossings = {RING: {"warning": LimitCrossing(**given)}}  # type: ignore[arg-type]
        (condition,) = self.conditions("forecast limit", crossings=crossings)
        return condition

    def sensors(self) -> dict[str, AlarmCondition]:
        found = (*self.conditions("stale data"), *self.conditions("sensor fault"))
        return {condition.kind: condition for condition in found if condition.channel == RING}

    def hold(self, value: float, seconds: float) -> list[tuple[str, str]]:
        """Read a value every second so long; (level, state) of the measured alarms then."""
        assert self.book is not None
        for _ in range(round(seconds)):
            self.now_us += 1_000_000
            self.read(value)
            for condition in self.measured().values():
                self.book.evaluate(condition)
        return sorted((alarm.level, alarm.state) for alarm in self.book.active())


class SceneClock:
    """The scene's time as the alarm book sees it."""

    rate = 1.0

    def __init__(self, scene: Bench) -> None:
        self._scene = scene

    def now_us(self) -> int:
        return self._scene.now_us

    async def sleep(self, process_seconds: float) -> None:
        self._scene.now_us += round(process_seconds * 1e6)
