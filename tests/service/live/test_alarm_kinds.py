"""Which alarm conditions hold, and what the alarm book makes of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from adapters.samples import Quality, Sample, meaning
from service.alarm_kinds import KINDS, AlarmsSection
from service.alarms import AlarmBook, AlarmCondition
from service.domain.alarm_kind import AlarmContext
from service.live.presentation import LimitCrossing
from service.live.readings import Readings, allowed_age_s
from service.live.sources import Sources
from service.site.asset_section import Limits
from service.site.wiring import ChannelFacts
from service.store import Alarm, Outbox, Store
from twin_core.cusum import Cusum

NOW_US = 1_763_700_000_000_000
RING = "t_inner_ring_c"
LIMITS = {RING: Limits(warning=70, alarm=95)}
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


@pytest.fixture
def scene() -> Bench:
    return Bench(Readings("bench-1", dict.fromkeys(FACTS, 10.0), NOW_US))


class SceneClock:
    """The scene's time as the alarm book sees it."""

    rate = 1.0

    def __init__(self, scene: Bench) -> None:
        self._scene = scene

    def now_us(self) -> int:
        return self._scene.now_us

    async def sleep(self, process_seconds: float) -> None:
        self._scene.now_us += round(process_seconds * 1e6)


@pytest.fixture
def told() -> list[Alarm]:
    return []


