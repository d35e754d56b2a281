"""An ingest on a real store, and the drivers that a test plays."""

import asyncio
import contextlib
import sqlite3
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest
from patience import within
from prometheus_client import CollectorRegistry

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Sample
from service.clock import ProcessClock
from service.ingest import Ingest, Spool
from service.ingest.spool import FILE_NAME as SPOOL_FILE
from service.store import Store
from service.store.opening import FILE_NAME


class ScriptedSource:
    """A driver that yields what the test puts in; an exception put in is raised."""

    def __init__(self, name: str = "pt100") -> None:
        self.name = name
        self.script: asyncio.Queue[Batch | Exception] = asyncio.Queue()
        self.entered = 0
        self.left = 0
        self.given = 0
        self.up = True

    async def __aenter__(self) -> Self:
        self.entered += 1
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.left += 1

    async def batches(self) -> AsyncIterator[Batch]:
        while True:
            step = await self.script.get()
            if isinstance(step, Exception):
                raise step
            self.given += len(step.samples)
            yield step

    def health(self) -> SourceHealth:
        return SourceHealth(self.name, "scripted", up=self.up, samples=self.given)


class Hall:
    """An ingest on a real store, and what it told the twin."""

    def __init__(self, data_dir: Path) -> None:
        self.path = data_dir / FILE_NAME
        self.store = Store.open("", data_dir)
        self.spool = Spool.open(data_dir, 16)
        self.registry = CollectorRegistry()
        self.taken: list[Batch] = []
        self.ingest = Ingest(
            self.store, self.spool, ProcessClock(), self._take, registry=self.registry
        )

    def _take(self, batch: Batch) -> None:
        self.taken.append(batch)

    @contextlib.asynccontextmanager
    async def running(self, *sources: ScriptedSource) -> AsyncIterator[None]:
        # One that says nothing shows as well as any that all has begun.
        sources = sources or (ScriptedSource("silent"),)
        task = asyncio.create_task(self.ingest.run(sources))
        await self.until_true(lambda: all(source.entered for source in sources))
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    def stored(self, asset: str = "a") -> list[tuple[str, int, float | None, int]]:
        return [one[:4] for one in self.store.samples.read(asset, None, 0, 2**62, 10**6)]

    def metric(self, name: str, **labels: str) -> float | None:
        return self.registry.get_sample_value(f"bearing_twin_{name}", labels)

    def stored_outside(self) -> int:
        with contextlib.closing(sqlite3.connect(f"file:{self.path}?mode=ro", uri=True)) as outside:
            return int(outside.execute("SELECT COUNT(*) FROM samples").fetchone()[0])

    def on_spool(self) -> list[int]:
        """Times of what somebody else finds in the spool's file."""
        file = self.path.with_name(SPOOL_FILE)
        with contextlib.closing(sqlite3.connect(file)) as outside:
            return [t for (t,) in outside.execute("SELECT time_us FROM samples ORDER BY id")]

    def close(self) -> None:
        self.store.close()
        self.spool.close()

    async def until(self, **counts: int) -> None:
        await self.until_true(lambda: counts.items() <= self.ingest.counts().items())

    async def until_true(self, holds: Callable[[], bool]) -> None:
        async with within(30):
            while not holds():  # noqa: ASYNC110 - the counts have no event to wait for
                await asyncio.sleep(0.001)

    @contextlib.contextmanager
    def locked(self, file: str = FILE_NAME) -> Iterator[None]:
        """Somebody else holds the right to write."""
        intruder = sqlite3.connect(self.path.with_name(file), isolation_level=None)
        intruder.execute("BEGIN EXCLUSIVE")
        try:
            yield
        finally:
            intruder.rollback()
            intruder.close()


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[Hall]:
    hall = Hall(tmp_path)
    yield hall
    hall.close()


def sample(time_us: int, value: float = 1.0, quality: int = 192, channel: str = "x") -> Sample:
    return Sample("a", channel, time_us, value, quality, time_us)
