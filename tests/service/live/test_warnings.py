"""Which alarm conditions hold, and what the alarm book makes of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from adapters.samples import Quality, Sample, meaning
from service.alarms import AlarmBook, AlarmCondition
from service.live import warnings
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.settings import Limits
from service.store import Alarm, Store
from service.wiring import ChannelFacts

NOW_US = 1_763_700_000_000_000
RING = "t_inner_ring_c"
LIMITS = {RING: Limits(warning=70, alarm=95)}
FACTS = {RING: ChannelFacts("pt100", 10.0)}


@dataclass
class Scene:
    """Readings of one channel on a clock that a test moves, and an alarm book behind them."""

    readings: Readings
    book: AlarmBook | None = None
    now_us: int = NOW_US

    def read(self, value: float, quality: int = Quality.GOOD) -> None:
        sample = Sample("bench-1", RING, self.now_us, value, quality, self.now_us)
        self.readings.add([sample])

    def measured(self) -> dict[str, AlarmCondition]:
        found = warnings.measured_limits("bench-1", self.readings, LIMITS, self.now_us)
        return {condition.level: condition for condition in found}

    def forecast(self, **crossing: float | None) -> AlarmCondition:
        """The condition of the warning limit for one crossing."""
        given = {"probability": 0.0, "median_s": None, "earliest_s": None} | crossing
        crossings = {RING: {"warning": LimitCrossing(**given)}}  # type: ignore[arg-type]
        (condition,) = warnings.forecast_limits(
            "bench-1", crossings, LIMITS, self.readings, self.now_us
        )
        return condition

    def sensors(self) -> dict[str, AlarmCondition]:
        found = warnings.sensor_conditions("bench-1", self.readings, FACTS, self.now_us)
        return {condition.kind: condition for condition in found}

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
def scene() -> Scene:
    return Scene(Readings("bench-1", {RING: 10.0}, NOW_US))


class SceneClock:
    """The scene's time as the alarm book sees it."""

    rate = 1.0

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def now_us(self) -> int:
        return self._scene.now_us

    async def sleep(self, process_seconds: float) -> None:
        self._scene.now_us += round(process_seconds * 1e6)


@pytest.fixture
def told() -> list[Alarm]:
    return []


@pytest.fixture
def booked(scene: Scene, told: list[Alarm], tmp_path: Path) -> Iterator[Scene]:
    with Store.open("", tmp_path) as store:
        scene.book = AlarmBook(store, SceneClock(scene), told.append)
        yield scene
        scene.book.close()


