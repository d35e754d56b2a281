"""What the watch over an asset brings together: twin, readings, rules and the alarm book."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from alarm_bench import HandClock

from adapters.samples import Quality, Sample
from service.alarms import AlarmBook, AlarmCondition
from service.domain.alarm_guidance import AlarmName, AlarmOverride
from service.live.estimate import LiveEstimate, RunningModel
from service.live.readings import Readings
from service.live.reference import advance_together
from service.live.watch import AlarmWatch
from service.site.alarm_overlay import AlarmedAsset, rows_of
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts
from service.store import Outbox, Store

from .conftest import asset_section, make_version

STEP_S, LONG_STEP_S = 5.0, 30.0
WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 40.0,
    "t_outer_ring_c": 32.0,
}


class Machine:
    """A machine that a test drives in process time; no event loop, no wall clock."""

    def __init__(
        self, folder: Path, section: AssetSection, active: RunningModel, clock: HandClock
    ) -> None:
        self.clock = clock
        self.store = Store.open("", folder)
        self.outbox = Outbox.open(folder, self.store)
        self.book = AlarmBook(self.outbox, clock, lambda alarm: None)
        channels = {name: ChannelFacts("pt100", 10.0) for name in section.channels}
        channels["speed_rpm"] = ChannelFacts("drive", 10.0)
        self.readings = Readings(section.id, dict.fromkeys(channels, 10.0), clock.now_us())
        self.estimate = LiveEstimate(active)
        self.watch = AlarmWatch(section, channels, self.readings, self.estimate, self.book)

    def run(
        self,
        values: Mapping[str, float],
        seconds: float,
        trusted: bool = True,
        step_s: float = STEP_S,
        quality: int = Quality.GOOD,
    ) -> None:
        for _ in range(round(seconds / step_s)):
            self.clock.advance(step_s)
            now_us = self.clock.now_us()
            self.readings.add(
                Sample("bench-1", name, now_us, value, quality, now_us)
                for name, value in values.items()
            )
            means = self.readings.take_means()
            self.estimate.step(now_us, means)
            advance_together([self.watch.follow(now_us)])
            self.watch.step(now_us, means, trusted)

    def change(self, settings: AssetSection, overrides: Mapping[AlarmName, AlarmOverride]) -> None:
        self.watch.look(self.clock.now_us())
        self.watch.change(settings, overrides)

    def states(self) -> dict[tuple[str, str], str]:
        return {
            (alarm.kind, " ".join(filter(None, (alarm.channel, alarm.level)))): alarm.state
            for alarm in self.book.active()
        }

    def events(self) -> list[tuple[str, str]]:
        assert self.outbox.flush(30)
        lines = self.store.alarms.journal(limit=1000).items
        return [(line.kind, line.who) for line in lines[::-1] if line.alarm_id is None]

    def close(self) -> None:
        self.outbox.close()
        self.store.close()


@pytest.fixture
def make_machine(tmp_path: Path) -> Iterator[Callable[..., Machine]]:
    made: list[Machine] = []
    clock = HandClock()

    def make(identified: bool = True, **settings: Any) -> Machine:
        active = replace(make_version(), identified_at_us=clock.us if identified else None)
        for machine in made:
            machine.close()
        machine = Machine(tmp_path, asset_section(**settings), active, clock)
        made.append(machine)
        return machine

    yield make
    made[-1].close()


def test_a_machine_that_heats_too_fast_is_told_with_its_rate(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine()
    machine.run(WARM, 400)
    for k in range(60):
        machine.run(WARM | {"t_inner_ring_c": 40.0 + k * STEP_S / 60.0 * 5.0}, STEP_S)
    assert machine.states()["rate of rise", "t_inner_ring_c warning"] == "UNACK"
    assert ("rate of rise", "t_inner_ring_c alarm") not in machine.states()


def test_standstill_suppresses_after_a_minute_and_ends_at_once(
    make_machine: Callable[..., Machine],
) -> None:
    hot = WARM | {"t_inner_ring_c": 75.0, "t_outer_ring_c": 60.0}
    key = ("measured limit", "t_inner_ring_c warning")
    machine = make_machine(alarms={"rate_of_rise": {"enabled": False}})
    machine.run(hot, 30)
    assert machine.states()[key] == "UNACK"
    machine.run(hot | {"speed_rpm": 0.0}, 50)
    assert machine.states()[key] == "UNACK"
    machine.run(hot | {"speed_rpm": 0.0}, 20)
    assert machine.states()[key] == "DSUPR"
    machine.run(hot, STEP_S)
    assert machine.states()[key] == "UNACK"


SOURCE = ("stale data", "source:pt100")
SPEED = {"speed_rpm": 2400.0}


def test_a_source_that_falls_silent_is_one_alarm(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine()
    machine.run(WARM, 60)
    machine.run(SPEED, 60)
    assert machine.states() == {SOURCE: "UNACK"}
    machine.run(WARM, 60)
    assert machine.states() == {SOURCE: "RTNUN"}
    (alarm,) = machine.book.active()
    machine.book.acknowledge(alarm.id, "operator")
    assert machine.states() == {}


def test_a_line_that_breaks_is_one_alarm(make_machine: Callable[..., Machine]) -> None:
    """A driver marks the gap with one bad sample per channel, then there is silence."""
    machine = make_machine()
    machine.run(WARM, 60)
    lost = {name: math.nan for name in WARM if name != "speed_rpm"}
    machine.run(lost | SPEED, STEP_S, quality=Quality.COMM_FAILURE)
    machine.run(SPEED, 120)
    assert machine.states() == {SOURCE: "UNACK"}
    machine.run(WARM, 60)
    assert machine.states() == {SOURCE: "RTNUN"}


def test_a_channel_lost_alone_is_acknowledged_with_its_source(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine()
    machine.run(WARM, 60)
    without = {name: value for name, value in WARM.items() if name != "ambient_c"}
    machine.run(without, 40)
    assert machine.states() == {("stale data", "ambient_c"): "UNACK"}
    machine.run(WARM, 40)
    machine.run(without, 40)
    machine.run(WARM, 40)
    assert machine.states() == {("stale data", "ambient_c"): "RTNUN"}
    machine.run(SPEED, 60)
    assert machine.states()[SOURCE] == "UNACK"
    source = next(alarm for alarm in machine.book.active() if alarm.channel == SOURCE[1])
    machine.book.acknowledge(source.id, "operator")
    assert machine.states() == {SOURCE: "ACKED"}
    machine.run(WARM, 60)
    assert machine.states() == {}


def test_a_source_shelved_covers_the_open_alarms_of_its_channels(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine()
    machine.run(WARM, 60)
    without = {name: value for name, value in WARM.items() if name != "ambient_c"}
    machine.run(without, 40)
    machine.run(WARM, 40)
    machine.run(SPEED, 60)
    source = next(alarm for alarm in machine.book.active() if alarm.channel == SOURCE[1])
    machine.book.shelve(source.id, 3600, "operator")
    assert set(machine.states().values()) == {"SHLVD"}


def test_a_slow_channel_has_its_time_after_its_source_is_back(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine()
    machine.readings.max_age_s = {**machine.readings.max_age_s, "ambient_c": 300.0}
    machine.run(WARM, 60)
    machine.run(SPEED, 600)
    assert machine.states() == {SOURCE: "UNACK"}
    without = {name: value for name, value in WARM.items() if name != "ambient_c"}
    machine.run(without, 120)
    assert machine.states() == {SOURCE: "RTNUN"}, "its minute has not come yet"
    machine.run(without, 300)
    assert machine.states()["stale data", "ambient_c"] == "UNACK"


def test_a_first_start_without_data_raises_nothing(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine()
    machine.run({}, 3600)
    assert machine.states() == {}
    machine.run(WARM, 60)
    assert machine.states() == {}


def test_what_had_spoken_before_a_restart_is_missed_after_it(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine()
    machine.run(WARM, 60)
    kept = machine.watch.to_dict()
    restarted = make_machine()
    restarted.watch.restore(kept | {"version": 99})
    restarted.run(SPEED, 60)
    assert restarted.states() == {SOURCE: "UNACK"}


def test_a_machine_hotter_than_its_model_is_told_inside_the_low_risk_region(
    make_machine: Callable[..., Machine],
) -> None:
    """The machine warms as its model first, then its cooling fails: the observer follows it."""
    model = make_machine()
    model.run(WARM, 3 * 3600, step_s=LONG_STEP_S)
    expected = {
        name: float(model.estimate.active.model.sensor_row(name) @ temperatures)
        for temperatures in [model.watch._comparison._reference._temperatures_c]
        for name in ("t_inner_ring_c", "t_outer_ring_c")
    }
    settled = WARM | expected
    hotter = settled | {name: value + 6.0 for name, value in expected.items()}
    # Outside, where the model was never identified, nobody is told.
    outside = make_machine(low_risk={"speed_rpm_max": 1000, "load_n_max": 3000})
    outside.run(settled, 900, step_s=LONG_STEP_S)
    outside.run(hotter, 2400, step_s=LONG_STEP_S)
    assert outside.states() == {}
    machine = make_machine()
    machine.run(settled, 900, step_s=LONG_STEP_S)
    assert machine.states() == {}
    machine.run(hotter, 2400, step_s=LONG_STEP_S)
    states = machine.states()
    assert states["twin difference", "t_outer_ring_c warning"] == "UNACK"
    assert ("twin difference", "t_outer_ring_c alarm") not in states


def test_before_an_identification_the_model_accuses_nobody(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine(identified=False)
    machine.run(WARM, 1800, step_s=LONG_STEP_S)
    machine.run(WARM | {"t_inner_ring_c": 60.0, "t_outer_ring_c": 50.0}, 3600, step_s=LONG_STEP_S)
    assert not {kind for kind, _ in machine.states()} & {"twin difference", "twin residual"}


def test_what_was_learnt_goes_on_after_a_restart(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine()
    machine.run(WARM, 7200, step_s=LONG_STEP_S)
    kept_estimate, kept = machine.estimate.to_dict(), machine.watch.to_dict()
    assert kept["reference"] is not None
    assert kept["residuals"]["t_inner_ring_c"]["usual"]
    restarted = make_machine()
    restarted.estimate.restore(kept_estimate or {})
    restarted.watch.restore(kept)
    assert restarted.watch.to_dict() == kept
    restarted.watch.restore(kept | {"version": 99, "reference": None})
    assert restarted.watch.to_dict() == kept, "of another version"
    restarted.watch.restore({"version": 1, "reference": {"temperatures_c": [1.0]}})
    assert restarted.watch.to_dict() == kept, "of another model"


def test_events_tell_of_trust_and_of_versions(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine()
    machine.run(WARM, 30)
    machine.run(WARM, 30, trusted=False)
    machine.run(WARM, 30)
    active = machine.estimate.active
    for version, before in ((2, 1), (1, 2), (1, 1)):
        machine.estimate.swap(replace(active, version=version))
        machine.watch.switched(before, "engineer x", "why not")
    assert machine.events() == [
        ("model not trusted", "service"),
        ("model trusted again", "service"),
        ("model activated", "engineer x"),
        ("model rolled back", "engineer x"),
    ]
    assert machine.states() == {}


def test_alarms_of_an_earlier_configuration_end(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine()
    stays = {"kind": "forecast limit", "level": "warning"}
    for kind in ({"kind": "measured limit", "level": "gone"}, stays):
        machine.book.evaluate(
            AlarmCondition(
                asset="bench-1",
                channel="t_inner_ring_c",
                active=True,
                value=None,
                message="",
                priority=2,
                **kind,  # type: ignore[arg-type]
            )
        )
    assert len(machine.states()) == 2
    restarted = make_machine()
    restarted.run(WARM, STEP_S)
    assert list(restarted.states()) == [("forecast limit", "t_inner_ring_c warning")]


def test_a_kind_that_is_switched_off_says_nothing(make_machine: Callable[..., Machine]) -> None:
    machine = make_machine(alarms={"measured_limit": {"enabled": False}})
    machine.run(WARM | {"t_inner_ring_c": 120.0}, 60)
    assert not [kind for kind, _ in machine.states() if kind == "measured limit"]


LIMIT = ("measured limit", "t_inner_ring_c warning")


def test_changed_settings_count_from_the_next_sample_and_keep_the_alarm(
    make_machine: Callable[..., Machine],
) -> None:
    machine = make_machine(alarms={"rate_of_rise": {"enabled": False}})
    hot = WARM | {"t_inner_ring_c": 75.0}
    machine.run(hot, 60)
    (before,) = machine.book.active()
    assert (before.limit_value, before.priority) == (70.0, 2)
    lower = asset_section(limits={"t_inner_ring_c": {"warning": 60, "alarm": 65}})
    name = ("measured limit", "t_inner_ring_c", "warning")
    machine.change(lower, {name: AlarmOverride(priority=3, on_delay_s=0.0)})
    machine.run(hot, 15)
    states = {alarm.level: alarm for alarm in machine.book.active()}
    after = states["warning"]
    assert (after.id, after.limit_value, after.priority) == (before.id, 60.0, 3)
    assert states["alarm"].state == "UNACK", "the lower alarm limit counts at once"
    machine.change(lower, {name: AlarmOverride(enabled=False)})
    machine.run(hot, STEP_S)
    assert LIMIT not in machine.states()
    machine.change(lower, {})
    machine.run(hot, 15)
    assert machine.states()[LIMIT] == "UNACK"


def test_every_alarm_that_is_watched_has_a_row(make_machine: Callable[..., Machine]) -> None:
    levels = {"warning": 60, "alarm": 65}
    above = {"above_ambient": {"limits": {"t_inner_ring_c": levels}}}
    machine = make_machine(alarms=above)
    machine.run(WARM, 60)
    watched = {(one.kind, one.channel, one.level) for one in machine.book.normal("bench-1")}
    section = machine.watch._settings
    rows = {row.name for row in rows_of(AlarmedAsset(section, machine.watch._channels), {})}
    assert watched <= rows
    # What waits for a forecast, or for a model that knows the sensor, is not watched yet.
    assert {name[0] for name in rows - watched} <= {"forecast limit", "twin residual"}
