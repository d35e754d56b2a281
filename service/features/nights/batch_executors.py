"""What computes batches: processes of this machine, or any other `BatchExecutor`."""

import asyncio
from concurrent.futures.process import BrokenProcessPool
from typing import Final, Protocol

from service.domain.errors import BearingTwinError, ServiceError
from service.features.nights.account import ExecutorName
from service.features.nights.batches import run_batch
from service.jobs.executor import STALLED_AFTER_WALL_S as JOB_STALLED_AFTER_WALL_S
from service.jobs.executor import make_executor
from service.jobs.workers import Workers
from service.worker_pools import NoWorkerError

#: A worker that has a batch for longer hangs; the first one may begin with compiling all kernels.
STALLED_AFTER_WALL_S: Final = 2 * JOB_STALLED_AFTER_WALL_S


class WorkerLostError(BearingTwinError, RuntimeError):
    """The worker that had a batch died: the batch is to be computed again."""


class BatchFailedError(BearingTwinError, RuntimeError):
    """A batch that hangs, or that killed one worker after the other: it is to be divided."""


#: Why a batch that hangs is given up.
HANGS: Final = f"a worker that had it for {STALLED_AFTER_WALL_S:g} s was ended"


class BatchExecutor(Protocol):
    """Computes batches, as many at a time as it has workers.

    Attributes
    ----------
    name : str
        How it is called on the command line.
    worker_count : int
        How many batches it computes at a time.
    workers_lost : int
        How many workers have died so far.
    """

    name: ExecutorName
    worker_count: int
    workers_lost: int

    async def compute(self, content: bytes) -> bytes:
        """Have a worker run `service.features.nights.batches.run_batch`.

        Raises
        ------
        WorkerLostError
            If the worker died; another one can take the batch.
        BatchFailedError
            If the batch hangs, or killed several workers.
        ServiceError
            If there are no workers any more.
        """
        ...


class ProcessBatches:
    """Worker processes of this machine.

    Parameters
    ----------
    worker_count : int
        How many.
    """

    name: ExecutorName = "process"

    def __init__(self, worker_count: int) -> None:
        self.worker_count = worker_count
        self.workers_lost = 0
        self._workers = Workers(make_executor, worker_count)

    async def compute(self, content: bytes) -> bytes:
        """Have a process compute a batch."""
        async with self._workers.turn(urgent=False) as worker:
            try:
                # One that died while it had nothing to do says so only now.
                computed = asyncio.wrap_future(worker.executor.submit(run_batch, content))
                async with asyncio.timeout(STALLED_AFTER_WALL_S):
                    return await computed
            except BrokenProcessPool as error:
                self.workers_lost += 1
                worker.end()
                raise WorkerLostError(str(error)) from error
            except TimeoutError as error:
                self.workers_lost += 1
                worker.end()
                raise BatchFailedError(HANGS) from error
            except NoWorkerError as error:
                worker.end()
                raise ServiceError(str(error)) from error

    def end(self) -> None:
        """End all processes at once."""
        self._workers.end()
