"""Alarms judge what was measured between two looks, whenever the looks are."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from alarm_bench import START_US, HandClock
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import Quality, Sample
from service.alarms import AlarmBook
from service.domain.alarm_guidance import AlarmOverride
from service.live.estimate import LiveEstimate
from service.live.readings import Readings
from service.live.watch import AlarmWatch
from service.site.wiring import ChannelFacts
from service.store import Alarm, Outbox, Store

from .conftest import asset_section, make_version

RING, AMBIENT = "t_inner_ring_c", "ambient_c"
LOOK_S, ALARM_C, DEADBAND_K = 5.0, 85.0, 1.0
ACTIVE_MODEL = make_version()
PHASES_S = (0.25, 1.25, 2.25, 3.25, 4.25)
BAD = math.nan


class Watched:
    """A ring with an alarm at 85 °C: samples come by a test's clock, looks every five seconds."""

    def __init__(self, folder: Path, **rules: object) -> None:
        kinds = {"rate_of_rise": {"enabled": False}, "sensor_fault": {"enabled": False}}
        section = asset_section(
            limits={RING: {"warning": 84.5, "alarm": ALARM_C}}, alarms=kinds | rules
        )
        self.clock = HandClock()
        self.store = Store.open("", folder)
        self.outbox = Outbox.open(folder, self.store)
        self.told: list[Alarm] = []
        self.book = AlarmBook(self.outbox, self.clock, self.told.append)
        channels = {name: ChannelFacts("pt100", 10.0) for name in section.channels}
        self.section, self.channels = section, channels
        self.begin_again()

    def begin_again(self) -> None:
        ages_s = dict.fromkeys(self.channels, 10.0)
        self.readings = Readings(self.section.id, ages_s, self.clock.now_us())
        estimate = LiveEstimate(ACTIVE_MODEL)
        self.watch = AlarmWatch(self.section, self.channels, self.readings, estimate, self.book)

    def change(
        self, name: tuple[str, str, str] = ("measured limit", RING, "alarm"), **override: Any
    ) -> None:
        self.watch.look(self.clock.now_us())
        self.watch.change(self.section, {name: AlarmOverride(**override)})

    def close(self) -> None:
        self.outbox.close()
        self.store.close()

    def read(self, value: float, channel: str = RING) -> None:
        quality = Quality.BAD if math.isnan(value) else Quality.GOOD
        now_us = self.clock.now_us()
        self.readings.add([Sample("bench-1", channel, now_us, value, quality, now_us)])

    def look(self) -> None:
        self.watch.step(self.clock.now_us(), self.readings.take_means(), True)

    def follow(
        self, values: Sequence[float], phase_s: float, every_s: float = 1.0
    ) -> list[tuple[float, str]]:
        """Read a value every so often, and look from a phase on; gives the alarm's changes."""
        begin_us, told = self.clock.us, len(self.told)
        changes: list[tuple[float, str]] = []
        samples = [(k * every_s, value) for k, value in enumerate(values)]
        end_s = (len(values) - 1) * every_s
        looks = [phase_s + k * LOOK_S for k in range(math.ceil((end_s - phase_s) / LOOK_S) + 1)]
        for at_s, value in sorted([*samples, *((look, None) for look in looks)], key=_by_time):
            self.clock.us = begin_us + round(at_s * 1e6)
            if value is not None:
                self.read(value)
                continue
            self.look()
            news, told = self.told[told:], len(self.told)
            changes += [(at_s, one.state) for one in news if one.level == "alarm"]
        return changes

    def alarm(self, kind: str = "measured limit") -> Alarm:
        (alarm,) = [a for a in self.book.active() if (a.level, a.kind) == ("alarm", kind)]
        return alarm


def _by_time(event: tuple[float, float | None]) -> tuple[float, bool]:
    return event[0], event[1] is None


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Callable[..., Watched]]:
    made: list[Watched] = []

    def make(on_s: float = 0.0, off_s: float = 0.0, **rules: object) -> Watched:
        folder = tmp_path / str(len(made))
        folder.mkdir()
        limit = {"on_delay_s": on_s, "off_delay_s": off_s, "deadband_k": DEADBAND_K}
        made.append(Watched(folder, measured_limit=limit, **rules))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.mark.parametrize("phase_s", PHASES_S)
