import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from patience import patience

from adapters.samples import Sample
from service.store import Store, StoreUnavailableError
from service.store.opening import FILE_NAME

WRITE_FOR_EVER = """
import itertools, pathlib, sys
from adapters.samples import Sample
from service.store import Store
store = Store.open("", pathlib.Path(sys.argv[1]))
for number in itertools.count():
    # the last 50 of every batch are sent again with the next one
    times = range(max(number * 450 - 50, 0), number * 450 + 450)
    store.samples.write([Sample("a", f"c{t % 5}", t, float(t), 192, t) for t in times])
    print(times[-1], flush=True)
"""


@pytest.mark.wires
@pytest.mark.parametrize("batches_before_the_kill", [1, 7, 30])
def test_a_killed_writer_loses_nothing_that_it_acknowledged(
    tmp_path: Path, batches_before_the_kill: int
) -> None:
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITE_FOR_EVER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert writer.stdout is not None
    acknowledged = 0
    for _ in range(batches_before_the_kill):
        acknowledged = int(writer.stdout.readline())
    writer.send_signal(signal.SIGKILL)
    rest, _ = writer.communicate(timeout=patience(180))
    acknowledged = int(rest.split()[-1]) if rest.split() else acknowledged

    with Store.open("", tmp_path) as store:
        with store._database.reading() as connection:
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
        samples = store.samples.read("a", None, 0, 2**62, 10**7)
        times = [sample.time_us for sample in samples]
        assert times == list(range(len(times)))  # whole batches, in order, no time twice
        assert len(times) % 450 == 0
        assert times[-1] >= acknowledged
        again = [Sample("a", f"c{t % 5}", t, float(t), 192, t) for t in times]
        assert store.samples.write(again) == (0, len(times))


def test_readers_see_whole_batches_while_a_writer_writes(store: Store) -> None:
    batches, size = 30, 100
    stop = threading.Event()

    def read() -> int:
        rounds = 0
        while True:
            last = stop.is_set()
            samples = store.samples.read("a", None, 0, 2**62, 10**6)
            assert len(samples) % size == 0
            assert [s.time_us for s in samples] == list(range(len(samples)))
            store.samples.latest("a")
            rounds += 1
            if last:
                return rounds

    with ThreadPoolExecutor(4) as pool:
        readers = [pool.submit(read) for _ in range(3)]
        for number in range(batches):
            times = range(number * size, (number + 1) * size)
            store.samples.write([Sample("a", f"c{t % 3}", t, 1.0, 192, t) for t in times])
            store.states.save("a", {"number": number})
        stop.set()
        assert all(reader.result(timeout=patience(180)) > 0 for reader in readers)
    assert store.states.load("a") == {"number": batches - 1}
    assert len(store.samples.read("a", None, 0, 2**62, 10**6)) == batches * size


def test_writers_of_one_process_and_of_another_take_turns(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store, Store.open("", tmp_path) as other:

        def write(number: int) -> int:
            writer = (store, other)[number % 2]
            return writer.samples.write(
                [Sample("a", f"c{number}", t, 1.0, 192, t) for t in range(50)]
            ).stored

        with ThreadPoolExecutor(8) as pool:
            assert list(pool.map(write, range(40))) == [50] * 40
        assert len(store.samples.channels("a")) == 40
        assert len(other.samples.read("a", None, 0, 99, 10**5)) == 2000


def test_two_programs_that_read_before_they_write_do_not_trip_each_other(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store, Store.open("", tmp_path) as other:

        def add(number: int) -> int:
            writer = (store, other)[number % 2]
            return writer.models.add("a", "candidate", "", {}, number)

        with ThreadPoolExecutor(8) as pool:
            assert sorted(pool.map(add, range(40))) == list(range(1, 41))


def test_a_store_locked_by_another_program_says_so_in_time_and_comes_back(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        store.samples.write([Sample("a", "x", 1, 1.0, 192, 0)])
        intruder = sqlite3.connect(tmp_path / FILE_NAME, isolation_level=None)
        intruder.execute("BEGIN EXCLUSIVE")
        started = time.monotonic()
        with pytest.raises(StoreUnavailableError, match=r"bearing-twin.db: database is locked"):
            store.samples.write([Sample("a", "y", 2, 1.0, 192, 0)], patience_s=0.3)
        assert time.monotonic() - started > 0.2
        assert len(store.samples.read("a", None, 0, 9, 9)) == 1  # readers go on
        intruder.rollback()
        intruder.close()
        assert store.samples.write([Sample("a", "y", 2, 1.0, 192, 0)]) == (1, 0)


def test_a_short_write_waits_for_a_long_one(store: Store) -> None:
    inside, go_on = threading.Event(), threading.Event()

    def long_write() -> None:
        with store._database.writing():
            inside.set()
            go_on.wait(30.0)

    thread = threading.Thread(target=long_write)
    thread.start()
    inside.wait()
    with pytest.raises(StoreUnavailableError, match="busy with another write"):
        store.samples.write([Sample("a", "x", 1, 1.0, 192, 0)], patience_s=0.05)
    threading.Timer(0.5, go_on.set).start()
    store.states.save("a", {})
    thread.join()
    assert store.states.load("a") == {}


def test_a_full_disk_is_a_state_of_the_store_and_passes(sqlite_store: Store) -> None:
    samples = [Sample("a", "x", t, 1.0, 192, 0) for t in range(50_000)]

    def limit_pages(pages: int) -> None:
        with sqlite_store._database.writing() as connection:
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")

    limit_pages(40)
    with pytest.raises(StoreUnavailableError, match="full"):
        sqlite_store.samples.write(samples)
    assert sqlite_store.samples.read("a", None, 0, 2**62, 10) == []
    limit_pages(2**30)
    assert sqlite_store.samples.write(samples) == (50_000, 0)
