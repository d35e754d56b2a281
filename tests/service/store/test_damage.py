"""Files that a disk or a power cut has damaged: it starts, or names the file; whole rows are kept.

A page of 4096 bytes is what a disk damages. What stands on pages that are as they were must be
there afterwards, whatever became of the others; and what is not there must be counted.
"""

import json
import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.samples import Quality, Sample
from service.clock import ProcessClock
from service.ingest.spool import FILE_NAME as SPOOL
from service.ingest.spool import Spool
from service.store import (
    AuditEntry,
    Outbox,
    QueueUnavailableError,
    Store,
    StoreDamagedError,
    StoreError,
)
from service.store.opening import FILE_NAME as STORE
from service.store.outbox import FILE_NAME as OUTBOX
from service.store.pages import page_rows
from service.store.salvage import damage_of, salvage_store

pytestmark = pytest.mark.wires

PAGE = 4096
SAMPLES = 3000
LINES = 300


# ---------------------------------------------------------------------- what a disk does
def flip_bits(content: bytearray, rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 3, 20))):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)


def tear(content: bytearray, rng: random.Random) -> None:
    """A page of which only the first sectors were written."""
    at = rng.randrange(len(content) // PAGE) * PAGE
    sectors = rng.randrange(1, 8)
    content[at + 512 * sectors : at + PAGE] = bytes(PAGE - 512 * sectors)


def overwrite(content: bytearray, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(content) // PAGE) * PAGE
        content[at : at + PAGE] = rng.randbytes(PAGE)


def truncate(content: bytearray, rng: random.Random) -> None:
    del content[rng.randrange(1, len(content)) :]


def zero_tail(content: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(content))
    content[at:] = bytes(len(content) - at)


DAMAGES = (flip_bits, tear, overwrite, truncate, zero_tail)


def damage(path: Path, rng: random.Random) -> set[int]:
    """Damage a file; returns the numbers, from 1, of the pages that are not as they were."""
    before = path.read_bytes()
    after = bytearray(before)
    while bytes(after) == before:
        rng.choice(DAMAGES)(after, rng)
    path.write_bytes(after)
    return {
        at // PAGE + 1
        for at in range(0, len(before), PAGE)
        if before[at : at + PAGE] != after[at : at + PAGE]
    }


def pages_of(path: Path, folder: Path) -> list[list[tuple[object, ...]]]:
    """Rows of each page of a whole file, the numbers of their tables' rows first."""
    content = path.read_bytes()
    header = content[:100]
    found = []
    for number in range(len(content) // PAGE):
        # A page alone, behind an empty first one.
        alone = folder / "one-page"
        first = header + bytes(PAGE - 100)
        page = content[number * PAGE : (number + 1) * PAGE]
        alone.write_bytes(page if number == 0 else first + page)
        found.append([(row.rowid, *row.values) for row in page_rows(alone)])
    return found


# ---------------------------------------------------------------------- the files, whole
def sample(k: int) -> Sample:
    value = float("nan") if k % 50 == 0 else k * 0.37
    quality = Quality.SENSOR_FAILURE if k % 50 == 0 else Quality.GOOD
    return Sample("bench-1", f"channel_{k % 7}", 10**15 + k * 100_000, value, quality, 10**15 + k)


def as_row(one: Sample) -> tuple[object, ...]:
    return (*one[:3], str(one.value), int(one.quality), one.received_us)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a spool, an outbox, a clock file and a store, all of them closed and whole."""
    folder = tmp_path_factory.mktemp("whole")
    spool = Spool.open(folder, 16)
    spool.append([sample(k) for k in range(SAMPLES)])
    spool.close()
    with Store.open("", folder) as store:
        store.samples.write([sample(k) for k in range(SAMPLES)])
        store.rollups.refresh(2**62)
        for k in range(20):
            store.models.add("bench-1", "candidate", "", {"k": ["x" * 300] * 20}, k)
            store.audit.add(AuditEntry(k, "eva", "", "alarm.shelve", f"alarm {k}"))
    empty = folder / "outbox"
    empty.mkdir()
    with Store.open("", empty) as store:
        path = empty / STORE
        outbox = Outbox.open(empty, store)
        with store._database.writing():  # the store is busy: the lines wait
            for k in range(LINES):
                outbox.record(entry(k))
            while outbox._new:
                time.sleep(0.01)
            with outbox._condition:
                outbox._closing = True
                outbox._condition.notify_all()
            for thread in outbox._threads:  # none writes any more when the store is free again
                thread.join(60)
            outbox.close()
        assert outbox._kept == LINES
        assert path.exists()
    ProcessClock.resume(120.0, folder)
    return folder


def entry(k: int) -> AuditEntry:
    return AuditEntry(10**15 + k, "eva", "10.0.0.1", "alarm.acknowledge", f"alarm {k}", "x" * 80)


# ---------------------------------------------------------------------- each kind
def check_spool(whole: Path, folder: Path, rng: random.Random) -> str:
    path = folder / SPOOL
    shutil.copy(whole / SPOOL, path)
    pages = pages_of(path, folder)
    assert sum(len(row) == 10 for page in pages for row in page) == SAMPLES
    touched = damage(path, rng)
    sent = {as_row(sample(k)): k for k in range(SAMPLES)}
    kept = {
        row[0]
        for n, page in enumerate(pages, 1)
        if n not in touched
        for row in page
        if len(row) == 10
    }
    spool = Spool.open(folder, 16)
    lost = spool.take_lost()
    found = []
    for _ in range(20):
        try:
            while (chunk := spool.first(500)) is not None:
                found += [as_row(one) for one in chunk.samples]
                spool.remove(chunk)
            break
        except QueueUnavailableError:
            continue
    else:
        pytest.fail("the spool does not recover")
    lost += spool.take_lost()
    numbers = {sent[row] + 1 for row in found}  # a wrong sample is none of those sent
    assert kept <= numbers, f"lost {sorted(kept - numbers)[:5]}"
    assert len(numbers) == len(found)
    if 1 not in touched:  # the count is there
        assert lost == SAMPLES - len(found)
    assert len(spool) == 0
    spool.append([sample(1)])
    spool.close()
    return f"{len(found)} of {SAMPLES}, {len(kept)} whole"


def check_outbox(whole: Path, folder: Path, rng: random.Random) -> str:
    path = folder / OUTBOX
    shutil.copy(whole / "outbox" / OUTBOX, path)
    shutil.copy(whole / "outbox" / STORE, folder)
    pages = pages_of(path, folder)
    touched = damage(path, rng)
    kept = {
        str(json.loads(str(row[3]))["audit"]["target"])
        for n, page in enumerate(pages, 1)
        if n not in touched
        for row in page
        if len(row) == 5 and str(row[3]).startswith('{"audit"')
    }
    with Store.open("", folder) as store:
        with Outbox.open(folder, store) as outbox:
            until = time.monotonic() + 60
            while outbox.waiting and time.monotonic() < until:
                time.sleep(0.01)
            assert not outbox.waiting
            lost = outbox.lost
        found = [one.target for one in store.audit.page(LINES + 10).items]
    assert kept <= set(found)
    assert len(found) == len(set(found))
    assert set(found) <= {entry(k).target for k in range(LINES)}
    if 1 not in touched:
        assert lost == LINES - len(found)
    return f"{len(found)} of {LINES}, {len(kept)} whole"


def check_clock(whole: Path, folder: Path, rng: random.Random) -> str:
    path = folder / "clock.json"
    content = bytearray((whole / "clock.json").read_bytes())
    kind = rng.choice((flip_bits, truncate, zero_tail))
    kind(content, rng)
    path.write_bytes(content)
    clock = ProcessClock.resume(120.0, folder)
    assert clock.rate == 120.0
    resumed_us, again = clock.now_us(), ProcessClock.resume(120.0, folder)
    assert 0 < again.now_us() - resumed_us < 600 * 10**6, "what was written is read"
    return str(bytes(content))


def check_store(whole: Path, folder: Path, rng: random.Random) -> str:
    path = folder / STORE
    shutil.copy(whole / STORE, path)
    pages = pages_of(path, folder)
    stored = {
        row[1:]: n
        for n, page in enumerate(pages, 1)
        for row in page
        if len(row) == 6 and row[0] is None
    }
    assert len(stored) == SAMPLES
    touched = damage(path, rng)
    kept = {row for row, n in stored.items() if n not in touched}
    named = ""
    try:
        with Store.open("", folder) as store:
            store.alarms.load(), store.models.active("bench-1"), store.samples.latest("bench-1")
    except (StoreError, StoreDamagedError) as error:
        named = str(error)
        assert STORE in named
        assert "\n" not in named
    problem = damage_of(path)
    if problem is not None:
        done = salvage_store(path, problem)
        assert done.kept_as.exists()
        assert done.rows["samples"] >= len(kept)
    assert damage_of(path) is None
    with Store.open("", folder) as store, store._database.reading() as connection:
        rows = connection.exec_driver_sql("SELECT * FROM samples").fetchall()
        orphans = connection.exec_driver_sql(
            "SELECT COUNT(*) FROM samples WHERE channel_id NOT IN (SELECT id FROM channels)"
        ).scalar()
    assert kept <= {tuple(row) for row in rows}
    assert orphans == 0
    return f"{problem}; {named}"


CHECKS: tuple[Callable[[Path, Path, random.Random], str], ...] = (
    check_spool, check_spool, check_store, check_outbox, check_clock,
)  # fmt: skip


@pytest.fixture
def folders(tmp_path: Path) -> Callable[[], Path]:
    made: list[Path] = []

    def make() -> Path:
        if made:
            shutil.rmtree(made[-1])
        made.append(tmp_path / str(len(made)))
        made[-1].mkdir()
        return made[-1]

    return make


@pytest.mark.endurance
def test_random_damages_stop_no_start_and_cost_no_whole_row(
    whole: Path, folders: Callable[[], Path], pytestconfig: pytest.Config
) -> None:
    for number in range(pytestconfig.getoption("--damages")):
        check = CHECKS[number % len(CHECKS)]
        folder = folders()
        try:
            check(whole, folder, random.Random(number))
        except BaseException as error:
            error.add_note(f"damage {number}, {check.__name__}")
            raise