# ---------------------------------------------------------------------- measured limit
@pytest.mark.parametrize(
    ("value", "warning", "alarm"),
    [(69.9, False, False), (70.0, True, False), (94.9, True, False), (95.0, True, True)],
)
def test_a_measured_limit_is_passed_at_its_value(
    scene: Scene, value: float, warning: bool, alarm: bool
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


def test_a_measured_limit_cannot_be_told_without_a_good_fresh_value(scene: Scene) -> None:
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(99.0, Quality.UNCERTAIN)
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(math.nan, Quality.SENSOR_FAILURE)
    assert [one.active for one in scene.measured().values()] == [None, None]
    scene.read(99.0)
    assert [one.active for one in scene.measured().values()] == [True, True]
    scene.now_us += 11_000_000
    assert [one.active for one in scene.measured().values()] == [None, None]


def test_a_measured_alarm_has_delays_and_a_deadband(booked: Scene) -> None:
    assert booked.hold(70.2, 9) == []
    assert booked.hold(70.2, 3) == [("warning", "UNACK")]
    assert booked.hold(69.3, 600) == [("warning", "UNACK")], "within the deadband of 1 K"
    assert booked.hold(68.9, 50) == [("warning", "UNACK")], "not for long enough yet"
    assert booked.hold(68.9, 15) == [("warning", "RTNUN")]


def test_a_measured_alarm_stays_while_nobody_can_tell(booked: Scene, told: list[Alarm]) -> None:
    assert booked.hold(71.0, 12) == [("warning", "UNACK")]
    for _ in range(300):
        booked.now_us += 1_000_000
        booked.read(math.nan, Quality.SENSOR_FAILURE)
        for condition in booked.measured().values():
            assert booked.book is not None
            booked.book.evaluate(condition)
    assert [alarm.state for alarm in told] == ["UNACK"]


# ---------------------------------------------------------------------- forecast limit
def test_a_probable_crossing_is_announced_with_its_lead_time(scene: Scene) -> None:
    scene.read(50.0)
    condition = scene.forecast(probability=0.9, median_s=2400.0, earliest_s=1500.0)
    assert condition.kind == "forecast limit"
    assert condition.active is True
    assert condition.predicted
    assert (condition.probability, condition.lead_time_s) == (0.9, 2400.0)
    assert condition.message == "Inner ring will pass warning 70 °C"
    assert condition.value is None, "what is forecast was not measured"


def test_a_possible_crossing_has_the_earliest_time(scene: Scene) -> None:
    condition = scene.forecast(probability=0.3, median_s=None, earliest_s=5400.0)
    assert condition.active is True
    assert condition.lead_time_s == 5400.0
    assert condition.message == "Inner ring may pass warning 70 °C"


@pytest.mark.parametrize(
    ("probability", "active"), [(0.0, False), (0.09, False), (0.1, None), (0.19, None), (0.2, True)]
)
def test_between_raising_and_withdrawing_the_alarm_stays_as_it_is(
    scene: Scene, probability: float, active: bool | None
) -> None:
    scene.read(50.0)
    assert scene.forecast(probability=probability, earliest_s=600.0).active is active


def test_the_forecast_alarm_does_not_flutter(booked: Scene) -> None:
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


def test_a_limit_that_is_passed_already_is_no_longer_predicted(scene: Scene) -> None:
    scene.read(71.0)
    assert scene.forecast(probability=1.0, median_s=0.0, earliest_s=0.0).active is False
    scene.read(math.nan, Quality.SENSOR_FAILURE)
    assert scene.forecast(probability=1.0, median_s=0.0, earliest_s=0.0).active is True


# ---------------------------------------------------------------------- sensors
@pytest.mark.parametrize(
    ("quality", "faulty"),
    [
        (Quality.GOOD, False),
        (Quality.LOCAL_OVERRIDE, False),
        (Quality.UNCERTAIN, True),
        (Quality.SENSOR_FAILURE, True),
        (Quality.COMM_FAILURE, True),
    ],
)
def test_a_sensor_without_a_usable_value_is_faulty(
    scene: Scene, quality: Quality, faulty: bool
) -> None:
    scene.read(math.nan, quality)
    condition = scene.sensors()["sensor fault"]
    assert condition.active is faulty
    assert condition.message.startswith("Inner ring: no usable value from pt100")
    assert (f"({meaning(quality)})" in condition.message) is faulty
    assert scene.sensors()["stale data"].active is False


def test_silence_is_stale_data_and_hides_whether_the_sensor_is_broken(scene: Scene) -> None:
    scene.read(50.0)
    scene.now_us += 10_000_000
    assert scene.sensors()["stale data"].active is False
    scene.now_us += 1_000_000
    assert scene.sensors()["stale data"].active is True
    assert scene.sensors()["stale data"].message == "Inner ring: no data from pt100"
    assert scene.sensors()["sensor fault"].active is None


def test_a_channel_that_never_sent_is_stale_only_after_its_time(scene: Scene) -> None:
    assert scene.sensors()["stale data"].active is False
    assert scene.sensors()["sensor fault"].active is None
    scene.now_us += 11_000_000
    condition = scene.sensors()["stale data"]
    assert condition.active is True
    assert condition.message == "Inner ring: no data from pt100 yet"


def test_ages_are_never_judged_tighter_than_a_wall_moment() -> None:
    assert warnings.allowed_age_s(10.0, 1.0) == 10.0
    assert warnings.allowed_age_s(10.0, 120.0) == 180.0


@pytest.mark.parametrize(
    ("channel", "name"),
    [("t_outer_ring_c", "Outer ring"), ("t_node_7_c", "Node 7"), ("load_n", "Load")],
)
def test_channels_have_names_for_people(channel: str, name: str) -> None:
    assert warnings.label(channel) == name
