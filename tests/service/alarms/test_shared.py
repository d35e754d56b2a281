"""One cause, one alarm: what many assets have of one source, or of one clock."""

from collections.abc import Collection, Iterable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from alarm_bench import STORED, Bench
from sqlalchemy import MetaData, Table, create_engine

from service.alarms import AlarmBook, AlarmCondition, SharedCauses
from service.documents.alarms import alarm_document, alarm_summary, transition_document
from service.domain.causes import cause_of, has_own_alarm
from service.store import Alarm, JournalFilter, Store
from service.store.migrations import upgrade

ASSETS = [f"bench-{number}" for number in range(1, 201)]
OF_SOURCE = AlarmCondition(
    asset="",
    kind="stale data",
    channel="source:gateway-1",
    level="",
    active=True,
    value=None,
    message="No data from gateway-1 (5 channels)",
    priority=2,
    on_delay_s=10.0,
    off_delay_s=10.0,
    covers=("load_n", "speed_rpm"),
)
KEY = OF_SOURCE.key


class Site:
    """A book and what the assets of a cell say of one source, every five seconds."""

    def __init__(self, bench: Bench, assets: Collection[str] = ASSETS) -> None:
        self.bench = bench
        self.truth = dict.fromkeys(assets, False)
        self.settings: dict[str, AlarmCondition] = {}
        self.begin()

    def begin(self) -> None:
        self.shared = SharedCauses(self.bench.book)
        self.shared.expect(self.truth)

    @property
    def book(self) -> AlarmBook:
        return self.bench.book

    def run(self, seconds: float, lost: Iterable[str] | None = None) -> None:
        if lost is not None:
            gone = set(lost)
            self.truth = {asset: asset in gone for asset in self.truth}
        for _ in range(round(seconds / 5.0)):
            self.bench.clock.advance(5.0)
            self.step()

    def step(self) -> None:
        for asset, active in self.truth.items():
            of_asset = self.settings.get(asset, OF_SOURCE)
            condition = replace(of_asset, asset=asset, active=active)
            self.shared.take(condition, self.bench.clock.us)
            self.shared.settle(asset, {KEY})
        self.shared.evaluate()

    def restart(self) -> None:
        self.bench.restart()
        self.begin()

    def raised(self) -> list[str]:
        """The transitions of the alarms of the source, as the journal has them."""
        return [line.to_state for line in self.bench.journal() if line.alarm_id]


@pytest.fixture
def site(bench: Bench) -> Site:
    return Site(bench)


def test_a_lost_gateway_is_one_alarm_with_its_assets_and_ends_once(site: Site) -> None:
    site.run(30, lost=[])
    assert site.book.active() == []
    site.run(60, lost=ASSETS)
    alarm = site.bench.only()
    document = alarm_document(alarm)
    assert document.message == "gateway-1: no data, 200 assets"
    assert document.asset is None
    assert document.assets == sorted(ASSETS)
    assert document.cause.model_dump() == {"kind": "source", "id": "gateway-1"}
    site.run(60, lost=[])
    assert (site.bench.only().state, site.bench.only().assets) == ("RTNUN", tuple(sorted(ASSETS)))
    site.book.acknowledge(alarm.id, "eva")
    site.run(30)
    assert site.book.active() == []
    assert site.raised() == ["UNACK", "RTNUN", "NORM"]
    counts = site.bench.store.alarms.annunciations(site.bench.clock.us)
    assert (counts.in_last_24_h, [one.count for one in counts.most_frequent]) == (1, [1])


def test_a_clock_that_is_ahead_is_named_as_that_for_all_its_assets(bench: Bench) -> None:
    text = "gateway-1: clock ahead by 280 s, values uncertain"
    shared = SharedCauses(bench.book)
    for asset in ("bench-1", "bench-2"):
        shared.take(
            replace(OF_SOURCE, asset=asset, kind="clock ahead", message=text, on_delay_s=0.0),
            bench.clock.us,
        )
    shared.evaluate()
    (alarm,) = bench.book.active()
    assert alarm.message == "gateway-1: clock ahead, values uncertain, 2 assets"


