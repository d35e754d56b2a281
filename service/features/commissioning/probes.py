"""Runs what asks strange devices and files: in one worker process, one at a time, for a time."""

import asyncio
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Final, TypeVar

from service.web.shares import BusyError
from service.web.what_if_worker import WhatIfWorker
from service.worker_pools import NoWorkerError, make_pool

#: Wall seconds that a probe may take, with the start of its process.
LIMIT_S: Final = 30.0
#: How many may wait for their turn.
MOST_WAITING: Final = 4
#: A worker without work for so many wall seconds ends.
IDLE_S: Final = 120.0

Result = TypeVar("Result")


class Probes:
    """The worker process; it begins with the first probe, and ends when it is idle."""

    def __init__(self) -> None:
        self._worker = WhatIfWorker(make_pool)
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._ending: asyncio.TimerHandle | None = None

    async def run(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """Have a function called in the worker; what it raises, this raises.

        Raises `BusyError` if it takes too long, its process dies, or others wait already.
        """
        if self._waiting >= MOST_WAITING:
            raise BusyError(f"{MOST_WAITING} probes wait already; try again")
        self._waiting += 1
        try:
            async with self._turn:
                return await self._run(work, *arguments)
        finally:
            self._waiting -= 1

    async def _run(self, work: Callable[..., Result], *arguments: Any) -> Result:
        if self._ending is not None:
            self._ending.cancel()
        try:
            async with asyncio.timeout(LIMIT_S):
                return await asyncio.wrap_future(self._worker.submit(work, *arguments))
        except TimeoutError:
            self.close()
            raise BusyError(f"no answer within {LIMIT_S:g} s") from None
        except asyncio.CancelledError:
            self.close()
            raise
        except BrokenProcessPool as error:
            raise BusyError("the process that asks the devices has died") from error
        except NoWorkerError as error:
            raise BusyError(str(error)) from error
        finally:
            self._ending = asyncio.get_running_loop().call_later(IDLE_S, self.close)

    def close(self) -> None:
        """End the process, also in the middle of a probe."""
        self._worker.shutdown()
