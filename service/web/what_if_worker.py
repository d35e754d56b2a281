"""The process that computes what-if forecasts: its work takes nothing from polls and live twins."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import structlog

from service.worker_pools import NoWorkerError

Result = TypeVar("Result")

_log = structlog.get_logger(__name__)


class WhatIfWorker(Executor):
    """A worker process that starts with its first task and is replaced when it has died."""

    def __init__(self, make_executor: Callable[[], Executor]) -> None:
        self._make_executor = make_executor
        self._executor: Executor | None = None

    @property
    def is_running(self) -> bool:
        """Whether it was started and not ended."""
        return self._executor is not None

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> "Future[Result]":
        """Have a function called in the process; it and its arguments must be picklable.

        Raises `NoWorkerError` where no process can be started.
        """
        if self._executor is None:
            self._executor = self._make_executor()
        try:
            try:
                return self._executor.submit(fn, *args, **kwargs)
            except BrokenProcessPool:
                _log.warning("what_if_worker_replaced")
                self._executor.shutdown(wait=False)
                self._executor = self._make_executor()
                return self._executor.submit(fn, *args, **kwargs)
        except NoWorkerError:
            self.shutdown(cancel_futures=True)
            raise

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the process, also in the middle of a task: no caller waits for its answer."""
        executor, self._executor = self._executor, None
        if executor is None:
            return
        # The public API for it (terminate_workers) exists from Python 3.14 only.
        processes = list((getattr(executor, "_processes", None) or {}).values())
        executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
