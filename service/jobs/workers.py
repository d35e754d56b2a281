"""The background workers, and whose turn it is."""

import asyncio
import heapq
import itertools
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor
from contextlib import asynccontextmanager

from service.jobs.executor import end_executor


class Worker:
    """A process that computes one job at a time, begun with its first one.

    Parameters
    ----------
    make_executor : callable
        Makes the process; called again after it died or was ended.

    Attributes
    ----------
    executor : concurrent.futures.Executor
        Takes the work.
    """

    def __init__(self, make_executor: Callable[[], Executor]) -> None:
        self._make_executor = make_executor
        self.executor = make_executor()

    def replace(self) -> None:
        """End the process at once, and begin another one with the next job."""
        self.end()
        self.executor = self._make_executor()

    def end(self) -> None:
        """End the process at once."""
        end_executor(self.executor)


class Workers:
    """Some workers. What a person waits for comes first, then whoever waits longest.

    An asset has one unfinished job at most, so that none keeps the others out.

    Parameters
    ----------
    make_executor : callable
        Makes the process of a worker.
    count : int
        How many jobs run at a time.
    """

    def __init__(self, make_executor: Callable[[], Executor], count: int) -> None:
        self.all = [Worker(make_executor) for _ in range(count)]
        self._free = list(reversed(self.all))
        self._waiting: list[tuple[bool, int, asyncio.Future[Worker]]] = []
        self._numbers = itertools.count()

    def end(self) -> None:
        """End all processes at once."""
        for worker in self.all:
            worker.end()

    @asynccontextmanager
    async def turn(self, urgent: bool) -> AsyncIterator[Worker]:
        """Wait for a worker, and have it for the length of an ``async with`` block.

        Parameters
        ----------
        urgent : bool
            Whether a person waits for it.
        """
        worker = await self._next(urgent)
        try:
            yield worker
        finally:
            self._give_back(worker)

    async def _next(self, urgent: bool) -> Worker:
        if self._free:
            return self._free.pop()
        turn: asyncio.Future[Worker] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (not urgent, next(self._numbers), turn))
        try:
            return await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self._give_back(turn.result())
            raise

    def _give_back(self, worker: Worker) -> None:
        while self._waiting:
            _, _, turn = heapq.heappop(self._waiting)
            if not turn.done():
                turn.set_result(worker)
                return
        self._free.append(worker)
