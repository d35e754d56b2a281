"""Samples of impossible times, which earlier versions took: found, removed, and no reader ends."""

from pathlib import Path

import pytest
from sqlalchemy import func, select

from adapters.samples import Sample
from service.clock import DAY_US, HOUR_US, from_rfc3339, rfc3339
from service.store import AuditEntry, Store
from service.store.tables import (
    PackedHourRow,
    RollupBlockRow,
    RollupRow,
    SampleBlockRow,
    SampleRow,
    StaleRollupRow,
)

NOW_US = from_rfc3339("2026-11-28T08:00:00Z")
BEFORE_US = 1_764_230_400_000
"""A time in milliseconds that was taken for one in microseconds: 1970."""
AFTER_US = 1_764_230_400_000_000_000
"""The same in nanoseconds: the year 57,000."""
TABLES = (SampleRow, PackedHourRow, SampleBlockRow, RollupRow, RollupBlockRow, StaleRollupRow)


def line(count: int) -> AuditEntry:
    return AuditEntry(NOW_US, "eva", "", "samples.remove", "store", f"{count} samples")


def fill(store: Store, channel: str, *begins_us: int, count: int = 100) -> None:
    store.samples.write(
        [
            Sample("a", channel, begin_us + k * 1_000_000, 40.0 + k % 7, 192, NOW_US)
            for begin_us in begins_us
            for k in range(count)
        ]
    )


def settle(store: Store, until_us: int) -> None:
    while store.rollups.refresh(until_us) or store.packing.pack(until_us):
        pass


def sizes(store: Store) -> list[int]:
    with store._database.reading() as connection:
        return [connection.scalar(select(func.count()).select_from(one)) or 0 for one in TABLES]


@pytest.mark.parametrize("is_packed", [False, True])
def test_impossible_times_are_found_and_removed_and_nothing_else(
    store: Store, is_packed: bool
) -> None:
    good_us = NOW_US - 3 * DAY_US
    fill(store, "x", good_us)
    fill(store, "y", good_us)
    until_us = AFTER_US + DAY_US if is_packed else 0
    settle(store, until_us)
    before, rollups = sizes(store), store.history.read("a", None, 0, NOW_US, HOUR_US, 1000)
    assert store.impossible_times.find(NOW_US) == []
    assert store.impossible_times.remove(NOW_US, line) == 0
    assert store.audit.page().items == []
    fill(store, "x", BEFORE_US, AFTER_US)
    settle(store, until_us)
    (found,) = store.impossible_times.find(NOW_US)
    assert found == ("a", "x", 200, BEFORE_US, AFTER_US + 99_000_000)
    assert store.impossible_times.find(NOW_US, ["b"]) == []
    assert store.impossible_times.remove(NOW_US, line) == 200
    assert store.impossible_times.find(NOW_US) == []
    assert sizes(store) == before
    assert store.history.read("a", None, 0, NOW_US, HOUR_US, 1000) == rollups
    lines = [one.detail for one in store.audit.page().items]
    assert lines == ["100 samples", "100 samples"], "those of 1970 and those of 57,000"


def test_what_can_be_stays(store: Store) -> None:
    ends_us = from_rfc3339("1990-01-01T00:00:00Z"), NOW_US + DAY_US
    fill(store, "x", *ends_us, count=1)
    assert store.impossible_times.remove(NOW_US, line) == 0
    fill(store, "x", ends_us[0] - 1, ends_us[1] + 4 * HOUR_US, count=1)
    assert store.impossible_times.remove(NOW_US, line) == 2
    assert [row.time_us for row in store.samples.read("a", None, 0, 2**62, 10)] == list(ends_us)


def test_many_samples_go_in_portions(sqlite_store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.store.impossible_times._PORTION", 30)
    fill(sqlite_store, "x", AFTER_US, BEFORE_US)
    assert sqlite_store.impossible_times.remove(NOW_US, line) == 200
    assert sizes(sqlite_store) == [0] * len(TABLES)
    counts = [int(one.detail.split()[0]) for one in sqlite_store.audit.page().items]
    assert sum(counts) == 200, "each transaction has its line"
    assert max(counts) <= 30


def test_years_of_more_than_four_digits_end_no_reader(tmp_path: Path) -> None:
    assert rfc3339(AFTER_US) == "9999-12-31T23:59:59.999Z"
    assert rfc3339(-(10**18)) == "0001-01-01T00:00:00.000Z"