def test_a_value_over_the_limit_between_two_looks_raises_the_alarm_with_its_peak(
    watched: Callable[..., Watched], phase_s: float
) -> None:
    ring = watched()
    changes = ring.follow([60.0, 97.0, 92.0, 88.0, 60.0, *[60.0] * 12], phase_s)
    assert [state for _, state in changes] == ["UNACK", "RTNUN"]
    assert changes[0][0] <= 1.0 + LOOK_S + phase_s
    alarm = ring.alarm()
    assert (alarm.peak_value, alarm.peak_at_us) == (97.0, START_US + 1_000_000)
    assert ring.outbox.flush(30)
    lines = [one for one in ring.store.alarms.journal(limit=9).items if one.level == "alarm"]
    assert [one.peak_value for one in lines] == [97.0, 97.0]


@pytest.mark.parametrize("phase_s", PHASES_S)
def test_what_comes_and_goes_between_two_looks_is_seen_until_the_next_one(
    watched: Callable[..., Watched], phase_s: float
) -> None:
    ring = watched()
    changes = ring.follow([60.0] * 7 + [90.0] + [60.0] * 12, phase_s)
    (raised_s, raised), (gone_s, gone) = changes
    assert (raised, gone) == ("UNACK", "RTNUN")
    assert 0 < raised_s - 7.0 <= LOOK_S
    assert gone_s == raised_s + LOOK_S


@pytest.mark.parametrize("phase_s", PHASES_S)
@pytest.mark.parametrize(
    ("on_s", "over", "raised"),
    [(3.0, 3, True), (3.0, 2, False), (2.5, 3, True), (1.0, 1, True), (4.5, 4, False)],
)
def test_a_delay_below_the_time_between_two_looks_does_what_it_says(
    watched: Callable[..., Watched], phase_s: float, on_s: float, over: int, raised: bool
) -> None:
    ring = watched(on_s)
    changes = ring.follow([60.0] * 6 + [90.0] * over + [60.0] * 8, phase_s)
    assert ("UNACK" in [state for _, state in changes]) is raised


@pytest.mark.parametrize("phase_s", PHASES_S)
def test_a_dip_between_two_looks_lets_both_delays_begin_from_zero(
    watched: Callable[..., Watched], phase_s: float
) -> None:
    ring = watched(10.0, 20.0)
    assert ring.follow([90.0] * 9 + [60.0] + [90.0] * 9 + [60.0] * 3, phase_s) == []
    ring = watched(0.0, 20.0)
    raised, gone = ring.follow([90.0] * 5 + [60.0] * 18 + [90.0] + [60.0] * 30, phase_s)
    assert (raised[1], gone[1]) == ("UNACK", "RTNUN")
    assert 24.0 + 20.0 <= gone[0] <= 24.0 + 20.0 + LOOK_S
    assert ring.alarm().peak_value == 90.0


@pytest.mark.parametrize("phase_s", PHASES_S)
def test_the_peak_is_that_of_the_delay_too(watched: Callable[..., Watched], phase_s: float) -> None:
    ring = watched(10.0, 60.0)
    ring.follow([97.0, 92.0] + [88.0] * 20, phase_s)
    assert (ring.alarm().peak_value, ring.alarm().peak_at_us) == (97.0, START_US)
    assert ring.alarm().value == 88.0


def test_no_bad_value_between_two_looks_raises_or_returns_anything(
    watched: Callable[..., Watched],
) -> None:
    ring = watched()
    assert ring.follow([60.0, BAD, BAD, 60.0, 60.0, 60.0], 0.5) == []
    ring = watched(0.0, 5.0)
    assert ring.follow([90.0, 60.0, BAD, BAD, BAD, 60.0, 90.0, 60.0], 0.5) == [(0.5, "UNACK")]


