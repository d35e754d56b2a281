"""When an asset was away is in the table: its history says so, whichever run saw it."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry

from adapters.samples import Quality, Sample
from service.alarms import AlarmBook
from service.cell.absences import Absences
from service.clock import MICROSECONDS, ProcessClock, wall_us
from service.ingest import Ingest, Spool
from service.store import JournalFilter, Outbox, Store

TABLE = {"template": "axle"}


class Run:
    """One run of a cell on a data directory, as far as absences need it."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.open("", folder)
        self.clock = ProcessClock()
        self.spool = Spool.open(folder, 10)
        self.outbox = Outbox.open(folder, self.store)
        registry = CollectorRegistry()
        self.ingest = Ingest(
            self.store, self.spool, self.clock, lambda batch: None, registry=registry
        )
        self.alarms = AlarmBook(self.outbox, self.clock, lambda alarm: None)
        self.running: list[asyncio.Task[None]] = []
        self.absences = Absences(self.store, self.outbox, self.ingest, self.alarms, self.clock)

    async def work(self, *assets: str) -> None:
        """Compare with the table, all or these assets, until the marks are stored."""
        if not self.running:
            works = (self.ingest.run([]), self.absences.run())
            self.running = [asyncio.create_task(work) for work in works]
        self.absences.compare(assets or None)
        while not self.absences.is_done or self.ingest.counts()["waiting"]:  # noqa: ASYNC110
            await asyncio.sleep(0.01)

    async def close(self) -> None:
        for task in self.running:
            task.cancel()
        await asyncio.gather(*self.running, return_exceptions=True)
        self.outbox.close(5)
        self.spool.close()
        self.store.close()

    def push(self, asset: str, time_us: int, value: float) -> None:
        self.store.samples.write([Sample(asset, "load_n", time_us, value, 192, time_us)])

    def qualities(self, asset: str) -> list[int]:
        return [one.quality for one in self.store.samples.read(asset, None, 0, 2**62, 100)]

    def events(self, asset: str) -> list[tuple[str, int]]:
        assert self.outbox.flush(5)
        lines = self.store.alarms.journal(JournalFilter(asset=asset)).items
        return [(one.kind, one.time_us) for one in reversed(lines)]


@pytest.fixture
async def begun() -> AsyncIterator[list[Run]]:
    runs: list[Run] = []
    yield runs
    for run in runs:
        await run.close()


@pytest.mark.parametrize("dies", ["before the addition", "before both", "never"])
async def test_a_pushed_channel_is_marked_whenever_the_service_dies(
    begun: list[Run], tmp_path: Path, dies: str
) -> None:
    now_us = wall_us()
    removed_us, added_us = now_us - 60 * MICROSECONDS, now_us - 30 * MICROSECONDS
    run = Run(tmp_path)
    run.store.assets.change({"a": TABLE, "b": TABLE}, now_us - 120 * MICROSECONDS)
    for name in ("a", "b"):
        run.push(name, removed_us - 5 * MICROSECONDS, 104.0)
    if dies == "before both":
        await run.close()
        run = Run(tmp_path)
    run.store.assets.change({"a": None}, removed_us)
    if dies == "before the addition":
        await run.close()
        run = Run(tmp_path)
        await run.work()
        assert run.events("a") == [("asset not followed", removed_us)]
    run.store.assets.change({"a": TABLE}, added_us)
    begun.append(run)
    run.push("a", added_us + MICROSECONDS, 200.0)
    await run.work(*([] if dies == "before both" else ["a"]))
    assert run.qualities("a") == [192, Quality.OUT_OF_SERVICE, 192]
    assert run.qualities("b") == [192], "it was never away"
    # The next start finds nothing that is missing but the events, and those once.
    for _ in range(2):
        await run.work()
        assert run.events("a") == [
            ("asset not followed", removed_us),
            ("asset followed again", added_us),
        ]
    assert run.qualities("a") == [192, Quality.OUT_OF_SERVICE, 192]
    assert run.events("b") == []


async def test_what_this_run_has_marked_is_not_marked_again(
    begun: list[Run], tmp_path: Path
) -> None:
    now_us = wall_us()
    run = Run(tmp_path)
    begun.append(run)
    run.store.assets.change({"a": TABLE}, 1)
    last = Sample("a", "load_n", now_us - MICROSECONDS, 1.0, 192, now_us)
    run.store.samples.write([last])
    run.store.assets.change({"a": None}, now_us)
    run.absences.note({"a": {"load_n": last}}, [])
    run.absences.mark(["a"], now_us)
    run.store.assets.change({"a": TABLE}, now_us + 1)
    await run.work("a")
    assert run.qualities("a") == [192, Quality.OUT_OF_SERVICE]


def test_the_clock_of_a_faster_bench_finds_its_time() -> None:
    clock = ProcessClock(10.0, (1000.0, 50_000_000))
    assert clock.at_wall_us(1_002_000_000) == 50_000_000 + 20_000_000
    assert ProcessClock().at_wall_us(7) == 7


async def test_what_this_run_has_said_is_not_said_again(begun: list[Run], tmp_path: Path) -> None:
    now_us = wall_us()
    run = Run(tmp_path)
    begun.append(run)
    run.store.assets.change({"a": TABLE}, 1)
    run.push("a", now_us - 9 * MICROSECONDS, 1.0)
    run.store.assets.change({"a": None}, now_us - 8 * MICROSECONDS)
    await run.work()
    # The cell takes it up while the comparison of its start still waits for the store.
    run.store.assets.change({"a": TABLE}, now_us + 60 * MICROSECONDS)
    run.absences.note({}, ["a"])
    await run.work()
    assert [kind for kind, _ in run.events("a")] == ["asset not followed", "asset followed again"]
