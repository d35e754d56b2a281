from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from alarm_bench import STORED as ALARM
from alembic import command
from sqlalchemy import create_engine

from service.store import Alarm, AlarmTransition, JournalFilter, Store, migrations
from service.store.opening import FILE_NAME


def line(time_us: int, alarm: Alarm = ALARM) -> AlarmTransition:
    return AlarmTransition(
        alarm_id=alarm.id,
        asset=alarm.asset,
        kind=alarm.kind,
        channel=alarm.channel,
        level=alarm.level,
        time_us=time_us,
        from_state="NORM",
        to_state="UNACK",
        who="service",
        comment="",
        value=alarm.value,
        message=alarm.message,
        event="raise",
        priority=alarm.priority,
    )


@pytest.mark.wires
def test_an_alarm_is_kept_until_it_is_over(store: Store) -> None:
    store.alarms.save(ALARM, [line(100)])
    assert store.alarms.load() == [ALARM]
    acked = replace(ALARM, state="ACKED", acknowledged_by="eva", acknowledged_at_us=150)
    store.alarms.save(acked)
    assert store.alarms.load() == [acked]
    store.alarms.save(replace(acked, state="NORM", returned_at_us=200), [line(200)])
    assert store.alarms.load() == []
    again = replace(ALARM, id="two", raised_at_us=300)
    store.alarms.save(again, [line(300, again)])
    assert store.alarms.load() == [again]
    assert [one.time_us for one in store.alarms.journal().items] == [300, 200, 100]


def test_an_open_alarm_that_its_owner_does_not_know_gives_way_to_the_next_one(
    store: Store,
) -> None:
    store.alarms.save(ALARM)
    store.alarms.save(replace(ALARM, id="other level", level="warning"))
    two = replace(ALARM, id="two", raised_at_us=300, since_us=300)
    store.alarms.save(two, [line(300, two)])
    assert {one.id for one in store.alarms.load()} == {"two", "other level"}
    journal = store.alarms.journal().items
    assert [(one.alarm_id, one.to_state) for one in journal] == [("two", "UNACK"), ("one", "NORM")]
    assert journal[1].comment == "the owner of the asset does not know it"


def test_an_open_alarm_that_its_owner_does_not_know_ends_with_the_one_that_it_knows(
    store: Store,
) -> None:
    """After a failover: the copy holds an alarm that had ended, the disk of a cell the next one."""
    store.alarms.save(ALARM)
    over = replace(ALARM, id="two", state="NORM", since_us=300, returned_at_us=300)
    store.alarms.save(over, [line(300, over)])
    assert store.alarms.load() == []
    assert [(one.alarm_id, one.to_state) for one in store.alarms.journal().items][-1] == (
        "one",
        "NORM",
    )


def test_the_journal_comes_in_pages_newest_first(store: Store) -> None:
    for time_us in range(7):
        store.alarms.save(ALARM, [line(time_us)])
    seen = []
    cursor = None
    while True:
        page = store.alarms.journal(JournalFilter(start_us=1, end_us=6), limit=2, cursor=cursor)
        seen += [one.time_us for one in page.items]
        cursor = page.next_cursor
        if cursor is None:
            break
        assert len(page.items) == 2
    assert seen == [5, 4, 3, 2, 1]
    assert store.alarms.journal(limit=7).next_cursor is None
    assert store.alarms.journal(limit=1).items == [line(6)]


def test_the_journal_is_filtered_by_asset_alarm_and_class(store: Store) -> None:
    other = replace(ALARM, id="two", asset="b")
    event = replace(line(3), alarm_id=None, kind="model drift", event="", from_state="")
    store.alarms.save(ALARM, [line(1), line(2)])
    store.alarms.save(other, [line(4, other)])
    store.alarms.save(None, [event])

    def times(**wanted: Any) -> list[int]:
        return [one.time_us for one in store.alarms.journal(JournalFilter(**wanted)).items]

    assert times(asset="b") == [4]
    assert times(alarm_id="one") == [2, 1]
    assert times(events=True) == [3]
    assert sorted(times(events=False)) == [1, 2, 4]
    assert times(asset="a", events=False, start_us=2) == [2]
    assert store.alarms.journal(JournalFilter(events=True)).items == [event]


def test_annunciations_are_counted_per_ten_minutes_and_by_kind(store: Store) -> None:
    minute, now_us = 60_000_000, 10**15
    other = replace(ALARM, id="two", asset="b", channel="c", priority=2)
    raised = [line(now_us - k * minute) for k in (0, 9, 10, 25, 26, 27, 1439, 1440)]
    noise = [
        replace(line(now_us), from_state="UNACK", to_state="UNACK", event="comment"),
        replace(line(now_us), from_state="UNACK", to_state="ACKED", event="acknowledge"),
    ]
    store.alarms.save(ALARM, [*raised, *noise])
    store.alarms.save(other, [line(now_us, other)])
    counts = store.alarms.annunciations(now_us)
    assert (counts.in_last_10_min, counts.in_last_24_h, counts.most_in_10_min) == (3, 8, 3)
    assert counts.by_priority == {1: 7, 2: 1}
    assert [(one.channel, one.count) for one in counts.most_frequent] == [
        ("t_inner_ring_c", 7),
        ("c", 1),
    ]
    assert store.alarms.annunciations(now_us, "b").in_last_24_h == 1
    assert store.alarms.annunciations(now_us, "none").in_last_10_min == 0


def test_an_older_store_keeps_its_alarms(tmp_path: Path) -> None:
    """What the version before these columns wrote is taken over by the migration."""
    engine = create_engine(f"sqlite:///{tmp_path / FILE_NAME}")
    config = migrations._config()
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0005")
        connection.exec_driver_sql(
            "INSERT INTO alarms (id, asset, kind, channel, level, state, priority, message, "
            "predicted, raised_at_us, since_us) VALUES "
            "('one', 'a', 'measured limit', 'c', 'alarm', 'ACKED', 1, 'hot', 0, 5, 6), "
            "('two', 'a', 'measured limit', 'd', 'alarm', 'RTNUN', 1, 'hot', 0, 5, 6)"
        )
        connection.exec_driver_sql(
            "INSERT INTO alarm_journal (alarm_id, asset, kind, channel, level, time_us, "
            "from_state, to_state, who, comment, message) VALUES "
            "('one', 'a', 'measured limit', 'c', 'alarm', 5, 'NORM', 'UNACK', 'x', '', 'hot')"
        )
    engine.dispose()
    with Store.open("", tmp_path) as store:
        assert [(one.state, one.present) for one in store.alarms.load()] == [
            ("ACKED", True),
            ("RTNUN", False),
        ]
        (kept,) = store.alarms.journal().items
        assert (kept.alarm_id, kept.event, kept.priority) == ("one", "", None)
        store.alarms.save(None, [replace(kept, alarm_id=None)])


def test_old_lines_go_and_with_them_alarms_that_are_over(store: Store) -> None:
    over, standing = replace(ALARM, id="over", level="warning"), ALARM
    event = replace(line(3), alarm_id=None)
    store.alarms.save(over, [line(1, over)])
    store.alarms.save(replace(over, state="NORM", since_us=2), [line(2, over)])
    later = replace(over, id="later", state="NORM", since_us=9)
    store.alarms.save(later, [line(9, later)])
    store.alarms.save(standing, [line(1), line(8)])
    store.alarms.save(None, [event])
    assert store.alarms.expire(5) == 5, "four lines and the alarm that is over"
    assert [kept.time_us for kept in store.alarms.journal().items] == [8, 9]
    assert store.alarms.load() == [standing]
