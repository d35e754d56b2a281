import contextlib
import math
import random
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.samples import Quality, Sample
from service.domain.channels import importance
from service.ingest.spool import FILE_NAME, Spool
from service.store import QueueUnavailableError, StoreError


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    spool = Spool.open(tmp_path, 16)
    yield spool
    spool.close()


def sample(time_us: int, value: float = 1.0, channel: str = "t_inner_ring_c") -> Sample:
    quality = Quality.GOOD if math.isfinite(value) else Quality.SENSOR_FAILURE
    return Sample("a", channel, time_us, value, quality, time_us + 7)


def test_samples_come_out_whole_in_the_order_they_went_in(spool: Spool) -> None:
    sent = [sample(9), sample(3, math.nan), sample(5, -1e300, "load_n"), sample(3, 2.0)]
    spool.append(sent[:3])
    spool.append(sent[3:])
    assert len(spool) == 4
    assert spool.oldest_received_us() == 16
    chunk = spool.first(3)
    assert chunk is not None
    plain = [(*one[:3], str(one.value), int(one.quality), one.received_us) for one in sent]
    assert [(*one[:3], str(one.value), *one[4:]) for one in chunk.samples] == plain[:3]
    assert len(spool) == 4, "reading removes nothing"
    spool.remove(chunk)
    rest = spool.first(99)
    assert rest is not None
    assert rest.samples == sent[3:]
    spool.append([sample(11)])
    spool.remove(rest)
    last = spool.first(99)
    assert last is not None
    assert last.samples == [sample(11)], "what came meanwhile stays"
    spool.remove(last)
    assert spool.first(1) is None
    assert spool.oldest_received_us() is None
    assert len(spool) == 0


def test_the_next_run_finds_what_was_left(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path, 16)
    spool.append([sample(1), sample(2, math.nan), sample(1, channel="x")])
    spool.close()
    again = Spool.open(tmp_path, 16)
    assert len(again) == 3
    assert again.newest() == {("a", "t_inner_ring_c"): None, ("a", "x"): 1}
    again.close()


def test_a_full_spool_gives_up_the_oldest_of_the_least_important(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path, 1)
    channels = ["t_inner_ring_c", "speed_rpm", "t_node_7_c.twin"]
    sent = given_up = 0
    for start in range(0, 45_000, 500):
        batch = [sample(start + k, channel=channels[k % 3]) for k in range(500)]
        given_up += spool.append(batch)
        sent += len(batch)
        assert len(spool) == sent - given_up
    assert given_up > 0
    assert spool.size_bytes <= 1.05 * 2**20
    chunk = spool.first(10**6)
    assert chunk is not None
    kept = {name: [s.time_us for s in chunk.samples if s.channel == name] for name in channels}
    assert len(kept["t_inner_ring_c"]) > len(kept["speed_rpm"]) > 0
    for name in channels:
        whole = [t for t in range(45_000) if channels[t % 500 % 3] == name]
        assert kept[name] == whole[len(whole) - len(kept[name]) :], "the oldest went first"
    spool.close()


def test_the_least_important_channel_is_what_the_twin_can_compute_again() -> None:
    ranks = [importance(name) for name in ("t_node_7_c.twin", "phase", "load_n", "t_outer_ring_c")]
    assert ranks == sorted(set(ranks))


def test_the_file_gives_the_disk_back(spool: Spool, tmp_path: Path) -> None:
    spool.append([sample(k) for k in range(50_000)])
    full = (tmp_path / FILE_NAME).stat().st_size
    while chunk := spool.first(20_000):
        spool.remove(chunk)
    assert (tmp_path / FILE_NAME).stat().st_size < full / 20


def test_a_damaged_file_is_put_aside(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(random.Random(1).randbytes(8192))
    spool = Spool.open(tmp_path, 16)
    spool.append([sample(1)])
    assert len(spool) == 1
    spool.close()
    assert (tmp_path / "spool-damaged-1.db").stat().st_size == 8192


def test_a_folder_that_is_none_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"spool .*spool\.db: .*expected a file"):
        Spool.open(tmp_path / "missing", 16)


def test_a_full_disk_leaves_the_spool_as_it_was(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path, 16)
    spool.append([sample(1)])
    # The limit that SQLite itself knows gives the same error as the disk's.
    spool._queue.file._connection.execute("PRAGMA max_page_count = 8")
    with pytest.raises(QueueUnavailableError, match="full"):
        spool.append([sample(k) for k in range(5000)])
    chunk = spool.first(99)
    assert chunk is not None
    assert chunk.samples == [sample(1)]
    assert len(spool) == 1
    spool._queue.file._connection.execute("PRAGMA max_page_count = 100000")
    spool.append([sample(2)])
    assert len(spool) == 2
    spool.close()


