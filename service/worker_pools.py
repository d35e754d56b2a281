"""Pools of worker processes, which are not to be had on every machine."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from service.domain.errors import NotReadyError

Result = TypeVar("Result")


class NoWorkerError(NotReadyError):
    """No worker process can be started; the text says why, and what was expected."""

    def __init__(self, error: Exception) -> None:
        super().__init__(
            f"no worker process can be started ({getattr(error, 'strerror', None) or error}); "
            "expected a /dev/shm that can be written, and room for more processes"
        )


class WorkerPool(ProcessPoolExecutor):
    """A pool that says when it cannot start its process; it is of no use then."""

    _without_process = False

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> "Future[Result]":
        """Have a function called in the process. Raises `NoWorkerError`."""
        if self._without_process:
            raise BrokenProcessPool("its process could not be started")
        try:
            return super().submit(fn, *args, **kwargs)
        except (OSError, RuntimeError) as error:
            # Python has no name of its own for a thread that finds no room.
            if isinstance(error, RuntimeError) and "start new thread" not in str(error):
                raise
            self._without_process = True
            for process in list((self._processes or {}).values()):
                process.kill()
            raise NoWorkerError(error) from error


def make_pool(
    initializer: Callable[..., None] | None = None, initargs: tuple[Any, ...] = ()
) -> WorkerPool:
    """Make a pool with one worker process, which starts with its first task.

    The worker is spawned, not forked: the service has threads and sockets that must not be shared.
    Raises `NoWorkerError`.
    """
    # For the worker, which loads its libraries again: many small matrices, where threads only wait
    # for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        # Before there is anything that it would have to remove.
        resource_tracker.ensure_running()
        return WorkerPool(
            max_workers=1,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=initializer,
            initargs=initargs,
        )
    except OSError as error:
        raise NoWorkerError(error) from error


def why_no_worker() -> str | None:
    """Try whether worker processes can be made; None where they can."""
    try:
        multiprocessing.get_context("fork").Lock()  # which needs no process of its own
    except OSError as error:
        return str(NoWorkerError(error))
    return None
