"""Hours that are over are packed: everything that is read and written stays the same."""

import math
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sqlalchemy import select, text

from adapters.samples import Sample
from service.clock import HOUR_US, MINUTE_US
from service.store import Retention, Store, StoreError
from service.store.blocks import UNKNOWN_US, BlockDamagedError, ChannelSamples, pack, unpack
from service.store.packed import hours_of
from service.store.salvage import salvage_store
from service.store.tables import SampleBlockRow, SampleRow

NAN = float("nan")
START_US = 1_790_000_000_000_000 // HOUR_US * HOUR_US
SECOND_US = 1_000_000
#: SQLite stores minus nought as nought, packed or not.
VALUES = st.one_of(st.floats(-1e6, 1e6).map(lambda value: value + 0.0), st.just(NAN))
TIMES = st.builds(
    lambda hour, second, us: START_US + hour * HOUR_US + second * SECOND_US + us,
    st.integers(0, 2),
    st.sampled_from([0, 1, 59, 60, 61, 1800, 3598, 3599]),
    st.sampled_from([0, 1, 999_999]),
)
BATCHES = st.lists(
    st.tuples(
        st.sampled_from(["a", "b"]), TIMES, VALUES, st.sampled_from([0, 24, 64, 192, 216]),
        st.one_of(TIMES, st.integers(0, 2**62)),
    ),
    min_size=1,
    max_size=12,
)  # fmt: skip


def packed(store: Store, before_us: int = START_US + 10 * HOUR_US) -> int:
    while store.rollups.refresh(before_us):
        pass
    done = 0
    while count := store.packing.pack(before_us):
        done += count
    return done


def polled(
    store: Store,
    seconds: int = 3600,
    channels: int = 8,
    start_us: int = START_US,
    seed: int = 1,
    sent: str = "",
) -> int:
    """What a poll once a second of transmitters with steps of 0.1 °C brings.

    A driver of the service receives it at its time; a gateway sends it on, see `received`.
    """
    rng = np.random.default_rng(seed)
    times_us = start_us + SECOND_US * np.arange(seconds) + rng.integers(0, 3000, seconds)
    received_us = received(times_us, sent).tolist() if sent else times_us.tolist()
    walks = np.round(50 + np.cumsum(rng.normal(0, 0.05, (channels, seconds)), axis=1), 1)
    batch = [
        Sample("bench-1", f"t_{channel}", time_us, value, 192, got_us)
        for channel, values in enumerate(walks.tolist())
        for time_us, value, got_us in zip(times_us.tolist(), values, received_us, strict=True)
    ]
    return store.samples.write(batch).stored


