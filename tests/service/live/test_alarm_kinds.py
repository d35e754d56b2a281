"""Which alarm conditions hold, and what the alarm book makes of them."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.samples import Quality, meaning
from service.alarm_kinds import AlarmsSection
from service.alarms import AlarmBook
from service.live.presentation import LimitCrossing
from service.live.readings import Readings, allowed_age_s
from service.store import Alarm, Outbox, Store
from twin_core.cusum import Cusum

from .alarm_scene import FACTS, NOW_US, RING, Bench, SceneClock


@pytest.fixture
def scene() -> Bench:
    return Bench(Readings("bench-1", dict.fromkeys(FACTS, 10.0), NOW_US))


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
    assert condition.message == "Inner ring may exceed warning 70 °C, 90 %"
    assert condition.value is None, "what is forecast was not measured"


def test_the_text_says_how_such_forecasts_have_done(scene: Bench) -> None:
    asked = []

    def record(channel: str, lead_time_s: float | None) -> str:
        asked.append((channel, lead_time_s))
        return "record 1 h ahead, high risk: 31 of 32 inside (4 independent runs)"

    likely = {RING: {"warning": LimitCrossing(0.82, 2400.0, 1500.0)}}
    (condition,) = scene.conditions("forecast limit", crossings=likely, record=record)
    assert condition.message == (
        "Inner ring may exceed warning 70 °C, 82 %; "
        "record 1 h ahead, high risk: 31 of 32 inside (4 independent runs)"
    )
    assert asked == [(RING, 2400.0)]
    calm = {RING: {"warning": LimitCrossing(0.01, None, None)}}
    (condition,) = scene.conditions("forecast limit", crossings=calm, record=record)
    assert (condition.active, len(asked)) == (False, 1), "nothing is asked for without an alarm"


def test_a_model_that_was_never_identified_announces_nothing(scene: Bench) -> None:
    crossings = {RING: {"warning": LimitCrossing(0.99, 60.0, 30.0)}}
    (condition,) = scene.conditions("forecast limit", crossings=crossings, identified=False)
    assert condition.active is False


def test_a_possible_crossing_has_the_earliest_time(scene: Bench) -> None:
    condition = scene.forecast(probability=0.3, median_s=None, earliest_s=5400.0)
    assert condition.active is True
    assert condition.lead_time_s == 5400.0
    assert condition.message == "Inner ring may exceed warning 70 °C, 30 %"


@pytest.mark.parametrize(
    ("probability", "says"),
    [
        (1.0, "will exceed warning 70 °C"),
        (0.95, "will exceed warning 70 °C"),
        (0.94, "may exceed warning 70 °C, 94 %"),
        (0.82, "may exceed warning 70 °C, 82 %"),
        (0.001, "may exceed warning 70 °C, < 1 %"),
    ],
)
def test_the_text_is_as_certain_as_the_forecast(
    scene: Bench, probability: float, says: str
) -> None:
    condition = scene.forecast(probability=probability, median_s=60.0, earliest_s=30.0)
    assert condition.message == f"Inner ring {says}"


def test_the_text_of_a_standing_prediction_follows_its_probability(booked: Bench) -> None:
    assert booked.book is not None
    texts = []
    for probability in (0.99, 0.82, 0.15, 0.05):
        booked.now_us += 45_000_000
        booked.book.evaluate(booked.forecast(probability=probability, earliest_s=600.0))
        (alarm,) = booked.book.active()
        texts.append(alarm.message.removeprefix("Inner ring "))
        assert (alarm.state, alarm.probability) == ("UNACK", probability)
    assert texts == [
        "will exceed warning 70 °C",
        "may exceed warning 70 °C, 82 %",
        "may exceed warning 70 °C, 15 %",
        "may exceed warning 70 °C, 5 %",
    ]


@pytest.mark.parametrize("probability", [0.0, 0.15])
def test_a_prediction_does_not_come_back_while_the_machine_cools(
    booked: Bench, told: list[Alarm], probability: float
) -> None:
    """The heavy step: predicted, exceeded, over; then the forecast is of the cooling."""
    assert booked.book is not None

    def forecast(probability: float) -> None:
        booked.now_us += 45_000_000
        booked.book.evaluate(booked.forecast(probability=probability, earliest_s=600.0))

    for _ in range(3):
        forecast(1.0)
    booked.present.add(("measured limit", RING, "warning"))
    for _ in range(20):
        forecast(1.0)
    booked.present.clear()
    forecast(probability)
    assert booked.book.active() == []
    forecast(probability)
    assert [alarm.state for alarm in told] == ["UNACK", "DSUPR", "NORM"]


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
        "source:pt100": False, RING: False, "ambient_c": True,
        "source:drive": None, "speed_rpm": None,
    }, "one sensor is alive"  # fmt: skip
    scene.now_us += 10_000_000
    assert stale() == {
        "source:pt100": True, RING: None, "ambient_c": None,
        "source:drive": None, "speed_rpm": None,
    }  # fmt: skip
    scene.present.add(("stale data", "source:pt100", ""))
    assert scene.sensors()["stale data"].suppressed_reason == "source pt100 lost"
    assert scene.sensors()["sensor fault"].suppressed_reason == "no data for inner ring"


# ---------------------------------------------------------------------- clocks
def test_a_clock_that_is_ahead_is_one_alarm_and_no_fault_of_its_sensors(scene: Bench) -> None:
    ahead_s = {RING: 281.0, "ambient_c": 280.0}
    scene.readings.ahead_s = ahead_s.get

    def clocks() -> dict[str, bool | None]:
        return {one.channel: one.active for one in scene.conditions("clock ahead")}

    assert clocks() == {"source:pt100": None, "source:drive": None}, "nothing has been heard"
    for channel in ahead_s:
        scene.read(50.0, Quality.UNCERTAIN, channel)
    scene.read(1500.0, channel="speed_rpm")
    assert clocks() == {"source:pt100": True, "source:drive": False}
    condition, _ = scene.conditions("clock ahead")
    assert condition.message == "pt100: clock ahead by 281 s, values uncertain"
    assert (condition.priority, condition.covers) == (2, (RING, "ambient_c"))
    assert scene.sensors()["sensor fault"].suppressed_reason is None, "it is not there yet"
    scene.present.add(("clock ahead", "source:pt100", ""))
    fault = scene.sensors()["sensor fault"]
    assert (fault.active, fault.suppressed_reason) == (True, "the clock of pt100 is ahead")

    scene.read(math.nan, Quality.SENSOR_FAILURE)
    assert scene.sensors()["sensor fault"].suppressed_reason is None, "no fault of the clock"
    scene.read(50.0, Quality.UNCERTAIN)
    scene.present.add(("stale data", "source:pt100", ""))
    condition, _ = scene.conditions("clock ahead")
    assert condition.suppressed_reason == "source pt100 lost"

    scene.now_us += 20_000_000
    assert clocks() == {"source:pt100": None, "source:drive": None}, "silent: it is not known"
    ahead_s.clear()
    scene.read(50.0)
    assert clocks()["source:pt100"] is False


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
