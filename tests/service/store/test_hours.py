"""Hours of many channels: condensed and packed in portions, next to those who write."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import patience
from processes import wait_until
from sqlalchemy import event, select

from adapters.samples import Sample
from service.clock import HOUR_US, MINUTE_US
from service.store import Store, StoreUnavailableError, buckets, hours, packed
from service.store.blocks import ChannelSamples
from service.store.tables import (
    PackedHourRow,
    RollupBlockRow,
    RollupRow,
    SampleRow,
    StaleRollupRow,
)

START_US = 1_790_000_000_000_000 // HOUR_US * HOUR_US
SECOND_US = 1_000_000
END_US = START_US + 10 * HOUR_US
PATIENCE_S = 60.0


def filled(store: Store, assets: int, per_hour: int = 60, channels: int = 3, first: int = 0) -> int:
    """An hour of some assets, each channel with values of its own."""
    step_us = HOUR_US // per_hour
    batch = [
        Sample(
            f"m-{asset}", f"c-{channel}", START_US + k * step_us, value(asset, channel, k), 192, 9
        )
        for asset in range(first, first + assets)
        for channel in range(channels)
        for k in range(per_hour)
    ]
    return store.samples.write(batch).stored


def value(asset: int, channel: int, k: int) -> float:
    return asset + channel / 4 + (k % 7) / 8  # exact, and so are their sums


@contextmanager
def counted_turns(store: Store) -> Iterator[list[int]]:
    """Counts the transactions that write."""
    turns: list[int] = []
    engine = store._database._writer

    def begun(connection: Any) -> None:
        if connection.get_execution_options().get("bearing_twin_writes"):
            turns.append(1)

    event.listen(engine, "begin", begun)
    yield turns
    event.remove(engine, "begin", begun)


def rows(store: Store, row: Any) -> list[Any]:
    with store._database.reading() as connection:
        return list(connection.execute(select(row.__table__)).all())


def everything(store: Store, assets: int) -> list[Any]:
    """All samples and minutes that are read, of all assets."""
    found: list[Any] = []
    for asset in range(assets):
        name = f"m-{asset}"
        found += store.samples.read(name, None, 0, 2**62, 100_000)
        found += store.history.read(name, None, 0, END_US, MINUTE_US, 100_000)
        found += store.history.read(name, None, 0, END_US, HOUR_US, 100_000)
    return found


def test_hundreds_of_channels_are_one_transaction(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hours, "_TURN_S", 60.0)  # however slow the machine is
    filled(store, assets=100)
    before = everything(store, 100)
    with counted_turns(store) as turns:
        assert store.rollups.refresh(END_US) == 300
        assert len(turns) == 3, "of 64, 128 and 108 channels"
        assert store.packing.pack(END_US) == 300
        assert len(turns) == 6
    assert not rows(store, SampleRow)
    assert not rows(store, StaleRollupRow)
    assert len(rows(store, RollupRow)) == len(rows(store, RollupBlockRow)) == 300
    assert str(everything(store, 100)) == str(before)


def test_a_transaction_that_takes_long_is_followed_by_smaller_ones(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hours, "_TURN_S", 0.0)
    filled(store, assets=24)
    with counted_turns(store) as turns:
        assert store.rollups.refresh(END_US) == 72
    assert len(turns) == 1 + 72 - 64, "then channel by channel"
    with counted_turns(store) as turns:
        assert store.packing.pack(END_US) == 72
    assert len(turns) == 1 + 72 - 63, "whole assets while they fit"


@pytest.mark.parametrize("samples_max", [50, 100, 1000])
def test_channels_with_many_samples_come_one_by_one(
    store: Store, monkeypatch: pytest.MonkeyPatch, samples_max: int
) -> None:
    filled(store, assets=4, per_hour=100)
    before = everything(store, 4)
    monkeypatch.setattr(hours, "_SAMPLES_MAX", samples_max)
    with counted_turns(store) as turns:
        assert store.rollups.refresh(END_US) == 12
        assert store.packing.pack(END_US) == 12
    assert len(turns) == (4 if samples_max == 1000 else 24)
    assert not rows(store, SampleRow)
    assert [str(one) for one in everything(store, 4)] == [str(one) for one in before]


def test_a_cell_condenses_and_packs_what_it_owns(store: Store) -> None:
    filled(store, assets=4)
    ours: Callable[[str], bool] = {"m-1", "m-3"}.__contains__
    assert store.rollups.refresh(END_US, ours) == 6
    assert store.rollups.refresh(END_US, ours) == 0
    assert store.packing.pack(END_US, owns=ours) == 6
    assert store.packing.pack(END_US, owns=ours) == 0
    assert len(rows(store, PackedHourRow)) == 6
    assert store.packing.pack(END_US) == 0, "the rollups of the others are not computed"
    assert store.rollups.refresh(END_US) == 6
    assert store.packing.pack(END_US) == 6


def test_a_mean_of_values_whose_sum_is_too_large_is_right() -> None:
    times_us = np.arange(4) * MINUTE_US
    large = np.array([1.7e308, 1.6e308, 1.0, 2.0])
    samples = ChannelSamples(times_us, large, np.full(4, 192, np.uint16), times_us)
    found = buckets.statistics(samples, 2 * MINUTE_US)
    assert found.buckets.means.tolist() == [pytest.approx(1.65e308), 1.5]


def other_of(store: Store) -> Store:
    """The same database, as another program has it."""
    url = str(store._database.engine.url.render_as_string(hide_password=False))
    return Store.open(url.replace("+psycopg", ""), Path())


@pytest.fixture
def two(postgresql: Any, tmp_path: Path) -> Iterator[tuple[Store, Store]]:
    """Two programs with one database."""
    with Store.open(postgresql.database(), tmp_path) as store, other_of(store) as other:
        yield store, other


@contextmanager
def held(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> Iterator[threading.Event]:
    """Hold a call of a function until the event is set; the context begins when it is called."""
    go, called = threading.Event(), threading.Event()
    real = getattr(owner, name)

    def waiting(*arguments: Any) -> Any:
        result = real(*arguments)
        called.set()
        assert go.wait(PATIENCE_S)
        return result

    monkeypatch.setattr(owner, name, waiting)
    go.called = called  # type: ignore[attr-defined]
    yield go
    go.set()


def test_who_writes_one_channel_does_not_wait_for_who_packs_another(
    two: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, other = two
    filled(store, assets=2)
    store.rollups.refresh(END_US)
    with ThreadPoolExecutor(1) as pool, held(monkeypatch, packed, "add") as go:
        packing = pool.submit(store.packing.pack, END_US, owns={"m-0"}.__contains__)
        assert go.called.wait(PATIENCE_S)  # type: ignore[attr-defined]
        late = Sample("m-1", "c-0", START_US + 7, 1.0, 192, 0)
        assert other.samples.write([late], patience_s=2.0) == (1, 0)
        with pytest.raises(StoreUnavailableError), other._database.writing(0.2):
            pass  # all others take turns with both
        same = Sample("m-0", "c-0", START_US + 7, 1.0, 192, 0)
        with pytest.raises(StoreUnavailableError):
            other.samples.write([same], patience_s=0.2)
        go.set()
        assert packing.result(PATIENCE_S) == 3
        # A new channel takes the turn of all.
        assert other.samples.write([same, Sample("new", "c", 1, 1.0, 192, 0)]) == (2, 0)


def test_a_sample_that_comes_while_its_hour_is_packed_is_neither_lost_nor_twice(
    two: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, other = two
    filled(store, assets=1, channels=1)
    store.rollups.refresh(END_US)
    late = Sample("m-0", "c-0", START_US + 7, 99.0, 192, 0)
    again = Sample("m-0", "c-0", START_US, 5.0, 192, 0)
    assert other.samples.write([again]) == (0, 1)
    store.rollups.refresh(END_US)
    with ThreadPoolExecutor(2) as pool, held(monkeypatch, packed, "add") as go:
        packing = pool.submit(store.packing.pack, END_US)
        assert go.called.wait(PATIENCE_S)  # type: ignore[attr-defined]
        writing = pool.submit(other.samples.write, [late, again])
        waits_for_a_lock(store)
        assert not writing.done()
        go.set()
        assert packing.result(PATIENCE_S) == 1
        assert writing.result(PATIENCE_S) == (1, 1)
    found = store.samples.read("m-0", None, 0, 2**62, 1000)
    assert len(found) == 61
    [hour] = store.history.read("m-0", None, 0, END_US, HOUR_US, 9)
    assert (hour.good, hour.max) == (61, 99.0)
    settle(store)
    [hour] = store.history.read("m-0", None, 0, END_US, HOUR_US, 9)
    assert (hour.good, hour.max) == (61, 99.0)


def test_an_hour_that_is_written_to_is_condensed_afterwards(
    two: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its rollups would be those without the sample, and the note would be gone."""
    store, other = two
    filled(store, assets=1, channels=1)
    late = Sample("m-0", "c-0", START_US + 7, 99.0, 192, 0)
    dialect = store._database.dialect
    real, go, called = dialect.upsert_samples, threading.Event(), threading.Event()

    def waiting(*arguments: Any) -> int:
        called.set()
        assert go.wait(PATIENCE_S)
        return real(*arguments)

    object.__setattr__(other._database.dialect, "upsert_samples", waiting)
    with ThreadPoolExecutor(1) as pool:
        writing: Future[Any] = pool.submit(other.samples.write, [late])
        assert called.wait(PATIENCE_S)
        assert store.rollups.refresh(END_US) == 0, "left to the next look"
        go.set()
        assert writing.result(PATIENCE_S) == (1, 0)
    assert store.rollups.refresh(END_US) == 1
    [hour] = store.history.read("m-0", None, 0, END_US, HOUR_US, 9)
    assert (hour.good, hour.max) == (61, 99.0)