def test_an_excess_over_ambient_between_two_looks_is_seen(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(
        above_ambient={"limits": {RING: {"warning": 20, "alarm": 40}}, "on_delay_s": 0.0}
    )
    ring.read(22.0, AMBIENT)
    ring.follow([60.0, 60.0, 71.5, 60.0, 60.0, 60.0], 0.5)
    assert ring.alarm("above ambient").peak_value == 49.5


def test_a_thousand_values_a_second_lose_no_highest_one(
    watched: Callable[..., Watched],
) -> None:
    ring = watched()
    values = [60.0 + k % 7 for k in range(20_000)]
    values[13_131] = 99.0
    for value in values:
        ring.clock.us += 1000
        ring.read(value)
    ring.look()
    assert ring.alarm().peak_value == 99.0
    assert ring.readings.take_between(ring.clock.us).seen == {}


def test_a_clock_that_is_set_between_two_looks_changes_no_delay(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(3.0)
    for value in (90.0, 90.0, 90.0):
        ring.read(value)
        ring.clock.us += 1_000_000
    by_us = 3_600_000_000
    ring.clock.us += by_us
    ring.readings.clock_set(by_us, ring.clock.us)
    ring.watch.clock_set(by_us)
    ring.book.clock_set(by_us)
    ring.look()
    alarm = ring.alarm()
    assert (alarm.peak_value, alarm.peak_at_us) == (90.0, START_US + by_us)


VALUES = st.sampled_from([60.0, 84.2, 84.8, 85.0, 92.0, 97.0])
DELAYS_S = st.sampled_from([0.0, 1.0, 2.0, 3.5, 7.0])


@settings(max_examples=60, deadline=None)
@given(st.lists(VALUES, min_size=5, max_size=40), DELAYS_S, st.sampled_from(PHASES_S))
def test_the_first_raise_is_that_of_one_who_looks_all_the_time(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], on_s: float, phase_s: float
) -> None:
    """A value holds until the next one; the alarm comes with the first look afterwards."""
    limit = {"on_delay_s": on_s, "off_delay_s": 60.0}
    ring = Watched(tmp_path_factory.mktemp("ring"), measured_limit=limit)
    try:
        changes = ring.follow(values, phase_s)
        last_look_s = (ring.clock.us - START_US) / 1e6
    finally:
        ring.close()
    due_s, over_since_s = math.inf, math.inf
    for at_s, value in [*enumerate(values), (last_look_s, 0.0)]:
        if over_since_s + on_s <= at_s:
            due_s = over_since_s + on_s
            break
        over_since_s = min(over_since_s, at_s) if value >= ALARM_C else math.inf
    looks = (phase_s + k * LOOK_S for k in range(20))
    first_s = next(look for look in looks if look >= due_s) if due_s < math.inf else None
    assert changes == ([] if first_s is None else [(first_s, "UNACK")])


def test_a_batch_that_comes_late_counts_no_time_twice(watched: Callable[..., Watched]) -> None:
    """Samples of the last eight seconds in one go, where 90 °C had been held until now."""
    ring = watched(12.0)
    ring.read(90.0)
    ring.clock.advance(9.0)
    ring.look()
    now_us = ring.clock.us
    ring.readings.add(
        Sample("bench-1", RING, now_us - back_s * 1_000_000, 90.0, Quality.GOOD, now_us)
        for back_s in range(8, 0, -1)
    )
    ring.clock.advance(2.5)
    ring.look()
    assert ring.book.active() == []
    ring.clock.advance(0.5)
    ring.look()
    assert ring.alarm().state == "UNACK"


# ------------------------------------------------------------------ what must raise nothing
def test_a_value_of_before_an_alarm_was_disabled_counts_no_more(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(10.0)
    ring.follow([60.0] * 4 + [90.0], 0.5)
    ring.change(enabled=False)
    ring.follow([60.0] * 60, 0.5)
    ring.change(enabled=True)
    assert ring.follow([60.0] * 10, 0.5) == []


def test_a_twin_that_begins_again_does_not_count_the_time_between(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(10.0)
    ring.follow([60.0] * 4 + [90.0], 0.5)
    ring.clock.advance(12.0)
    ring.begin_again()
    assert ring.follow([60.0] * 10, 0.5) == []


@pytest.mark.parametrize(("silent_s", "phase_s"), [(60.0, 61.0), (60.0, 1.0), (13.0, 14.0)])
def test_a_value_holds_no_longer_than_its_age_limit(
    watched: Callable[..., Watched], silent_s: float, phase_s: float
) -> None:
    ring = watched(12.0)
    ring.follow([90.0], 0.0)
    ring.clock.advance(silent_s)
    assert ring.follow([60.0], phase_s - silent_s) == []


@pytest.mark.parametrize("how", ["shelved", "out of service"])
def test_what_came_and_went_while_set_aside_raises_nothing(
    watched: Callable[..., Watched], how: str
) -> None:
    ring = watched()
    ring.follow([60.0] * 5, 0.5)
    (normal,) = [
        one
        for one in ring.book.normal()
        if (one.kind, one.channel, one.level) == ("measured limit", RING, "alarm")
    ]
    if how == "shelved":
        ring.book.shelve(normal.id, 3600.0, "eva")
    else:
        ring.book.take_out_of_service(normal.id, "eva", "new sensor")
    ring.clock.advance(1.0)
    ring.read(97.0)
    ring.clock.advance(1.0)
    ring.read(60.0)
    ring.clock.advance(1.0)
    if how == "shelved":
        ring.book.unshelve(normal.id, "eva")
    else:
        ring.book.return_to_service(normal.id, "eva")
    ring.look()
    assert [one for one in ring.book.active() if one.level == "alarm"] == []


def test_a_changed_limit_counts_from_the_change_on(watched: Callable[..., Watched]) -> None:
    ring = watched(10.0)
    ring.follow([90.0] * 5, 0.5)
    ring.change(setpoint=95.0)
    assert ring.follow([90.0] * 20, 0.5) == []
    ring = watched()
    ring.change(setpoint=95.0)
    ring.follow([60.0, 90.0, 60.0], 0.5)
    ring.change(setpoint=85.0)
    assert ring.follow([60.0] * 6, 0.5) == []
    ring = watched()
    ring.follow([60.0], 0.0)
    ring.read(90.0)
    ring.clock.advance(1.0)
    ring.read(60.0)
    ring.change(setpoint=95.0)
    assert (ring.alarm().state, ring.alarm().peak_value) == ("UNACK", 90.0)


def test_a_bad_sample_raises_nothing_and_no_time_counts_twice(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(3.5)
    assert ring.follow([60.0, 90.0, 90.0, 90.0, BAD, 60.0, 60.0], 4.5) == []
    ring = watched(6.0)
    ring.follow([90.0, BAD], 4.5)
    now_us = ring.clock.us
    ring.readings.add(
        Sample("bench-1", RING, now_us - round(back_s * 1e6), value, Quality.GOOD, now_us)
        for back_s, value in ((2.5, 90.0), (1.5, 90.0), (0.5, 90.0), (0.1, 60.0))
    )
    ring.clock.advance(1.0)
    ring.look()
    assert [one for one in ring.book.active() if one.level == "alarm"] == []


def test_one_sample_of_a_thousand_a_second_holds_a_thousandth_of_a_second(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(0.5)
    for number in range(5000):
        ring.read(97.0 if number == 5 else 60.0 + number % 3)
        ring.clock.us += 1000
    ring.look()
    assert ring.book.active() == []


def test_ambient_counts_from_its_own_time_on(watched: Callable[..., Watched]) -> None:
    rule = {"limits": {RING: {"warning": 45, "alarm": 48}}, "on_delay_s": 0.0}
    ring = watched(above_ambient=rule)
    for ring_c, ambient_c in ((70.0, 30.0), (60.0, 20.0)):
        ring.read(ambient_c, AMBIENT)
        ring.read(ring_c)
        ring.clock.advance(1.0)
    ring.look()
    assert ring.book.active() == []
    ring.read(72.0)
    ring.clock.advance(1.0)
    ring.read(60.0)
    ring.read(BAD, AMBIENT)
    ring.look()
    assert ring.alarm("above ambient").peak_value == 52.0


# ------------------------------------------------------------------ what must be raised
def test_an_excess_after_one_that_was_acknowledged_calls_again(
    watched: Callable[..., Watched],
) -> None:
    ring = watched()
    ring.follow([60.0, 97.0], 2.0)
    first = ring.alarm()
    ring.book.acknowledge(first.id, "eva")
    changes = ring.follow([60.0, 60.0, 99.0, 60.0, 60.0], 4.5)
    assert [state for _, state in changes] == ["NORM", "UNACK"]
    assert (ring.alarm().peak_value, ring.alarm().id != first.id) == (99.0, True)


def test_a_stay_over_the_limit_counts_to_its_last_sample(watched: Callable[..., Watched]) -> None:
    ring = watched(10.0)
    ring.readings.max_age_s = dict.fromkeys(ring.readings.max_age_s, 2.0)
    ring.follow([60.0] + [90.0] * 13, 0.5)
    ring.clock.advance(3.0)
    ring.look()
    assert ring.alarm().state == "UNACK"


def test_a_delay_that_is_over_when_the_value_is_lost_was_over(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(3.3)
    assert ring.follow([60.0, 90.0, 90.0, 90.0, 90.0, BAD, BAD], 5.5) == [(5.5, "UNACK")]
    ring = watched(9.3)
    ring.read(90.0)
    for look_s in (3.4, 5.0, 5.0):  # at the last look it is older than ten seconds
        ring.clock.advance(look_s)
        ring.look()
    assert (ring.alarm().state, ring.alarm().peak_value) == ("UNACK", 90.0)


@pytest.mark.parametrize("lost", [BAD, 84.5])
def test_what_was_acknowledged_returns_also_before_a_value_that_is_lost(
    watched: Callable[..., Watched], lost: float
) -> None:
    ring = watched(0.0, 3.0)
    ring.follow([97.0], 0.0)
    ring.book.acknowledge(ring.alarm().id, "eva")
    changes = ring.follow([60.0, 60.0, 60.0, 60.0, lost, 99.0, 60.0], 6.5)
    assert [state for _, state in changes] == ["NORM", "UNACK"]


def test_one_look_returns_no_alarm_that_it_raised(watched: Callable[..., Watched]) -> None:
    ring = watched(0.0, 3.0)
    ring.follow([97.0], 0.0)
    ring.book.acknowledge(ring.alarm().id, "eva")
    changes = ring.follow([60.0, 60.0, 60.0, 60.0, 97.0, 60.0, 60.0, 60.0, 60.0, 60.0], 9.5)
    assert [state for _, state in changes] == ["NORM", "UNACK"]


def test_an_excess_that_was_acknowledged_while_it_stood_calls_once(
    watched: Callable[..., Watched],
) -> None:
    ring = watched()
    ring.follow([97.0, 60.0], 1.5)
    ring.clock.advance(0.5)
    ring.read(92.0)
    ring.clock.advance(1.0)
    ring.book.acknowledge(ring.alarm().id, "eva")
    ring.clock.advance(1.0)
    ring.read(92.0)
    ring.clock.advance(2.0)
    ring.look()
    assert ring.alarm().state == "ACKED"


def test_a_change_before_the_first_look_judges_nothing(watched: Callable[..., Watched]) -> None:
    ring = watched()
    ring.read(90.0)
    ring.change(enabled=False)
    assert [*ring.book.normal(), *ring.book.active()] == []


def test_a_change_lets_no_other_delay_begin_from_zero(watched: Callable[..., Watched]) -> None:
    ring = watched(10.0)
    for _ in range(2):
        ring.follow([90.0] * 4, 3.5)
        ring.change(name=("measured limit", RING, "warning"), priority=3)
    changes = ring.follow([90.0] * 4, 3.5)
    assert [state for _, state in changes] == ["UNACK"]


@pytest.mark.parametrize("ambient_c", [30.0, BAD])
def test_an_excess_over_ambient_ends_with_ambient(
    watched: Callable[..., Watched], ambient_c: float
) -> None:
    rule = {"limits": {RING: {"warning": 44, "alarm": 45}}, "on_delay_s": 3.0}
    ring = watched(above_ambient=rule)
    ring.read(20.0, AMBIENT)
    ring.read(70.0)
    ring.clock.advance(0.5)
    ring.look()
    ring.clock.advance(0.5)
    ring.read(ambient_c, AMBIENT)
    ring.clock.advance(3.9)
    ring.read(70.0)
    ring.clock.advance(0.6)
    ring.look()
    assert [one for one in ring.book.active() if one.level == "alarm"] == []


def test_an_excess_over_ambient_may_come_of_ambient_alone(
    watched: Callable[..., Watched],
) -> None:
    rule = {"limits": {RING: {"warning": 44, "alarm": 45}}, "on_delay_s": 0.0}
    ring = watched(above_ambient=rule)
    for at_s, channel, value in ((0, AMBIENT, 30.0), (0, RING, 70.0), (1, AMBIENT, 20.0)):
        ring.clock.us = START_US + at_s * 1_000_000
        ring.read(value, channel)
    ring.clock.advance(2.0)
    ring.read(30.0, AMBIENT)
    ring.clock.advance(2.0)
    ring.look()
    assert ring.alarm("above ambient").peak_value == 50.0


def test_a_clock_that_is_set_back_a_little_stretches_nothing(
    watched: Callable[..., Watched],
) -> None:
    ring = watched(3.0)
    for number in range(46):
        ring.read(97.0 if number == 0 else 60.0)
        ring.clock.us += 100_000
    by_us = -4_000_000
    ring.clock.us += by_us
    ring.readings.clock_set(by_us, ring.clock.us)
    ring.watch.clock_set(by_us)
    ring.book.clock_set(by_us)
    ring.look()
    assert [one for one in ring.book.active() if one.level == "alarm"] == []