def test_each_asset_has_the_alarm_and_its_journal(site: Site) -> None:
    site.run(30, lost=ASSETS[:3])
    for asset in ASSETS[:3]:
        assert [one.id for one in site.book.active(asset)] == [site.bench.only().id]
        assert ("stale data", "source:gateway-1", "") in site.book.present(asset)
        assert alarm_summary(site.book.active(asset)).unacknowledged == 1
    assert site.book.active("bench-4") == []
    assert site.book.present("bench-4") == frozenset()
    site.bench.journal()
    for asset, count in (("bench-3", 1), ("bench-4", 0), ("bench-30", 0)):
        lines = site.bench.store.alarms.journal(JournalFilter(asset)).items
        assert len(lines) == count, asset
    line = transition_document(site.bench.journal()[0], None)
    assert (line.asset, line.assets) == (None, sorted(ASSETS[:3]))
    # Who joins later has the whole history of the alarm.
    site.run(30, lost=ASSETS[:4])
    site.book.comment(site.bench.only().id, "eva", "cable is out")
    site.bench.journal()
    lines = site.bench.store.alarms.journal(JournalFilter("bench-4")).items
    assert [one.event for one in lines] == ["comment", "raise"]


def test_an_asset_that_is_back_leaves_the_alarm_and_one_alone_is_named(site: Site) -> None:
    site.run(30, lost=ASSETS[:2])
    site.run(30, lost=ASSETS[1:2])
    document = alarm_document(site.bench.only())
    assert (document.asset, document.assets) == ("bench-2", ["bench-2"])
    assert document.message == "No data from gateway-1 (5 channels)"
    assert site.book.active("bench-1") == []
    assert site.raised() == ["UNACK"]


def test_a_slow_gateway_is_lost_where_one_asset_misses_it_for_long_enough(site: Site) -> None:
    """Each asset has its own delay: many that are late for a moment are no lost source."""
    for number in range(40):
        site.run(5, lost=ASSETS[number : number + 1])
    assert site.book.active() == []


def test_what_is_lost_later_calls_again_once(site: Site) -> None:
    site.run(30, lost=ASSETS[:1])
    site.book.acknowledge(site.bench.only().id, "eva")
    site.run(60)
    assert site.bench.only().state == "ACKED"
    site.run(30, lost=ASSETS[:8])
    assert site.bench.only().state == "UNACK"
    line = site.bench.journal()[-1]
    assert (line.event, line.comment) == (
        "re-alarm",
        "also: bench-2, bench-3, bench-4, bench-5, bench-6 and 2 more",
    )
    site.book.acknowledge(site.bench.only().id, "eva")
    site.run(60, lost=ASSETS[:4])
    site.run(60, lost=ASSETS[:8])
    assert site.bench.only().state == "ACKED", "these were acknowledged in this life"


def test_acknowledged_and_shelved_outlive_a_restart(site: Site) -> None:
    site.run(30, lost=ASSETS)
    alarm_id = site.bench.only().id
    site.book.acknowledge(alarm_id, "eva", "cable is out")
    site.restart()
    assert (site.bench.only().id, site.bench.only().assets) == (alarm_id, tuple(sorted(ASSETS)))
    site.shared.evaluate()
    site.run(60)
    assert site.bench.only().state == "ACKED"
    site.book.shelve(alarm_id, 600, "eva")
    site.restart()
    site.run(60)
    assert (site.bench.only().id, site.bench.only().state) == (alarm_id, "SHLVD")
    site.run(60, lost=[])
    site.restart()
    site.run(600)
    assert site.book.active() == []


def test_an_alarm_stays_until_all_of_its_assets_have_said_something(site: Site) -> None:
    site.run(30, lost=ASSETS)
    site.restart()
    first = dict(list(site.truth.items())[:50])
    everything, site.truth = site.truth, dict.fromkeys(first, False)
    site.run(60)
    assert site.bench.only().state == "UNACK"
    site.truth = dict.fromkeys(everything, False)
    site.run(60)
    assert site.bench.only().state == "RTNUN"