_KILLED = """
import os, signal, sys
from pathlib import Path
from adapters.samples import Sample
from service.ingest.spool import Spool
spool = Spool.open(Path(sys.argv[1]), 16)
for k in range(100000):
    spool.append([Sample("a", "x", 2 * k, 1.0, 192, 0), Sample("a", "x", 2 * k + 1, 1.0, 192, 0)])
    print(k, flush=True)
    if k % 5 == 4 and (chunk := spool.first(3)):
        spool.remove(chunk)
"""


@pytest.mark.wires
def test_what_was_acknowledged_survives_kill_9(tmp_path: Path) -> None:
    random_moment = random.Random(2)
    for _ in range(3):
        child = subprocess.Popen(
            [sys.executable, "-c", _KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        for _ in range(random_moment.randrange(20, 60)):
            child.stdout.readline()
        child.kill()
        acknowledged = [int(line) for line in child.stdout.read().split()]
        child.wait()
        child.stdout.close()
        last = acknowledged[-1] if acknowledged else 0
        with sqlite3.connect(tmp_path / FILE_NAME) as outside:
            times = [t for (t,) in outside.execute("SELECT time_us FROM samples ORDER BY id")]
        outside.close()
        assert times == list(range(times[0], times[-1] + 1)), "no hole"
        assert times[-1] >= 2 * last + 1
        assert times[-1] % 2 == 1, "both of an append, or none"
        (tmp_path / FILE_NAME).unlink()


def test_damage_that_shows_while_it_runs_costs_what_is_damaged(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path, 16)
    count = 60_000  # more than SQLite holds in memory
    spool.append([sample(k) for k in range(count)])
    with (tmp_path / FILE_NAME).open("r+b") as file:
        file.seek(200 * 4096)
        file.write(random.Random(3).randbytes(2 * 4096))
    found: list[int] = []
    refusals = 0
    while len(spool):
        try:
            chunk = spool.first(7000)
            if chunk is not None:
                found += [one.time_us for one in chunk.samples]
                spool.remove(chunk)
        except QueueUnavailableError:
            refusals += 1
            spool.append([sample(count + refusals)])  # what comes meanwhile stays
            assert refusals < 10
    assert refusals
    assert spool.mended is not None
    assert spool.mended.kept_as.exists()
    lost = count - len({time_us for time_us in found if time_us < count})
    assert 0 < lost < 300, "no more than stood on three pages"
    assert spool.take_lost() == lost
    assert {count + k + 1 for k in range(refusals)} <= set(found)
    spool.close()


def test_a_file_that_the_disk_does_not_give_back_is_set_aside(tmp_path: Path) -> None:
    # Reading the memory of a process where nothing is gives an I/O error, as a bad sector does.
    (tmp_path / FILE_NAME).symlink_to("/proc/self/mem")
    spool = Spool.open(tmp_path, 16)
    assert spool.mended is not None
    spool.append([sample(1)])
    assert len(spool) == 1
    spool.close()
    assert (tmp_path / "spool-damaged-1.db").is_symlink()


def test_a_value_that_a_flipped_bit_made_is_no_sample(tmp_path: Path) -> None:
    spool = Spool.open(tmp_path, 16)
    spool.append([sample(k, value=1000.5 + k) for k in range(10)])
    spool.close()
    path = tmp_path / FILE_NAME
    content = path.read_bytes()
    wanted = struct.pack(">d", 1003.5)
    assert content.count(wanted) == 1
    path.write_bytes(content.replace(wanted, struct.pack(">d", 7.5)))
    spool = Spool.open(tmp_path, 16)
    chunk = spool.first(99)
    assert chunk is not None
    assert [one.time_us for one in chunk.samples] == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    spool.remove(chunk)
    assert spool.take_lost() == 1
    assert len(spool) == 0
    spool.close()


def test_a_spool_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME)) as old:
        old.execute(
            "CREATE TABLE samples (id INTEGER PRIMARY KEY AUTOINCREMENT, importance INTEGER NOT "
            "NULL, asset TEXT NOT NULL, channel TEXT NOT NULL, time_us INTEGER NOT NULL, value "
            "REAL, quality INTEGER NOT NULL, received_us INTEGER NOT NULL)"
        )
        old.execute("INSERT INTO samples VALUES (1, 3, 'a', 't_inner_ring_c', 5, 1.5, 192, 12)")
        old.commit()
    spool = Spool.open(tmp_path, 16)
    spool.append([sample(6)])
    chunk = spool.first(99)
    assert chunk is not None
    assert chunk.samples == [sample(5, 1.5), sample(6)]
    assert spool.mended is None
    spool.close()