def waits_for_a_lock(store: Store) -> None:
    query = "SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'"

    def waits() -> bool:
        with store._database.reading() as connection:
            return bool(connection.exec_driver_sql(query).scalar())

    wait_until(waits, PATIENCE_S, "the writer waits", 0.01)


def settle(store: Store) -> None:
    while store.rollups.refresh(END_US) or store.packing.pack(END_US):
        pass


@pytest.mark.timeout(120)
def test_what_several_programs_write_while_two_pack_is_what_one_would_have_written(
    two: tuple[Store, Store], tmp_path: Path
) -> None:
    store, other = two
    rng = np.random.default_rng(5)
    batches = [
        [
            Sample(f"m-{asset}", f"c-{channel}", START_US + int(at) * SECOND_US, float(at), 192, 0)
            for at in rng.integers(0, 2 * 3600, 40)
        ]
        for asset in range(2)
        for channel in range(3)
        for _ in range(12)
    ]
    ended = threading.Event()

    def write(to: Store, mine: list[list[Sample]]) -> int:
        return sum(to.samples.write(batch).stored for batch in mine)

    def keep(one: Store) -> None:
        while not ended.is_set():
            one.rollups.refresh(END_US)
            one.packing.pack(END_US)

    with ThreadPoolExecutor(4) as pool:
        keeping = [pool.submit(keep, one) for one in two]
        order = rng.permutation(len(batches))
        halves = [[batches[k] for k in order[number::2]] for number in range(2)]
        writing = [pool.submit(write, to, mine) for to, mine in zip(two, halves, strict=True)]
        stored = sum(one.result(PATIENCE_S) for one in writing)
        ended.set()
        for one in keeping:
            one.result(PATIENCE_S)
    with Store.open("", tmp_path / "alone") as alone:
        assert sum(alone.samples.write(batch).stored for batch in batches) == stored
        assert str(everything(store, 2)) == str(everything(alone, 2))
        settle(other)
        assert str(everything(store, 2)) == str(everything(alone, 2))


