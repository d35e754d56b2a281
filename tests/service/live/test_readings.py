"""What the channels say now."""

import math

import pytest

from adapters.samples import Quality, Sample
from service.live.readings import Readings

NOW_US = 1_763_700_000_000_000
SECOND_US = 1_000_000
RING = "t_inner_ring_c"


@pytest.fixture
def readings() -> Readings:
    ages_s = dict.fromkeys(("speed_rpm", "t_inner_ring_c", "t_outer_ring_c"), 10.0)
    return Readings("bench-1", ages_s, NOW_US)


def sample(
    value: float,
    after_s: float = 0.0,
    quality: int = Quality.GOOD,
    channel: str = "t_inner_ring_c",
    asset: str = "bench-1",
    received_after_s: float | None = None,
) -> Sample:
    received_s = after_s if received_after_s is None else received_after_s
    return Sample(
        asset,
        channel,
        NOW_US + round(after_s * SECOND_US),
        value,
        quality,
        NOW_US + round(received_s * SECOND_US),
    )


def at(after_s: float) -> int:
    return NOW_US + round(after_s * SECOND_US)


def test_only_samples_of_this_asset_are_taken(readings: Readings) -> None:
    mine, other = sample(40.0), sample(80.0, asset="bench-2")
    assert readings.add([other, mine]) == [mine]
    assert readings.latest == {"t_inner_ring_c": mine}


def test_means_count_good_samples_since_the_last_call(readings: Readings) -> None:
    readings.add([sample(40.0, 0), sample(42.0, 1), sample(1500.0, 1, channel="speed_rpm")])
    assert readings.take_means() == {"t_inner_ring_c": 41.0, "speed_rpm": 1500.0}
    assert readings.take_means() == {}
    readings.add([sample(50.0, 2)])
    assert readings.take_means() == {"t_inner_ring_c": 50.0}


@pytest.mark.parametrize(
    "doubtful",
    [
        sample(math.nan, 1, Quality.SENSOR_FAILURE),
        sample(300.0, 1, Quality.EU_EXCEEDED),
        sample(41.0, 1, Quality.UNCERTAIN),
        sample(math.inf, 1, Quality.GOOD),
    ],
)
def test_doubtful_samples_never_enter_a_mean(readings: Readings, doubtful: Sample) -> None:
    readings.add([sample(40.0), doubtful])
    assert readings.take_means() == {"t_inner_ring_c": 40.0}
    assert readings.latest["t_inner_ring_c"] == doubtful, "but they are the latest word"


@pytest.mark.parametrize("quality", [Quality.SENSOR_FAILURE, Quality.UNCERTAIN])
def test_no_good_value_while_the_latest_sample_is_not_good(
    readings: Readings, quality: Quality
) -> None:
    readings.add([sample(40.0)])
    assert readings.good_value("t_inner_ring_c", at(1)) == 40.0
    readings.add([sample(41.0, 1, quality)])
    assert readings.good_value("t_inner_ring_c", at(1)) is None
    assert readings.quality("t_inner_ring_c", at(1)) == quality
    readings.add([sample(42.0, 2)])
    assert readings.good_value("t_inner_ring_c", at(2)) == 42.0


def test_late_samples_change_nothing(readings: Readings) -> None:
    readings.add([sample(40.0, 5)])
    readings.take_means()
    late = sample(20.0, 3, received_after_s=6)
    assert readings.add([late]) == []
    assert readings.take_means() == {}
    assert readings.good_value("t_inner_ring_c", at(6)) == 40.0


@pytest.mark.parametrize("quality", [Quality.GOOD, Quality.UNCERTAIN])
def test_a_stale_value_is_neither_good_nor_uncertain(readings: Readings, quality: Quality) -> None:
    readings.add([sample(40.0, quality=quality)])
    assert readings.quality("t_inner_ring_c", at(10)) == quality
    assert readings.quality("t_inner_ring_c", at(10.1)) == Quality.LAST_KNOWN
    assert readings.good_value("t_inner_ring_c", at(10.1)) is None


def test_a_stale_fault_keeps_its_reason(readings: Readings) -> None:
    readings.add([sample(math.nan, quality=Quality.SENSOR_FAILURE)])
    assert readings.quality("t_inner_ring_c", at(60)) == Quality.SENSOR_FAILURE


def test_a_channel_without_any_sample_is_waited_for(readings: Readings) -> None:
    assert readings.quality("t_inner_ring_c", at(0)) == Quality.WAITING_FOR_INITIAL_DATA
    assert readings.good_value("t_inner_ring_c", at(0)) is None
    assert not readings.is_stale("t_inner_ring_c", at(9))
    assert readings.is_stale("t_inner_ring_c", at(11))


def test_a_backlog_is_not_the_present(readings: Readings) -> None:
    """A gateway that was away for an hour sends what it kept."""
    backlog = [sample(30.0 + minute, 60.0 * minute, received_after_s=3600) for minute in range(61)]
    readings.add(backlog)
    assert readings.take_means() == {"t_inner_ring_c": 90.0}, "only what is fresh"
    assert readings.good_value("t_inner_ring_c", at(3601)) == 90.0


