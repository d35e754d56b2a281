"""Workers: as many jobs at a time as configured, and what a person waits for comes first."""

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import pytest
from job_shop import ASSET, QUICK, HeldExecutor, Shop, until

from service.jobs.workers import Worker, Workers


@pytest.fixture
def make_executor() -> Iterator[Callable[[], Executor]]:
    made: list[Executor] = []

    def make() -> Executor:
        made.append(ThreadPoolExecutor(1))
        return made[-1]

    yield make
    for one in made:
        one.shutdown()


class Line:
    """Those who want a worker, and in which order they had one."""

    def __init__(self, workers: Workers) -> None:
        self.served: list[str] = []
        self.had: list[Worker] = []
        self._workers = workers
        self._ready: dict[str, asyncio.Event] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def join(self, name: str, urgent: bool) -> None:
        self._ready[name] = asyncio.Event()
        self._tasks[name] = asyncio.create_task(self._have(name, urgent))
        await asyncio.sleep(0)

    async def leave(self, name: str) -> None:
        self._ready[name].set()
        await self._tasks[name]
        await asyncio.sleep(0)

    async def give_up(self, name: str) -> None:
        self._tasks[name].cancel()
        await asyncio.gather(self._tasks[name], return_exceptions=True)

    async def _have(self, name: str, urgent: bool) -> None:
        async with self._workers.turn(urgent) as worker:
            self.served.append(name)
            self.had.append(worker)
            await self._ready[name].wait()


async def test_what_a_person_waits_for_comes_before_what_the_service_does_by_itself(
    make_executor: Callable[[], Executor],
) -> None:
    line = Line(Workers(make_executor, 1))
    for name, urgent in (("first", False), ("a", False), ("b", False), ("x", True), ("y", True)):
        await line.join(name, urgent)
    for name in ("first", "x", "y", "a", "b"):
        assert line.served[-1] == name
        await line.leave(name)


async def test_each_job_has_a_worker_of_its_own(make_executor: Callable[[], Executor]) -> None:
    line = Line(Workers(make_executor, 2))
    for name in ("a", "b", "c"):
        await line.join(name, True)
    assert line.served == ["a", "b"]
    assert line.had[0] is not line.had[1]
    await line.leave("b")
    assert line.served == ["a", "b", "c"]
    assert line.had[2] is line.had[1]
    for name in ("a", "c"):
        await line.leave(name)


async def test_who_gives_up_costs_the_others_no_worker(
    make_executor: Callable[[], Executor],
) -> None:
    line = Line(Workers(make_executor, 1))
    for name in ("a", "b", "c", "d"):
        await line.join(name, True)
    await line.give_up("b")
    # In the moment in which its turn comes.
    line._ready["a"].set()
    await line._tasks["a"]
    await line.give_up("c")
    await asyncio.sleep(0)
    assert line.served[-1] == "d"
    await line.leave("d")


async def test_two_workers_compute_for_two_assets_at_a_time(shop: Shop) -> None:
    shop.copy_run("bench-2")
    held = [HeldExecutor(), HeldExecutor()]
    left = iter(held)
    jobs = await shop.open(make_executor=lambda: next(left), worker_count=2)
    shown = [await jobs.create(asset, QUICK, None, "x") for asset in (ASSET, "bench-2")]
    await until(lambda: all(one.orders for one in held))
    for one in held:
        one.let_go.set()
    for job, _ in shown:
        assert (await shop.ended(jobs, job.id)).status == "succeeded"
