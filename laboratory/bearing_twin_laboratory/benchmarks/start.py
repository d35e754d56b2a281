"""How soon a service of one asset works after a start or the end of its cell, and its memory."""

import asyncio
import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import httpx2

from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.fleet import memory_bytes_of, processes_of, processor_s_of
from service.demo.configuration import ASSET, write_configuration
from service.demo.processes import running
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store
from service.store.opening import FILE_NAME

_PATIENCE_S = 300.0
_LOOK_EVERY_S = 0.01
#: After the start, until the twin has followed the machine for a while.
_FOLLOWS_S = 30.0
#: And so long before its cell is ended.
_READS_S = 3.0
#: Imports the libraries that a service on SQLite loads, prints the processor seconds that it took,
#: and waits.
_LIBRARIES = """
import time
import can, cantools, fastapi, msgspec, numba, numpy, pcodec, prometheus_client
import pydantic_settings, pymodbus.client, sqlalchemy.orm, structlog, uvicorn, websockets, zmq
print(time.process_time(), flush=True)
input()
"""


@dataclass(frozen=True, slots=True)
class _Bench:
    """A virtual bench that runs, and a service configured for it."""

    folder: Path
    configuration: Path
    data_dir: Path
    key: str


@dataclass(frozen=True, slots=True)
class _Start:
    """A service that has just started: seconds of the clock and of the processor."""

    pid: int
    address: str
    first_sample_s: float
    page_s: float
    processor_s: float


def start(progress: Progress) -> Measurement:
    """Processor time of a start until the page can be used, with warm kernels."""
    return asyncio.run(_measure_start(progress))


def kill_to_first_poll(progress: Progress) -> Measurement:
    """Time from the end of the cell by SIGKILL to the next value that is read."""
    return asyncio.run(_measure_kill(progress))


def memory(progress: Progress) -> Measurement:
    """Memory of all processes of a service; what several share is counted once."""
    return asyncio.run(_measure_memory(progress))


async def _measure_start(progress: Progress) -> Measurement:
    progress(0.0, "imports the libraries alone")
    with _libraries() as (_, import_s):
        pass
    async with _bench() as bench:
        progress(0.3, "starts a service")
        async with _started(bench) as begun:
            pass
    async with _bench() as bench:
        progress(0.6, "starts a service without compiled kernels")
        empty = bench.folder / "kernels"
        async with _started(bench, {"NUMBA_CACHE_DIR": str(empty)}) as cold:
            pass
    return Measurement(
        round(begun.processor_s, 2),
        "s",
        round(import_s, 2),
        "import of the same libraries in one process",
        {
            "first_sample_s": round(begun.first_sample_s, 2),
            "page_s": round(begun.page_s, 2),
            "cold_s": round(cold.page_s, 2),
            "cold_first_sample_s": round(cold.first_sample_s, 2),
        },
    )


async def _measure_kill(progress: Progress) -> Measurement:
    with _libraries() as (_, import_s):
        pass
    passed_s = {}
    async with _bench() as bench, _started(bench) as begun:
        for number, how in enumerate((signal.SIGKILL, signal.SIGSTOP)):
            progress(0.3 + 0.3 * number, f"ends the cell: {how.name}")
            await asyncio.sleep(_READS_S)
            names = processes_of(begun.pid)
            cell = next(pid for pid, name in names.items() if name == "twin-cell")
            began_us = time.time_ns() // 1000
            os.kill(cell, how)
            passed_s[how] = await _next_poll_s(bench, began_us)
            await _until_usable(begun.address, bench.key)
    return Measurement(
        round(passed_s[signal.SIGKILL], 2),
        "s",
        round(import_s, 2),
        "import of the same libraries in one process",
        {"hang_to_first_poll_s": round(passed_s[signal.SIGSTOP], 2)},
    )


async def _measure_memory(progress: Progress) -> Measurement:
    with _libraries() as (pid, _):
        reference_bytes = memory_bytes_of(pid)
    async with _bench() as bench, _started(bench) as begun:
        progress(0.3, "the twin follows the machine")
        await asyncio.sleep(_FOLLOWS_S)
        return Measurement(
            memory_bytes_of(begun.pid),
            "B",
            reference_bytes,
            "one process with the same libraries",
        )


