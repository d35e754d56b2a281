"""The background worker: one process of its own, so that a job never holds up the live twin."""

import contextlib
import multiprocessing
import os
import threading
from concurrent.futures import Executor, ProcessPoolExecutor

import numba


def make_executor() -> Executor:
    """Make a pool with one worker process.

    The worker is spawned, not forked: the service has threads and sockets that must not be shared.
    """
    # For the worker, which loads its libraries anew: many small matrices, where threads only wait
    # for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return ProcessPoolExecutor(
        max_workers=1,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_prepare_worker,
    )


def _prepare_worker() -> None:
    """Leave a core and the priority to the live twin, and never outlive the service."""
    with contextlib.suppress(OSError):
        os.nice(10)
    # The simulation takes as many threads as numba is configured for, which may be less than the
    # machine has: a container's share, an environment variable.
    numba.config.NUMBA_NUM_THREADS = max(1, numba.config.NUMBA_NUM_THREADS - 1)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow_parent, args=(parent,), daemon=True).start()


def _follow_parent(parent: "multiprocessing.process.BaseProcess") -> None:
    parent.join()
    os._exit(1)
