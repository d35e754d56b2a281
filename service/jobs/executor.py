"""The background worker: one process of its own, so that a job never holds up the live twin."""

import asyncio
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from typing import TypeVar

import numba

from service.domain.errors import BearingTwinError
from service.loading import load_numba
from service.worker_pools import make_pool

PROGRESS_EVERY_WALL_S = 0.4
#: Wall seconds without a sign of life after which a worker hangs. Its signs come many times a
#: second; the longest pause is the start, when a slow machine may compile all kernels.
STALLED_AFTER_WALL_S = 900.0

Result = TypeVar("Result")


class WorkerStalledError(BearingTwinError, RuntimeError):
    """A worker hangs; the text says for how long there was no sign of life."""


def make_executor() -> Executor:
    """Make a pool with one worker process. Raises `NoWorkerError`."""
    return make_pool(prepare_worker)


def end_executor(executor: Executor) -> None:
    """End the worker processes at once.

    A worker in the middle of a computation cannot be asked politely in time, and one that is
    suspended does not even take SIGTERM: it is killed. Whatever it leaves in its folder is whole.
    """
    # The public API to do so (kill_workers) exists from Python 3.14 only.
    processes = list((getattr(executor, "_processes", None) or {}).values())
    executor.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            process.kill()


async def watched(
    future: "asyncio.Future[Result]",
    life: Callable[[], int | None],
    stalled_after_wall_s: Callable[[], float],
    meanwhile: Callable[[], Awaitable[None]],
) -> Result:
    """Wait for a worker's result as long as the worker shows signs of life.

    Parameters
    ----------
    future
        Of the result; cancelled when no caller waits for it any more.
    life
        Gives what changes with every sign of life.
    stalled_after_wall_s
        Gives the wall seconds without a sign of life after which the worker hangs.
    meanwhile
        Is done a few times a second.

    Raises
    ------
    WorkerStalledError
        If the worker hangs; it is left as it is.
    """
    now_s = asyncio.get_running_loop().time
    last, seen_s = life(), now_s()
    try:
        while True:
            done, _ = await asyncio.wait([future], timeout=PROGRESS_EVERY_WALL_S)
            if done:
                return future.result()
            if (sign := life()) != last:
                last, seen_s = sign, now_s()
            elif now_s() - seen_s > stalled_after_wall_s():
                limit_s = stalled_after_wall_s()
                raise WorkerStalledError(
                    f"the worker did not respond for {limit_s:g} s and was terminated"
                )
            await meanwhile()
    finally:
        future.cancel()


def prepare_worker() -> None:
    """Leave a core and the priority to the live twin, and never outlive the service."""
    load_numba()
    with contextlib.suppress(OSError):
        os.nice(10)
    # Ctrl+C is meant for the service, or the command: it ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The simulation takes as many threads as numba is configured for, which may be less than the
    # machine has: a container's share, an environment variable.
    numba.config.NUMBA_NUM_THREADS = max(1, numba.config.NUMBA_NUM_THREADS - 1)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow_parent, args=(parent,), daemon=True).start()


def _follow_parent(parent: "multiprocessing.process.BaseProcess") -> None:
    parent.join()
    os._exit(1)
