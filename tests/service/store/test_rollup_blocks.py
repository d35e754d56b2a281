"""Minutes and seconds in blocks: every bit, next to the rows that an earlier version left."""

import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import delete, insert, select, update

from adapters.samples import Sample
from service.clock import HOUR_US, MINUTE_US
from service.store import Retention, Rollup, Store, StoreError, buckets, rollup_blocks
from service.store.blocks import BlockDamagedError
from service.store.rollup_blocks import SPANS_US, Buckets, pack, unpack
from service.store.salvage import salvage_store
from service.store.tables import RollupBlockRow, RollupRow, StaleRollupRow

START_US = 1_790_000_000_000_000 // SPANS_US[60] * SPANS_US[60]
SECOND_US = 1_000_000
END_US = START_US + 100 * HOUR_US
LEVELS_US = (MINUTE_US, 5 * MINUTE_US, 10 * MINUTE_US, 20 * MINUTE_US, HOUR_US, 24 * HOUR_US)


def filled(store: Store, hours: int = 10, channels: int = 2, spread: float = 3.0) -> None:
    """Samples with gaps, bad ones and whole minutes of bad ones."""
    rng = np.random.default_rng(3)
    batch = [
        Sample(
            "m", f"c-{channel}", START_US + second * SECOND_US, round(rng.normal(50, spread), 1),
            24 if second % 700 < 65 or rng.random() < 0.05 else 192, 9,
        )
        for channel in range(channels)
        for second in range(0, hours * 3600, 20)
        if second % 5000 > 300
    ]  # fmt: skip
    store.samples.write(batch)


def settle(store: Store) -> None:
    while store.rollups.refresh(END_US) or store.packing.pack(END_US):
        pass


def levels(store: Store) -> list[list[Rollup]]:
    """All that is read at each level."""
    begin_us = START_US - 24 * HOUR_US
    return [
        store.history.read("m", None, begin_us, END_US, level_us, 10**6) for level_us in LEVELS_US
    ]


def require_same(found: list[list[Rollup]], expected: list[list[Rollup]]) -> None:
    """Minutes and hours to the last bit; what is joined of them in another order but for that."""
    assert str(found[0]) == str(expected[0])
    assert str(found[4]) == str(expected[4])
    for mine, other in zip(found, expected, strict=True):
        assert other
        assert [one._replace(mean=None) for one in mine] == [
            one._replace(mean=None) for one in other
        ]
        means = [math.nan if one.mean is None else one.mean for one in other]
        assert [math.nan if one.mean is None else one.mean for one in mine] == pytest.approx(
            means, rel=1e-14, nan_ok=True
        )


def rows(store: Store, row: Any) -> list[Any]:
    with store._database.reading() as connection:
        return list(connection.execute(select(row.__table__)).all())


def as_an_earlier_version_left_it(store: Store) -> None:
    """Make rows of the blocks, and rows of ten minutes next to those of minutes."""
    made = []
    for channel_id, resolution_s, begin_us, codec, crc, data in rows(store, RollupBlockRow):
        found = unpack(rollup_blocks.Block(codec, crc, data), resolution_s, begin_us)
        for row_s in (60, 600) if resolution_s == 60 else (resolution_s,):
            made += [
                {
                    "channel_id": channel_id, "resolution_s": row_s, "time_us": one.time_us,
                    "mean": one.mean, "low": one.low, "high": one.high,
                    "good": one.good, "quality": one.quality,
                }
                for one in buckets.listed(buckets.joined(found, row_s * SECOND_US))
            ]  # fmt: skip
    with store._database.writing() as connection:
        connection.execute(insert(RollupRow), made)
        connection.execute(delete(RollupBlockRow))


