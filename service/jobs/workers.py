"""The background workers, and whose turn it is."""

import asyncio
import heapq
import itertools
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor
from contextlib import asynccontextmanager
from typing import Final

from service.jobs.executor import end_executor

#: A process without a job for so many wall seconds ends: it holds a hundred megabytes.
IDLE_S: Final = 120.0


class Worker:
    """A process that computes one job at a time, begun with its first one.

    Parameters
    ----------
    make_executor : callable
        Makes the process; called again after it died or was ended.
    """

    def __init__(self, make_executor: Callable[[], Executor]) -> None:
        self._make_executor = make_executor
        self._executor: Executor | None = None
        self._ending: asyncio.TimerHandle | None = None

    @property
    def executor(self) -> Executor:
        """What takes the work."""
        if self._executor is None:
            self._executor = self._make_executor()
        return self._executor

    def end(self) -> None:
        """End the process at once; the next job begins another one."""
        self.keep()
        executor, self._executor = self._executor, None
        if executor is not None:
            end_executor(executor)

    def end_when_idle(self) -> None:
        """End the process after some time, unless it is kept until then."""
        self._ending = asyncio.get_running_loop().call_later(IDLE_S, self.end)

    def keep(self) -> None:
        """Have the process ready for the next job."""
        if self._ending is not None:
            self._ending.cancel()
            self._ending = None


class Workers:
    """Some workers. What a person waits for comes first, then the one that waits longest.

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
            worker = self._free.pop()
            worker.keep()
            return worker
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
        worker.end_when_idle()
