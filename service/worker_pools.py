"""Pools of worker processes, which are not to be had on every machine."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from service.domain.errors import NotReadyError


class NoWorkerError(NotReadyError):
    """No worker process can be started; the text says why, and what was expected."""

    def __init__(self, error: OSError) -> None:
        super().__init__(
            f"no worker process can be started ({error.strerror or error}); expected a /dev/shm "
            "that can be written, and room for more processes"
        )


def make_pool(
    initializer: Callable[..., None] | None = None, initargs: tuple[Any, ...] = ()
) -> ProcessPoolExecutor:
    """Make a pool with one worker process, which starts with its first task.

    The worker is spawned, not forked: the service has threads and sockets that must not be shared.
    Raises `NoWorkerError`.
    """
    # For the worker, which loads its libraries again: many small matrices, where threads only wait
    # for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        return ProcessPoolExecutor(
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