@pytest.fixture
def booked(scene: Bench, told: list[Alarm], tmp_path: Path) -> Iterator[Bench]:
    with Store.open("", tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        scene.book = AlarmBook(outbox, SceneClock(scene), told.append)
        yield scene


# ---------------------------------------------------------------------- measured limit
@pytest.mark.parametrize(
    ("value", "warning", "alarm"),
    [(69.9, False, False), (70.0, True, False), (94.9, True, False), (95.0, True, True)],
)
def test_a_measured_limit_is_passed_at_its_value(
    scene: Bench, value: float, warning: bool, alarm: bool
) -> None:
    scene.read(value)
    conditions = scene.measured()
    assert {level: one.active for level, one in conditions.items()} == {
        "warning": warning,
        "alarm": alarm,
    }
    assert conditions["warning"].kind == "measured limit"
    assert conditions["warning"].message == "Inner ring over warning 70 °C"
    assert conditions["warning"].value == value
    assert not conditions["warning"].predicted
    assert (conditions["alarm"].priority, conditions["warning"].priority) == (1, 2)


def test_a_measured_limit_cannot_be_told_without_a_good_fresh_value(scene: Bench) -> None:
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(99.0, Quality.UNCERTAIN)
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(math.nan, Quality.SENSOR_FAILURE)
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(99.0)
    assert [one.active for one in scene.measured().values()] == [True, True]
    scene.now_us += 11_000_000
    assert [one.active for one in scene.measured().values()] == [None, None]


def test_a_measured_alarm_has_delays_and_a_deadband(booked: Bench) -> None:
    assert booked.hold(70.2, 9) == []
    assert booked.hold(70.2, 3) == [("warning", "UNACK")]
    assert booked.hold(69.3, 600) == [("warning", "UNACK")], "within the deadband of 1 K"
    assert booked.hold(68.9, 50) == [("warning", "UNACK")], "not for long enough yet"
    assert booked.hold(68.9, 15) == [("warning", "RTNUN")]


def test_a_measured_alarm_stays_while_nobody_can_tell(booked: Bench, told: list[Alarm]) -> None:
    assert booked.hold(71.0, 12) == [("warning", "UNACK")]
    for _ in range(300):
        booked.now_us += 1_000_000
        booked.read(math.nan, Quality.SENSOR_FAILURE)
        for condition in booked.measured().values():
            assert booked.book is not None
            booked.book.evaluate(condition)
    assert [alarm.state for alarm in told] == ["UNACK"]


# ---------------------------------------------------------------------- forecast limit
def test_a_probable_crossing_is_announced_with_its_lead_time(scene: Bench) -> None:
    scene.read(50.0)
    condition = scene.forecast(probability=0.9, median_s=2400.0, earliest_s=1500.0)
    assert condition.kind == "forecast limit"
    assert condition.active is True
    assert condition.predicted
    assert (condition.probability, condition.lead_time_s) == (0.9, 1500.0), "the earliest"
    assert condition.message == "Inner ring will exceed warning 70 °C"
    assert condition.value is None, "what is forecast was not measured"


def test_a_possible_crossing_has_the_earliest_time(scene: Bench) -> None:
    condition = scene.forecast(probability=0.3, median_s=None, earliest_s=5400.0)
    assert condition.active is True
    assert condition.lead_time_s == 5400.0
    assert condition.message == "Inner ring may exceed warning 70 °C"


@pytest.mark.parametrize(
    ("probability", "active"), [(0.0, False), (0.09, False), (0.1, None), (0.19, None), (0.2, True)]
)
def test_between_raising_and_withdrawing_the_alarm_stays_as_it_is(
    scene: Bench, probability: float, active: bool | None
) -> None:
    scene.read(50.0)
    assert scene.forecast(probability=probability, earliest_s=600.0).active is active


def test_the_forecast_alarm_does_not_flutter(booked: Bench) -> None:
    assert booked.book is not None
    states = []
    for probability in (0.15, 0.25, 0.15, 0.12, 0.05, 0.05, 0.15, 0.25):
        booked.now_us += 70_000_000
        booked.book.evaluate(booked.forecast(probability=probability, earliest_s=600.0))
        states.append([alarm.state for alarm in booked.book.active()])
    raised, returned = ["UNACK"], ["RTNUN"]
    # Below the lower threshold it must stay for two minutes before it is withdrawn.
    assert states == [[], raised, raised, raised, raised, raised, raised, raised]
    for _ in range(3):
        booked.now_us += 70_000_000
        booked.book.evaluate(booked.forecast(probability=0.0))
    assert [alarm.state for alarm in booked.book.active()] == returned


def test_a_limit_that_is_passed_already_is_not_announced(scene: Bench) -> None:
    scene.read(71.0)
    passed = {"probability": 1.0, "median_s": 0.0, "earliest_s": 0.0}
    assert scene.forecast(**passed).suppressed_reason is None
    scene.present.add(("measured limit", RING, "alarm"))
    assert scene.forecast(**passed).suppressed_reason is None, "of the other level"
    scene.present.add(("measured limit", RING, "warning"))
    assert scene.forecast(**passed).suppressed_reason == "the limit is already exceeded"
    assert scene.forecast(**passed).active is True


# ---------------------------------------------------------------------- above ambient
def test_above_ambient_needs_both_temperatures(scene: Bench) -> None:
    scene.section = AlarmsSection.model_validate(
        {"above_ambient": {"limits": {RING: {"warning": 40, "alarm": 60}}}}
    )

    def found() -> list[tuple[float | None, bool | None]]:
        return [(one.value, one.active) for one in scene.conditions("above ambient")]

    scene.read(65.0)
    assert found() == [(None, None)] * 2
    scene.read(25.5, channel="ambient_c")
    assert found() == [(39.5, False)] * 2
    scene.read(20.0, channel="ambient_c")
    assert found() == [(45.0, True), (45.0, False)]
    scene.read(0.0, Quality.SENSOR_FAILURE, "ambient_c")
    assert found() == [(None, None)] * 2
    assert Bench(scene.readings).conditions("above ambient") == [], "no limits, no alarms"


# ---------------------------------------------------------------------- rate, twin
def test_rates_and_differences_are_compared_with_their_levels(scene: Bench) -> None:
    rates = scene.conditions("rate of rise", rates_k_per_min={RING: 5.0, "t_node_1_c": None})
    assert [(one.level, one.active) for one in rates] == [
        ("warning", True),
        ("alarm", False),
        ("warning", None),
        ("alarm", None),
    ]
    assert rates[0].message == "Inner ring rises by more than 4 K/min (warning)"
    assert (rates[0].unit, rates[0].deadband) == ("K/min", 0.5)
    differences = scene.conditions("twin difference", differences_k={RING: 8.5})
    assert [one.active for one in differences] == [True, True]
    assert differences[1].message == "Inner ring 8 K hotter than the model alone (alarm)"
    colder = scene.conditions("twin difference", differences_k={RING: -20.0})
    assert [one.active for one in colder] == [False, False]


@pytest.mark.parametrize(("value", "side"), [(2.0, "hotter"), (-2.0, "colder")])
def test_a_residual_test_says_to_which_side(scene: Bench, value: float, side: str) -> None:
    test = Cusum(0.5, 20.0)
    for _ in range(8):
        (condition,) = scene.conditions(
            "twin residual", residual_tests={RING: test}, residual_threshold=9.0
        )
        assert condition.active is (test.value > 9.0)
        test.add(value)
    assert condition.message == f"Inner ring repeatedly {side} than the twin expects"
    assert condition.active


# ---------------------------------------------------------------------- suppressed by design
def test_at_standstill_only_what_still_matters_is_told(scene: Bench) -> None:
    scene.facts["at_standstill"] = True
    scene.read(99.0)
    stands = "standstill"
    assert {level: one.suppressed_reason for level, one in scene.measured().items()} == {
        "warning": stands,
        "alarm": None,  # a speed sensor that wrongly says zero must not silence a hot bearing
    }
    running = [
        *scene.conditions("rate of rise", rates_k_per_min={RING: 5.0}),
        *scene.conditions("twin difference", differences_k={RING: 9.0}),
        *scene.conditions(
            "twin residual", residual_tests={RING: Cusum(0.5, 20.0)}, residual_threshold=9.0
        ),
    ]
    assert {one.suppressed_reason for one in running} == {stands}
    assert scene.forecast(probability=0.5).suppressed_reason is None, "a plan lies ahead"
    assert scene.sensors()["sensor fault"].suppressed_reason is None


@pytest.mark.parametrize("kind", ["stale data", "sensor fault"])
def test_without_the_speed_the_twin_says_nothing(scene: Bench, kind: str) -> None:
    scene.present.add((kind, "speed_rpm", ""))
    assert scene.forecast(probability=0.5).suppressed_reason == "no usable speed"
    difference, *_ = scene.conditions("twin difference", differences_k={RING: 9.0})
    assert difference.suppressed_reason == "no usable speed"
    scene.read(99.0)
    assert {one.suppressed_reason for one in scene.measured().values()} == {None}


def test_a_model_that_is_not_trusted_raises_no_alarm(scene: Bench) -> None:
    scene.facts["distrust"] = "the model is not trusted"
    assert scene.forecast(probability=0.5).suppressed_reason == "the model is not trusted"


def test_stale_data_hide_what_depends_on_them(scene: Bench) -> None:
    scene.present.add(("stale data", RING, ""))
    assert scene.sensors()["sensor fault"].suppressed_reason == "no data for inner ring"
    rate, *_ = scene.conditions("rate of rise", rates_k_per_min={RING: 5.0})
    assert rate.suppressed_reason == "no data for inner ring"
    assert scene.sensors()["stale data"].suppressed_reason is None


def test_a_silent_source_is_one_alarm_not_many(scene: Bench) -> None:
    scene.read(20.0, channel="ambient_c")

    def stale() -> dict[str, bool | None]:
        return {one.channel: one.active for one in scene.conditions("stale data")}

    for _ in range(4):
        scene.now_us += 5_000_000
        scene.read(50.0)
    scene.now_us += 1_000_000
    assert stale() == {
        "source:pt100": False, RING: False, "ambient_c": True, "speed_rpm": None,
    }, "one sensor is alive"  # fmt: skip
    scene.now_us += 10_000_000
    assert stale() == {"source:pt100": True, RING: None, "ambient_c": None, "speed_rpm": None}
    scene.present.add(("stale data", "source:pt100", ""))
    assert scene.sensors()["stale data"].suppressed_reason == "source pt100 lost"
    assert scene.sensors()["sensor fault"].suppressed_reason == "no data for inner ring"


# ---------------------------------------------------------------------- sensors
@pytest.mark.parametrize(
    ("quality", "faulty"),
    [
        (Quality.GOOD, False),
        (Quality.LOCAL_OVERRIDE, False),
        (Quality.UNCERTAIN, True),
        (Quality.SENSOR_FAILURE, True),
    ],
)
def test_a_sensor_without_a_usable_value_is_faulty(
    scene: Bench, quality: Quality, faulty: bool
) -> None:
    scene.read(math.nan, quality)
    condition = scene.sensors()["sensor fault"]
    assert condition.active is faulty
    assert condition.message.startswith("Inner ring: no usable value from pt100")
    assert (f"({meaning(quality)})" in condition.message) is faulty
    assert scene.sensors()["stale data"].active is False


def test_a_lost_line_is_no_data_and_not_a_fault_of_the_sensor(scene: Bench) -> None:
    scene.read(20.0, channel="ambient_c")
    scene.now_us += 1_000_000
    scene.read(math.nan, Quality.COMM_FAILURE)
    assert scene.sensors()["sensor fault"].active is None
    assert scene.sensors()["stale data"].active is None, "the source has not spoken since"
    for _ in range(12):
        scene.now_us += 1_000_000
        scene.read(20.0, channel="ambient_c")
        assert scene.sensors()["sensor fault"].active is None
    assert scene.sensors()["stale data"].active is True


def test_silence_is_stale_data_and_hides_whether_the_sensor_is_broken(scene: Bench) -> None:
    scene.read(50.0)
    scene.now_us += 10_000_000
    assert scene.sensors()["stale data"].active is False
    scene.now_us += 1_000_000
    scene.read(20.0, channel="ambient_c")
    assert scene.sensors()["stale data"].active is True
    assert scene.sensors()["stale data"].message == "Inner ring: no data from pt100"
    assert scene.sensors()["sensor fault"].active is None


def test_what_has_never_sent_is_waited_for_without_an_alarm(scene: Bench) -> None:
    for _ in range(2):
        conditions = scene.conditions("stale data")
        assert {condition.active for condition in conditions} == {None}
        assert scene.sensors()["sensor fault"].active is None
        scene.now_us += 3_600_000_000


def test_ages_are_never_judged_tighter_than_a_wall_moment() -> None:
    assert allowed_age_s(10.0, 1.0) == 10.0
    assert allowed_age_s(0.2, 1.0) == 1.5
    assert allowed_age_s(10.0, 120.0) == 600.0
