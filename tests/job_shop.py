"""A job manager on a real store with two assets, whose results a test may hold back."""

import asyncio
import sqlite3
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jumping import work
from patience import within

from adapters.samples import Sample
from service.alarms import AlarmBook
from service.bus.stream import LiveMessages
from service.domain.requests import IdentificationRequest
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.runner import JobRunner
from service.jobs.worker import JobOrder, JobResult
from service.live.asset import AssetRuntime
from service.store import Job, Outbox, Store
from service.store.opening import FILE_NAME

ASSET = "bench-1"
QUICK = IdentificationRequest(method="refine")
WHO = {"method": "refine", "seed": 0, "budget": None, "who": "x"}


class HeldExecutor(Executor):
    """Computes in a thread, but holds every result back until the test lets it go."""

    def __init__(self) -> None:
        self.let_go = asyncio.Event()
        self.orders: list[JobOrder] = []
        self.computed = asyncio.Event()
        self._threads = ThreadPoolExecutor(1)
        self._loop = asyncio.get_running_loop()
        self._releasing: set[asyncio.Future[None]] = set()
        self._ended = False

    def submit(  # type: ignore[override]
        self, function: Callable[[JobOrder], JobResult], order: JobOrder
    ) -> "Future[JobResult]":
        held: Future[JobResult] = Future()

        def hold(inner: "Future[JobResult]") -> None:
            self._loop.call_soon_threadsafe(has_computed, inner)

        def has_computed(inner: "Future[JobResult]") -> None:
            working.close()
            self.computed.set()
            if self._ended:
                return
            self._releasing.add(asyncio.ensure_future(release(inner)))

        async def release(inner: "Future[JobResult]") -> None:
            await self.let_go.wait()
            held.set_result(inner.result())

        self.orders.append(order)
        working = ExitStack()
        working.enter_context(work())
        self._threads.submit(function, order).add_done_callback(hold)
        return held

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._ended = True
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for releasing in self._releasing:
            releasing.cancel()


@dataclass
class Shop:
    """The manager, what it works on, and what it told."""

    store: Store
    outbox: Outbox
    clock: Any
    folder: Path
    assets: dict[str, AssetRuntime]
    histories: dict[str, AssetHistory]
    bus: LiveMessages
    alarms: AlarmBook
    seconds: list[float] = field(default_factory=list)
    managers: list[IdentificationJobs] = field(default_factory=list)

    async def open(
        self,
        executor: Executor | None = None,
        make_executor: Callable[[], Executor] | None = None,
        worker_count: int = 1,
    ) -> IdentificationJobs:
        """Start a manager, as a start of the service would."""
        jobs = IdentificationJobs(
            JobRunner(
                self.store,
                self.clock,
                self.bus,
                self.assets,
                self.histories,
                make_executor or (lambda: executor or ThreadPoolExecutor(1)),
                self.folder,
                self.seconds.append,
                worker_count,
            )
        )
        self.managers.append(jobs)
        await jobs.start()
        return jobs

    def copy_run(self, asset: str) -> None:
        """Store the run of the first asset for another one, too."""
        run = self.store.samples.read(ASSET, None, 0, 2**62, 100_000)
        self.store.samples.write(
            [
                Sample(asset, one.channel, one.time_us, one.value or 0.0, one.quality, 0)
                for one in run
            ]
        )

    def row(self, job_id: str) -> Job:
        job = self.store.jobs.get(job_id)
        assert job is not None
        return job

    async def ended(self, jobs: IdentificationJobs, job_id: str) -> Job:
        await until(lambda: self.row(job_id).ended_at_us, 120)
        job = self.row(job_id)
        await until(lambda: not jobs.busy(job.asset))
        return job

    def active(self) -> tuple[int, int]:
        """Active version in the store and in the live twin."""
        stored = self.store.models.active(ASSET)
        assert stored is not None
        return stored.version, self.assets[ASSET].active.version


@contextmanager
def away(store_folder: Path, table: str) -> Iterator[None]:
    """The store cannot serve a table for a while."""
    with closing(sqlite3.connect(store_folder / FILE_NAME)) as connection:
        connection.execute(f"ALTER TABLE {table} RENAME TO {table}_away")
        yield
        connection.execute(f"ALTER TABLE {table}_away RENAME TO {table}")


async def until(look: Callable[[], Any], timeout_s: float = 30.0) -> None:
    async with within(timeout_s):
        while True:
            if look():
                return
            await asyncio.sleep(0.01)