def test_alarms_of_each_asset_of_an_earlier_version_become_one(bench: Bench) -> None:
    for number, asset in enumerate(ASSETS[:5]):
        state = "ACKED" if number < 4 else "UNACK"
        bench.store.alarms.save(
            replace(
                STORED, id=f"old-{number}", asset=asset, kind="stale data",
                channel="source:gateway-1", level="", priority=2, state=state, value=None,
            )
        )  # fmt: skip
    bench.restart()
    site = Site(bench, ASSETS[:5])
    site.run(10, lost=ASSETS[:5])
    alarm = bench.only()
    assert (alarm.id, alarm.state, alarm.assets) == ("old-4", "UNACK", tuple(ASSETS[:5]))
    assert [(line.alarm_id, line.to_state) for line in bench.journal()] == [
        (f"old-{number}", "NORM") for number in range(4)
    ]
    assert {one.id for one in bench.store.alarms.load()} == {"old-4"}
    site.run(60, lost=[])
    site.book.acknowledge("old-4", "eva")
    assert bench.book.active() == []


def test_a_store_of_the_version_before_has_its_alarms(tmp_path: Path) -> None:
    """Its tables know of no assets of an alarm."""
    engine = create_engine(f"sqlite:///{tmp_path / 'store.db'}")
    upgrade(engine, "0023")
    old = asdict(replace(STORED, kind="stale data", channel="source:gateway-1", asset="bench-1"))
    del old["assets"]
    with engine.begin() as connection:
        table = Table("alarms", MetaData(), autoload_with=connection)
        connection.execute(table.insert().values(old))
    engine.dispose()
    with Store.open(f"sqlite:///{tmp_path / 'store.db'}", tmp_path) as store:
        (alarm,) = store.alarms.load()
        assert (alarm.asset, alarm.assets) == ("bench-1", ())
        store.alarms.save(replace(alarm, assets=("bench-1", "bench-2")))
        assert store.alarms.load()[0].assets == ("bench-1", "bench-2")


def test_what_people_say_counts_for_what_the_source_covers(site: Site) -> None:
    own = replace(OF_SOURCE, asset="bench-2", channel="speed_rpm", covers=(), on_delay_s=0.0)
    other = replace(own, asset="bench-9")
    site.run(30, lost=ASSETS[:3])
    site.book.evaluate_all([own, other])
    shared = next(one for one in site.book.active() if one.channel == KEY[2])
    site.book.acknowledge(shared.id, "eva")
    states = {(one.asset, one.channel): one.state for one in site.book.active()}
    assert states["bench-2", "speed_rpm"] == "ACKED"
    assert states["bench-9", "speed_rpm"] == "UNACK", "its source is there"


def test_each_asset_keeps_its_own_settings(site: Site) -> None:
    site.settings["bench-2"] = replace(OF_SOURCE, priority=1, on_delay_s=60.0)
    site.run(30, lost=ASSETS[:2])
    assert (site.bench.only().priority, site.bench.only().assets) == (2, ("bench-1",))
    site.run(60)
    assert (site.bench.only().priority, site.bench.only().assets) == (1, ("bench-1", "bench-2"))


def test_an_asset_that_is_removed_leaves_the_alarm_to_the_others(site: Site) -> None:
    site.run(30, lost=ASSETS[:3])
    alarm_id = site.bench.only().id
    for asset in ASSETS[:3]:
        site.shared.forget([asset])
        site.book.forget([asset])
        del site.truth[asset]
        site.run(5)
    assert site.book.active() != []
    site.run(30)
    assert (site.bench.only().id, site.bench.only().state) == (alarm_id, "RTNUN")


def test_a_source_that_no_asset_has_any_more_ends(bench: Bench) -> None:
    site = Site(bench, ASSETS[:2])
    site.run(30, lost=ASSETS[:2])
    for asset in ASSETS[:2]:
        site.shared.settle(asset, ())
    assert bench.book.active() == []
    assert bench.journal()[-1].comment == "no longer configured"