@contextlib.contextmanager
def _libraries() -> Iterator[tuple[int, float]]:
    """A process that has imported the libraries alone, and the seconds that it took."""
    process = subprocess.Popen(
        [sys.executable, "-c", _LIBRARIES],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        if process.stdout is None:
            raise BenchmarkError("no output to read")
        yield process.pid, float(process.stdout.readline())
    finally:
        process.communicate("\n")


@contextlib.asynccontextmanager
async def _bench() -> AsyncIterator[_Bench]:
    """Run a virtual bench, with compiled kernels, and configure a service for it."""
    with tempfile.TemporaryDirectory(prefix="bearing-twin-start-") as name:
        folder = Path(name)
        async with running("preparation", ("warm-up",), folder / "warm-up.log"):
            pass
        wires = ("--modbus-port", "0", "--can-port", "0", "--json")
        arguments = ("virtual-bench", "--scenario", "staircase", "--rate", "1", *wires)
        async with running("virtual bench", arguments, folder / "bench.log") as bench:
            listens = json.loads(bench.first_line)
            configuration = write_configuration(folder, [listens], 1.0, 0)
            settings = load_settings(configuration)
            with Store.open(settings.service.database_url, settings.data_dir) as store:
                key = create_key(store, "viewer").text
            yield _Bench(folder, configuration, settings.data_dir, key)


@contextlib.asynccontextmanager
async def _started(bench: _Bench, environment: Mapping[str, str] = {}) -> AsyncIterator[_Start]:
    """Start a service; it has stored a sample and its page can be used."""
    begun_s = time.perf_counter()
    storing = asyncio.create_task(_first_sample_s(bench.data_dir / FILE_NAME, begun_s))
    serve = ("serve", "-c", str(bench.configuration))
    log = bench.folder / "service.log"
    async with running("service", serve, log, os.environ | environment) as service:
        await _until_usable(service.first_line, bench.key)
        page_s = time.perf_counter() - begun_s
        processor_s = processor_s_of(service.pid)[0]
        yield _Start(service.pid, service.first_line, await storing, page_s, processor_s)


async def _first_sample_s(file: Path, begun_s: float) -> float:
    await _stored(file, "SELECT 1 FROM samples LIMIT 1")
    return time.perf_counter() - begun_s


async def _next_poll_s(bench: _Bench, began_us: int) -> float:
    """Seconds until a value is read, as the service itself notes the time of each."""
    # The clock of the process is that of the machine here.
    query = (
        f"SELECT MIN(received_us) FROM samples WHERE received_us > {began_us} AND value NOT NULL"
    )
    return (await _stored(bench.data_dir / FILE_NAME, query) - began_us) / 1e6


async def _stored(file: Path, query: str) -> int:
    """Wait until the store has an answer."""
    deadline_s = time.perf_counter() + _PATIENCE_S
    with contextlib.closing(sqlite3.connect(f"{file.as_uri()}?mode=ro", uri=True)) as store:
        while time.perf_counter() < deadline_s:
            row = store.execute(query).fetchone()
            if row is not None and row[0] is not None:
                return int(row[0])
            await asyncio.sleep(_LOOK_EVERY_S)
    raise BenchmarkError(f"no sample stored within {_PATIENCE_S:g} s")


async def _until_usable(address: str, key: str) -> None:
    """Wait until page and snapshot are answered."""
    async with httpx2.AsyncClient(base_url=address, headers={"X-API-Key": key}) as client:
        deadline_s = time.perf_counter() + _PATIENCE_S
        while time.perf_counter() < deadline_s:
            answers = [await client.get(path) for path in ("/", f"/api/v1/assets/{ASSET}/snapshot")]
            if all(answer.is_success for answer in answers):
                return
            await asyncio.sleep(_LOOK_EVERY_S)
    raise BenchmarkError(f"no page within {_PATIENCE_S:g} s")