def test_rows_of_an_earlier_version_are_read_and_moved_without_a_change(store: Store) -> None:
    filled(store)
    settle(store)
    before = levels(store)
    assert {row.resolution_s for row in rows(store, RollupRow)} == {3600}
    as_an_earlier_version_left_it(store)
    require_same(levels(store), before)
    count = len(rows(store, RollupRow))
    assert store.rollups.pack_rows(until_s=0.0) == 0, "no time"
    # A portion, as when it is ended in the middle; then an hour is computed again.
    store.rollups._moves.size = 1
    moved = store.rollups.pack_rows()
    assert 0 < moved < count / 2
    require_same(levels(store), before)
    late = [Sample("m", f"c-{k}", START_US + 5 * HOUR_US + 1, 99.0, 192, 9) for k in (0, 1)]
    assert store.samples.write(late).stored == 2
    after = levels(store)
    assert after != before
    assert store.rollups.refresh(END_US) == 2
    require_same(levels(store), after)
    assert store.rollups.pack_rows(owns=lambda asset: asset == "other") == 0
    while store.rollups.pack_rows():
        pass
    assert {row.resolution_s for row in rows(store, RollupRow)} == {3600}
    require_same(levels(store), after)
    assert store.find_damage() is None


def test_ten_minutes_without_their_minutes_stay(store: Store) -> None:
    """As retention leaves them that is killed between the two."""
    filled(store, 3)
    settle(store)
    as_an_earlier_version_left_it(store)
    before = levels(store)
    with store._database.writing() as connection:
        early = RollupRow.time_us < START_US + HOUR_US
        connection.execute(delete(RollupRow).where(RollupRow.resolution_s == 60, early))
    while store.rollups.pack_rows():
        pass
    assert [(one.time_us, one.channel, one.good) for one in levels(store)[2]] == [
        (one.time_us, one.channel, one.good) for one in before[2]
    ]
    left = [row for row in rows(store, RollupRow) if row.resolution_s == 600]
    assert {row.time_us // HOUR_US for row in left} == {START_US // HOUR_US}


def test_seconds_are_blocks_once_the_samples_are_gone(store: Store) -> None:
    filled(store, 3)
    settle(store)

    def seconds() -> str:
        return str(store.history.read("m", None, START_US, END_US, SECOND_US, 10**6))

    before = seconds()
    retention = Retention(raw_days=0.0, second_days=30.0)
    store.samples.write([Sample("m", "c-0", END_US, 1.0, 192, 9)])
    assert store.rollups.expire(retention, END_US, 2**62) > 0
    assert store.samples.read("m", None, 0, END_US, 10) == []
    assert seconds() == before
    assert {row.resolution_s for row in rows(store, RollupRow)} == {3600}
    as_an_earlier_version_left_it(store)
    assert seconds() == before
    while store.rollups.pack_rows():
        pass
    assert seconds() == before
    assert {row.resolution_s for row in rows(store, RollupRow)} == {3600}
    expired = Retention(second_days=1.0)
    assert store.rollups.expire(expired, END_US, 2**62) == 6, "three hours of two channels"
    assert seconds() == "[]"


def damage(store: Store) -> None:
    """Change one bit of each block."""
    for row in rows(store, RollupBlockRow):
        broken = bytearray(row.data)
        broken[len(broken) // 2] ^= 1
        key = (
            RollupBlockRow.channel_id == row.channel_id,
            RollupBlockRow.resolution_s == row.resolution_s,
            RollupBlockRow.begin_us == row.begin_us,
        )
        with store._database.writing() as connection:
            connection.execute(update(RollupBlockRow).where(*key).values(data=bytes(broken)))


def test_a_damaged_block_is_named_and_its_minutes_come_from_the_samples(store: Store) -> None:
    filled(store)
    settle(store)
    before = levels(store)
    damage(store)
    assert levels(store)[0] == before[0]
    problem = store.find_damage()
    assert problem is not None
    assert "blocks of rollups are damaged: minutes or seconds of m" in problem
    # A late sample of one hour has the other hours of its block computed again.
    late = [
        Sample("m", f"c-{k}", START_US + hour * HOUR_US + 1, 99.0, 192, 9)
        for k in (0, 1)
        for hour in (1, 5, 9)
    ]
    assert store.samples.write(late).stored == 6
    after = levels(store)[0]
    settle(store)
    assert not rows(store, StaleRollupRow)
    assert store.find_damage() is None
    assert levels(store)[0] == after


def test_a_minute_takes_a_tenth_of_a_row(sqlite_store: Store) -> None:
    filled(sqlite_store, hours=12, channels=20, spread=0.1)
    settle(sqlite_store)
    sizes = [len(row.data) for row in rows(sqlite_store, RollupBlockRow)]
    assert len(sizes) == 60
    assert sum(sizes) / (20 * 12 * 60) < 6.0


VALUE = st.floats(allow_nan=False)


@given(
    st.sampled_from(sorted(SPANS_US)),
    st.dictionaries(
        st.integers(0, 239),
        st.tuples(VALUE, VALUE, VALUE, st.integers(0, 2**32 - 1), st.integers(0, 255)),
        max_size=50,
    ),
    st.booleans(),
)
def test_a_block_holds_every_bit(
    resolution_s: int,
    entries: dict[int, tuple[float, float, float, int, int]],
    is_single: bool,
) -> None:
    ordered = sorted(entries)
    columns = [[entries[at][place] for at in ordered] for place in range(5)]
    values = [np.array(column, np.float64) for column in columns[:3]]
    if is_single:
        values = [values[0], values[0].copy(), values[0].copy()]
    found = Buckets(
        START_US + np.array(ordered, np.int64) * resolution_s * SECOND_US,
        *values,
        np.array(columns[3], np.int64),
        np.array(columns[4], np.uint16),
    )
    block = pack(found, resolution_s, START_US)
    for mine, column in zip(unpack(block, resolution_s, START_US), found, strict=True):
        assert mine.dtype == column.dtype
        assert mine.tobytes() == column.tobytes()
    with pytest.raises(StoreError, match="codec 2: expected 1"):
        unpack(block._replace(codec=2), resolution_s, START_US)
    with pytest.raises(BlockDamagedError):
        unpack(block._replace(crc=block.crc ^ 1), resolution_s, START_US)


def test_a_salvaged_store_has_each_minute_once(tmp_path: Path) -> None:
    """Pages that are free hold the rows that were moved."""
    with Store.open("", tmp_path) as store:
        filled(store)
        settle(store)
        as_an_earlier_version_left_it(store)
        while store.rollups.pack_rows():
            pass
        # The samples go: nothing is computed again.
        store.samples.write([Sample("m", "c-0", END_US, 1.0, 192, 9)])
        keep = Retention(raw_days=0.0, second_days=0.0)
        assert store.rollups.expire(keep, END_US, 2**62) > 0
        before = levels(store)
        path = Path(store._database.name)
    salvaged = salvage_store(path, "a test")
    assert salvaged.rows["rollup_blocks"] == 6
    with Store.open("", tmp_path) as store:
        require_same(levels(store), before)
        assert store.find_damage() is None


def test_means_near_the_largest_number_are_joined(store: Store) -> None:
    large = 1.7e308
    store.samples.write(
        [
            Sample("m", "c", START_US + k * MINUTE_US, large * (1 if k % 2 else 0.9), 192, 9)
            for k in range(120)
        ]
    )
    settle(store)
    begin_us = START_US - 24 * HOUR_US
    for level_us in (*LEVELS_US[1:], 4 * HOUR_US):
        found = store.history.read("m", None, begin_us, END_US, level_us, 1000)
        assert sum(one.good for one in found) == 120
        mean = sum((one.mean or math.nan) / 120 * one.good for one in found)
        assert mean == pytest.approx(0.95 * large, rel=1e-12)
        assert all((one.min, one.max) == (0.9 * large, large) for one in found)


def test_the_mean_of_the_largest_numbers_and_of_tiny_ones_is_a_number(store: Store) -> None:
    largest = sys.float_info.max
    for channel, values in (
        ("large", [largest, largest, largest]),
        ("least", [-largest, -largest, -largest]),
        ("both", [largest, -largest, 3.0]),
        ("tiny", [5e-324, 5e-324, 5e-324]),
    ):
        store.samples.write(
            [
                Sample("m", channel, START_US + k * HOUR_US, value, 192, 9)
                for k, value in enumerate(values)
            ]
        )
    settle(store)
    found = store.history.read("m", None, START_US, END_US, 4 * HOUR_US, 10)
    assert {one.channel: one.mean for one in found} == {
        "large": largest, "least": -largest, "both": 1.0, "tiny": 5e-324,
    }  # fmt: skip


def test_rows_are_moved_in_short_transactions(store: Store) -> None:
    filled(store, hours=40)
    settle(store)
    as_an_earlier_version_left_it(store)
    begun_s = time.monotonic()
    assert store.rollups.pack_rows(until_s=begun_s - 1.0) == 0
    assert store.rollups._moves.size == 4, "days of one channel that the first one takes"