def test_a_source_that_is_gone_after_a_restart_ends(bench: Bench) -> None:
    site = Site(bench, ASSETS[:2])
    site.run(30, lost=ASSETS[:2])
    site.restart()
    for asset in ASSETS[:2]:
        site.shared.evaluate()
        assert len(bench.book.active()) == 1
        site.shared.settle(asset, ())
    site.shared.evaluate()
    assert bench.book.active() == []


def test_a_cell_that_leaves_assets_keeps_its_alarm_for_the_others(bench: Bench) -> None:
    """Under which asset it is kept, with that it would go to the other cell."""
    site = Site(bench, ASSETS[:4])
    site.run(30, lost=ASSETS[:4])
    kept = bench.only()
    left = [kept.asset]
    site.shared.leave(left)
    site.book.leave(left)
    del site.truth[kept.asset]
    site.run(10)
    assert (bench.only().id, bench.only().asset) == (kept.id, "bench-2")
    assert bench.only().assets == ("bench-2", "bench-3", "bench-4")
    bench.journal()
    assert [one.asset for one in bench.store.alarms.load()] == ["bench-2"]
    # What is left without any is another cell's: it stays open in the store.
    site.shared.leave(ASSETS[1:4])
    site.book.leave(ASSETS[1:4])
    assert bench.book.active() == []
    bench.journal()
    assert [one.id for one in bench.store.alarms.load()] == [kept.id]
    # Another cell goes on with it.
    other = AlarmBook(bench.outbox, bench.clock, lambda alarm: None, begins_empty=True)
    other.take_over(ASSETS[1:3])
    assert [one.id for one in other.active()] == [kept.id]


def test_two_parts_of_a_source_that_come_into_one_cell_are_one_alarm(bench: Bench) -> None:
    site = Site(bench, ASSETS[:2])
    site.run(30, lost=ASSETS[:2])
    mine = bench.only()
    theirs = replace(mine, id="theirs", asset="bench-7", assets=("bench-7", "bench-8"))
    bench.store.alarms.save(theirs)
    bench.book.take_over(["bench-7"])
    site.truth |= {"bench-7": True}
    site.run(20)
    assert (bench.only().id, bench.only().assets) == (mine.id, ("bench-1", "bench-2", "bench-7"))
    bench.journal()
    assert [one.id for one in bench.store.alarms.load()] == [mine.id]


def test_an_outbox_of_an_earlier_version_is_read(bench: Bench) -> None:
    from service.store.changes import AlarmChange, change_of, document_of

    document = document_of(AlarmChange(STORED)).replace(', "assets": []', "")
    assert "assets" not in document
    read = change_of(document)
    assert isinstance(read, AlarmChange)
    assert read.alarm == STORED
    two = replace(STORED, assets=("a", "b"))
    again = change_of(document_of(AlarmChange(two)))
    assert isinstance(again, AlarmChange)
    assert again.alarm == two


def test_a_channel_that_is_pushed_alone_is_missed_on_its_own() -> None:
    assert has_own_alarm("gateway-1", ["speed_rpm"])
    assert has_own_alarm("push", ["speed_rpm", "load_n"])
    assert not has_own_alarm("push", ["speed_rpm"])


@pytest.mark.parametrize(
    ("alarm", "cause"),
    [
        (replace(STORED, channel="source:can-1"), ("source", "can-1")),
        (replace(STORED, kind="history not kept", channel=""), ("service", "clock")),
        (replace(STORED, predicted=True), ("step", "a")),
        (STORED, ("machine", "a")),
    ],
)
def test_every_alarm_has_a_cause(alarm: Alarm, cause: tuple[str, str]) -> None:
    found = cause_of(alarm.asset, alarm.kind, alarm.channel, predicted=alarm.predicted)
    assert found == cause
    assert alarm_document(alarm).cause.model_dump() == {"kind": cause[0], "id": cause[1]}