def received(times_us: NDArray[np.int64], sent: str) -> NDArray[np.int64]:
    """When the service receives samples that are sent one by one, or ten at once."""
    rng = np.random.default_rng(7)
    latencies_us = (30_000 * np.exp(rng.normal(0, 0.5, times_us.size))).astype(np.int64)
    numbers = np.arange(times_us.size)
    if sent == "ten at once":
        numbers = np.minimum(numbers // 10 * 10 + 9, times_us.size - 1)
    return np.maximum.accumulate(times_us + latencies_us)[numbers]


def in_table(store: Store) -> int:
    with store._database.reading() as connection:
        return len(connection.execute(select(SampleRow.time_us)).all())


def blocks(store: Store) -> list[bytes]:
    with store._database.reading() as connection:
        return list(connection.scalars(select(SampleBlockRow.data)))


@pytest.fixture(scope="module")
def plain_store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    """In which nothing is ever packed."""
    with Store.open("", tmp_path_factory.mktemp("plain")) as store:
        yield store


@settings(deadline=None, max_examples=30)
@given(
    steps=st.lists(st.one_of(BATCHES, st.integers(1, 4)), min_size=2, max_size=8),
    start_us=TIMES,
    end_us=TIMES,
    limit=st.integers(1, 12),
)
def test_a_packed_store_reads_and_counts_as_one_that_is_not(
    shared_store: Store,
    plain_store: Store,
    steps: list[Any],
    start_us: int,
    end_us: int,
    limit: int,
) -> None:
    asset = uuid.uuid4().hex
    for step in steps:
        if isinstance(step, int):
            packed(shared_store, START_US + step * HOUR_US)
            continue
        batch = [
            Sample(asset, name, time_us, value, quality, received_us)
            for name, time_us, value, quality, received_us in step
        ]
        assert shared_store.samples.write(batch) == plain_store.samples.write(batch)
    packed(shared_store)

    def same(read: Any) -> None:
        assert bits(read(shared_store)) == bits(read(plain_store))

    same(lambda store: store.samples.read(asset, None, 0, 2**62, 1000))
    same(lambda store: store.samples.read(asset, None, start_us, end_us, limit))
    same(lambda store: store.samples.read(asset, ["a"], 0, 2**62, limit, (start_us, "b")))
    same(lambda store: store.samples.span(asset, None, start_us, end_us, 1000))
    same(lambda store: store.samples.latest(asset))
    same(lambda store: store.samples.first_time_us(asset))
    same(lambda store: [n for (a, _), n in store.samples.counts(1000).items() if a == asset])
    same(lambda store: [t for (a, _), t in store.samples.open_ends().items() if a == asset])
    for bucket_us in (SECOND_US, 7 * SECOND_US, MINUTE_US, HOUR_US):
        rollups = [
            store.history.read(asset, None, start_us, end_us, bucket_us, 1000)
            for store in (shared_store, plain_store)
        ]
        assert len(rollups[0]) == len(rollups[1])
        for mine, other in zip(*rollups, strict=True):
            assert (mine.channel, mine.time_us, mine.min, mine.max, mine.good, mine.quality) == (
                other.channel, other.time_us, other.min, other.max, other.good, other.quality
            )  # fmt: skip
            if mine.good:
                assert mine.mean == pytest.approx(other.mean, rel=1e-9, abs=1e-6)


def bits(found: Any) -> str:
    return repr(found)


@pytest.mark.parametrize("offset_us", [0, -MINUTE_US // 2])
def test_minutes_that_reach_over_the_end_of_an_hour_are_one(
    store: Store, plain_store: Store, offset_us: int
) -> None:
    for one in (store, plain_store):
        polled(one, seconds=7300, channels=2)
    assert packed(store, START_US + HOUR_US) == 2
    span = (START_US, START_US + 3 * HOUR_US)
    tables = [
        one.history.minute_averages("bench-1", ["t_0", "t_1"], *span, offset_us=offset_us)
        for one in (store, plain_store)
    ]
    assert tables[0].minute_us.tolist() == tables[1].minute_us.tolist()
    for name in ("t_0", "t_1"):
        np.testing.assert_allclose(tables[0].mean[name], tables[1].mean[name], rtol=1e-14)
        assert tables[0].good_count[name].tolist() == tables[1].good_count[name].tolist()


@pytest.mark.parametrize("sent", ["", "one by one", "ten at once"])
def test_what_one_poll_brought_takes_less_than_two_and_a_half_bytes_a_sample(
    sqlite_store: Store, sent: str
) -> None:
    store = sqlite_store
    count = polled(store, sent=sent)
    assert packed(store) == 8
    assert in_table(store) == 0
    assert len(blocks(store)) == 1, "one column of times for all"
    assert sum(map(len, blocks(store))) / count < 2.5


@pytest.mark.parametrize("sent", ["one by one", "ten at once"])
def test_a_channel_of_its_own_times_takes_less_than_seven_bytes_a_sample(
    sqlite_store: Store, sent: str
) -> None:
    store = sqlite_store
    rng = np.random.default_rng(4)
    times_us = START_US + np.sort(rng.integers(0, HOUR_US, 600))
    values = 2650 + np.cumsum(rng.normal(0, 0.5, 600)).round(2)
    store.samples.write(
        [
            Sample("bench-1", "load_n", time_us, value, 192, received_us)
            for time_us, value, received_us in zip(
                times_us.tolist(), values.tolist(), received(times_us, sent).tolist(), strict=True
            )
        ]
    )
    packed(store)
    assert sum(map(len, blocks(store))) / 600 < 7


def test_an_hour_that_is_not_over_or_not_computed_stays_as_it_is(store: Store) -> None:
    polled(store, seconds=60)
    assert store.packing.pack(START_US + 2 * HOUR_US) == 0, "its rollups are not computed"
    assert packed(store, START_US + HOUR_US - 1) == 0
    assert packed(store, START_US + HOUR_US) == 8


def test_what_is_sent_again_leaves_an_hour_packed(store: Store) -> None:
    count = polled(store, seconds=100)
    packed(store)
    rows = store.samples.read("bench-1", None, 0, 2**62, 10_000)
    again = [Sample(*("bench-1", *row[:4], START_US + 9)) for row in rows]
    assert store.samples.write(again) == (0, count)
    assert in_table(store) == 0
    # One that is new changes the hour of its channel, and of no other.
    late = Sample("bench-1", "t_3", START_US + 7, 1.0, 192, 0)
    assert store.samples.write([late, *again]) == (1, count)
    assert in_table(store) == 0
    assert len(blocks(store)) == 2, "it has times of its own"
    assert store.rollups.refresh(START_US + HOUR_US) == 1
    [hour] = store.history.read("bench-1", ["t_3"], 0, START_US + HOUR_US, HOUR_US, 9)
    assert (hour.good, hour.min) == (101, 1.0)
    # What was sent again has changed no received time.
    found = store.samples.read("bench-1", None, 0, 2**62, 10_000)
    assert sorted(found) == sorted([*rows, late[1:]])


def test_a_poll_that_comes_late_stays_in_one_block(store: Store) -> None:
    polled(store, seconds=100)
    packed(store)
    late = [Sample("bench-1", f"t_{k}", START_US + 7, 1.0 + k, 192, 0) for k in range(8)]
    assert store.samples.write(late[:8]) == (8, 0)
    assert len(blocks(store)) == 1
    # A bad value that is mended, in one batch and in two.
    worse = [Sample("bench-1", "t_1", START_US + at, NAN, 0, 0) for at in (8, 9)]
    good = [Sample("bench-1", "t_1", START_US + at, 5.0, 192, 0) for at in (8, 9)]
    assert store.samples.write([worse[0], good[0], worse[1], good[0]]) == (3, 1)
    assert store.samples.write([good[1], good[0], worse[1]]) == (1, 2)
    found = store.samples.read("bench-1", ["t_1"], START_US + 7, START_US + 10, 9)
    assert [row.value for row in found] == [2.0, 5.0, 5.0]
    assert in_table(store) == 0
    assert len(blocks(store)) == 2
    assert store.find_damage() is None


@pytest.mark.parametrize("keeps_seconds", [True, False])
def test_retention_removes_packed_hours_as_it_removes_others(
    store: Store, tmp_path: Path, keeps_seconds: bool
) -> None:
    retention = Retention(raw_days=1 / 24, second_days=30.0 if keeps_seconds else 0.0)

    def after_expiry(one: Store, pack_first: bool) -> tuple[Any, ...]:
        for hour in range(4):
            polled(one, 90, 3, START_US + hour * HOUR_US, seed=hour)
        if pack_first:
            assert packed(one, START_US + 3 * HOUR_US) == 9
        removed = one.rollups.expire(retention, START_US + 4 * HOUR_US)
        left = one.samples.read("bench-1", None, 0, 2**62, 10_000)
        seconds = one.history.read("bench-1", None, 0, START_US + 9 * HOUR_US, SECOND_US, 10_000)
        return removed, left, [(s.channel, s.time_us, s.min, s.max, s.good) for s in seconds]

    with Store.open("", tmp_path / "plain") as plain:
        expected = after_expiry(plain, pack_first=False)
    assert after_expiry(store, pack_first=True) == expected
    assert expected[0] == 2 * 90 * 3


def damaged_block(store: Store, *, newest: bool = False) -> None:
    """Change one bit of the oldest block, or of the newest."""
    order = SampleBlockRow.id.desc() if newest else SampleBlockRow.id
    with store._database.writing() as connection:
        number, data = connection.execute(
            select(SampleBlockRow.id, SampleBlockRow.data).order_by(order).limit(1)
        ).one()
        broken = bytearray(data)
        broken[len(broken) // 2] ^= 1
        connection.execute(
            text("UPDATE sample_blocks SET data = :data WHERE id = :number"),
            {"data": bytes(broken), "number": number},
        )


def test_a_damaged_block_costs_only_itself(store: Store) -> None:
    for hour in range(3):
        polled(store, 100, 2, START_US + hour * HOUR_US)
    packed(store)
    assert store.packing.find_damage() is None
    damaged_block(store)
    rows = store.samples.read("bench-1", None, 0, 2**62, 10_000)
    assert len(rows) == 400
    assert min(row.time_us for row in rows) > START_US + HOUR_US
    problem = store.find_damage()
    assert problem is not None
    assert "blocks of samples are damaged: 200 samples of bench-1" in problem
    # It gets samples again.
    assert polled(store, 50, 2) == 100
    assert in_table(store) == 0
    assert len(store.samples.read("bench-1", None, 0, 2**62, 10_000)) == 500
    assert store.find_damage() is None


def test_a_damaged_newest_block_leaves_the_samples_before_it(store: Store) -> None:
    for hour in range(3):
        polled(store, 100, 1, START_US + hour * HOUR_US)
        packed(store)
    damaged_block(store, newest=True)
    newest = store.samples.latest("bench-1")["t_0"]
    assert START_US + HOUR_US < newest.time_us < START_US + 2 * HOUR_US
    # As does one that is another hour's.
    with store._database.writing() as connection:
        connection.execute(
            text("UPDATE packed_hours SET block_id = 1 WHERE hour_us = :hour"),
            {"hour": START_US + HOUR_US},
        )
    assert store.samples.latest("bench-1")["t_0"].time_us < START_US + HOUR_US
    assert len(store.samples.read("bench-1", None, 0, 2**62, 1000)) == 100


def test_what_another_program_condensed_is_condensed_again(store: Store) -> None:
    """As an import does next to the service: each has its own memory."""
    url = str(store._database.engine.url.render_as_string(hide_password=False))
    with Store.open(url.replace("+psycopg", ""), Path()) as other:
        batch = [Sample("a", "x", START_US + k * SECOND_US, 1.0, 192, 0) for k in range(200)]
        assert other.samples.write(batch[:100]) == (100, 0)
        assert packed(store) == 1
        assert other.samples.write(batch[100:]) == (100, 0)
        assert packed(store) == 0, "it is"
        (hour,) = store.history.read("a", None, 0, START_US + 2 * HOUR_US, HOUR_US, 10)
    assert hour.good == 200


def test_an_hour_whose_block_is_gone_is_one_without_samples(store: Store) -> None:
    polled(store, 100, 1)
    packed(store)
    with store._database.writing() as connection:
        connection.execute(text("DELETE FROM sample_blocks"))
    assert store.samples.read("bench-1", None, 0, 2**62, 10) == []
    assert store.samples.latest("bench-1") == {}
    problem = store.find_damage()
    assert problem is not None
    assert "100 samples of bench-1" in problem
    assert polled(store, 100, 1) == 100


def test_salvage_brings_packed_hours_over_and_no_row_twice(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        for hour in range(3):
            polled(store, 100, 2, START_US + hour * HOUR_US)
        packed(store)
        damaged_block(store)
        with store._database.writing() as connection:
            path = Path(store._database.name)
            hours = [START_US + hour * HOUR_US for hour in range(4)]
            assert len(hours_of(connection, [(c, h) for c in (1, 2, 3) for h in hours])) == 6
    # The pages that the rows were on before are free, and still hold them.
    salvaged = salvage_store(path, "a test")
    assert salvaged.rows["sample_blocks"] == 2
    with Store.open("", tmp_path) as store:
        assert store.find_damage() is None
        rows = store.samples.read("bench-1", None, START_US + HOUR_US, 2**62, 10_000)
        assert len(rows) == 400
        assert len({(row.channel, row.time_us) for row in rows}) == 400


#: Any, or one that nobody knows.
RECEIVED = st.one_of(st.just(UNKNOWN_US), st.integers(0, 2**63 - 1))


@given(
    st.lists(
        st.tuples(st.integers(0, 2**63 - 1), st.floats(), st.integers(0, 255), RECEIVED),
        min_size=1, max_size=50, unique_by=lambda row: row[0],
    ),
    st.integers(-1, 10**6),
)  # fmt: skip
@example([(0, 1.0, 192, 2**63 - 1), (2**63 - 1, 1.0, 192, 0)], -1)
def test_a_block_holds_every_bit(rows: list[tuple[int, float, int, int]], step_us: int) -> None:
    times_us, values, qualities, received_us = zip(
        *sorted(rows, key=lambda row: row[0]), strict=True
    )
    samples = ChannelSamples(
        np.array(times_us, np.int64),
        np.array(values),
        np.array(qualities, np.uint16),
        np.array(received_us, np.int64),
    )
    other = samples._replace(values=-samples.values)
    unknown = samples._replace(received_us=np.full(len(rows), UNKNOWN_US))
    step = samples._replace(received_us=np.full(len(rows), step_us + 1))
    channels = [samples, unknown, other, step]
    block = pack(channels)
    for position, expected in enumerate(channels):
        found = unpack(block, position)
        for mine, column in zip(found, expected, strict=True):
            assert mine.dtype == column.dtype
            assert mine.tobytes() == column.tobytes()


def test_salvage_joins_rows_and_a_block_of_one_hour(tmp_path: Path) -> None:
    """As a log of writes may hold both: what the hour was before it got another sample."""
    with Store.open("", tmp_path) as store:
        polled(store, 100, 1)
        packed(store)
        path = Path(store._database.name)
        with store._database.writing() as connection:
            connection.execute(
                text("INSERT INTO samples VALUES (1, :time_us, 7.0, 192, NULL)"),
                {"time_us": START_US + 5},
            )
    salvaged = salvage_store(path, "a test")
    assert (salvaged.rows["samples"], salvaged.rows["packed_hours"]) == (101, 0)
    assert salvaged.rows["sample_blocks"] == 0


def test_a_block_of_a_later_version_says_so() -> None:
    samples = ChannelSamples(
        np.array([1]), np.array([math.pi]), np.array([192], np.uint16), np.array([1])
    )
    with pytest.raises(StoreError, match="codec 2: expected 1"):
        unpack(pack([samples])._replace(codec=2), 0)
    with pytest.raises(BlockDamagedError, match="1 channels"):
        unpack(pack([samples]), 1)
    with pytest.raises(ValueError, match="the same times"):
        pack([samples, samples._replace(times_us=np.array([2]))])