PACK_FOR_EVER = """
import pathlib, sys
from service.store import Store
store = Store.open(sys.argv[1], pathlib.Path(sys.argv[2]))
store.rollups._portions.size = store.packing._portions.size = 8
print("begins", flush=True)
while store.rollups.refresh(2**62 // 2) or store.packing.pack(2**62 // 2):
    pass
print("done", flush=True)
"""


@pytest.mark.wires
@pytest.mark.timeout(180)
def test_who_is_killed_while_it_condenses_and_packs_loses_nothing(
    store: Store, tmp_path: Path
) -> None:
    filled(store, assets=60, per_hour=360)
    before = everything(store, 60)
    url = str(store._database.engine.url.render_as_string(hide_password=False))
    arguments = [url.replace("+psycopg", ""), str(tmp_path)]
    cut = 0
    for delay_s in (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5):
        worker = subprocess.Popen(
            [sys.executable, "-c", PACK_FOR_EVER, *arguments], stdout=subprocess.PIPE, text=True
        )
        assert worker.stdout is not None
        assert worker.stdout.readline() == "begins\n"
        time.sleep(delay_s)
        worker.send_signal(signal.SIGKILL)
        rest, _ = worker.communicate(timeout=patience(60))
        total = sum(row.sample_count for row in rows(store, PackedHourRow))
        in_table = len(rows(store, SampleRow))
        assert in_table + total == 60 * 3 * 360
        cut += 0 < total < 60 * 3 * 360 or bool(rows(store, RollupRow))
        if "done" in rest:
            break
    assert cut, "it was killed in the middle"
    settle(store)
    assert len(rows(store, PackedHourRow)) == 180
    assert store.find_damage() is None
    after = everything(store, 60)
    assert [str(one) for one in after] == [str(one) for one in before]