def test_a_gateway_clock_ahead_of_ours_does_not_keep_a_value_fresh(readings: Readings) -> None:
    readings.add([sample(40.0, 200.0, received_after_s=0.0)])
    assert readings.take_means() == {"t_inner_ring_c": 40.0}
    assert readings.good_value("t_inner_ring_c", at(9)) == 40.0
    assert readings.good_value("t_inner_ring_c", at(11)) is None


def test_a_clock_set_back_is_followed(readings: Readings) -> None:
    readings.add([sample(40.0, 3600)])
    assert readings.good_value("t_inner_ring_c", at(0)) is None, "nothing new has come yet"
    readings.add([sample(45.0, 0)])
    assert readings.good_value("t_inner_ring_c", at(1)) == 45.0


def test_the_reason_is_the_best_that_is_known(readings: Readings) -> None:
    channel = "t_inner_ring_c"
    assert readings.reason(channel, NOW_US) == "no value yet"
    readings.add([sample(60.0)])
    assert readings.reason(channel, NOW_US) == ""
    readings.add([sample(math.nan, 1.0, Quality.SENSOR_FAILURE)])
    assert readings.reason(channel, at(1)) == "sensor failure"
    readings.doubt = lambda name: f"{name}: wire break"
    assert readings.reason(channel, at(1)) == f"{channel}: wire break"
    readings.add([sample(60.0, 2.0)])
    assert readings.reason(channel, at(20)) == "stale: no new value"


def test_a_clock_some_seconds_ahead_that_is_put_right_is_heard_at_once(readings: Readings) -> None:
    for second in range(5):
        readings.add([sample(44.0, second + 4.5, received_after_s=second)])
    assert readings.add([sample(97.0, 5.5)]), "more than a second after the one before"
    assert readings.good_value(RING, at(6)) == 97.0
    assert not readings.add([sample(44.0, 5.2, received_after_s=5.6)]), "late all the same"
    assert readings.late == 1


def test_what_such_a_clock_sends_again_is_late(readings: Readings) -> None:
    readings.add([sample(44.0, 4.0, received_after_s=0.0)])
    assert not readings.add([sample(43.0, 3.5, received_after_s=0.5)])
    assert not readings.add([sample(42.0, -1.0, received_after_s=2.0)]), "from before it all"
    assert readings.good_value(RING, at(2)) == 44.0


def test_late_samples_are_counted(readings: Readings) -> None:
    for after_s in (5.0, 1.0, 2.0):
        readings.add([sample(60.0, after_s, received_after_s=6.0)])
    assert readings.late == 2


# ---------------------------------------------------------------------- observed intervals
def pushed(interval_s: float, posts: int, per_post: int = 1, floor_s: float = 10.0) -> Readings:
    """Readings of a channel that is posted so often, several samples at a time."""
    readings = Readings("bench-1", {RING: 120.0}, NOW_US, learned_from_s={RING: floor_s})
    for post in range(1, posts + 1):
        received_s = post * interval_s
        times_s = [received_s - interval_s * k / per_post for k in range(per_post)][::-1]
        readings.add([sample(40.0, time_s, received_after_s=received_s) for time_s in times_s])
    return readings


@pytest.mark.parametrize(
    ("interval_s", "posts", "per_post", "floor_s", "limit_s"),
    [
        (15.0, 4, 15, 10.0, 120.0),  # not known yet
        (15.0, 30, 15, 10.0, 75.0),  # a gateway that posts four times a minute
        (1.0, 60, 1, 10.0, 10.0),  # not below the floor
        (60.0, 30, 60, 10.0, 300.0),
        (90.0, 30, 1, 10.0, 450.0),
        (0.05, 400, 1, 2.0, 2.0),  # a CAN message, twenty times a second
        (600.0, 30, 600, 10.0, 1800.0),  # never later than half an hour
    ],
)
def test_a_learned_limit_is_five_observed_intervals(
    interval_s: float, posts: int, per_post: int, floor_s: float, limit_s: float
) -> None:
    readings = pushed(interval_s, posts, per_post, floor_s)
    assert readings.age_limit_s(RING) == pytest.approx(limit_s, rel=0.02)


def test_a_gateway_that_posts_every_15_s_is_never_stale() -> None:
    readings = pushed(15.0, 30, 15)
    for second in range(15):
        assert not readings.is_stale(RING, at(30 * 15 + second))
    assert readings.is_stale(RING, at(30 * 15 + 76))


def test_one_outage_does_not_change_what_is_usual() -> None:
    readings = pushed(2.0, 60)
    readings.add([sample(40.0, 4000.0)])
    assert readings.age_limit_s(RING) == pytest.approx(10.0)


def test_a_backlog_says_nothing_about_the_interval() -> None:
    readings = pushed(60.0, 30)
    received_s = 30 * 60.0 + 7200.0
    for k in range(100):
        readings.add([sample(40.0, 1801.0 + 60 * k, received_after_s=received_s + 0.1 * k)])
    assert readings.age_limit_s(RING) == pytest.approx(300.0)


def test_a_limit_that_is_configured_stays() -> None:
    readings = Readings("bench-1", {RING: 30.0}, NOW_US)
    for k in range(100):
        readings.add([sample(40.0, 60.0 * k)])
    assert readings.age_limit_s(RING) == 30.0
