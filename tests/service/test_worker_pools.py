"""Worker processes that cannot be had."""

import multiprocessing
import threading
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import pytest
from patience import patience

from service.web.what_if_worker import WhatIfWorker
from service.worker_pools import NoWorkerError, make_pool, why_no_worker

pytestmark = pytest.mark.wires


def refusing(error: Exception) -> Callable[..., Any]:
    def refuse(*_: object, **__: object) -> None:
        raise error

    return refuse


def test_a_machine_with_room_has_workers() -> None:
    assert why_no_worker() is None
    with make_pool() as pool:
        assert pool.submit(abs, -1).result() == 1


def test_semaphores_that_cannot_be_made_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    refuse = refusing(OSError(30, "Read-only file system"))
    monkeypatch.setattr(multiprocessing.synchronize.SemLock, "__init__", refuse)
    with pytest.raises(NoWorkerError, match=r"Read-only file system\); expected a /dev/shm"):
        make_pool()
    assert "Read-only file system" in str(why_no_worker())


@pytest.mark.parametrize(
    "error", [BlockingIOError(11, "Resource unavailable"), RuntimeError("can't start new thread")]
)
def test_a_pool_without_room_for_its_process_is_replaced(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    worker = WhatIfWorker(make_pool)
    pool = make_pool()
    with monkeypatch.context() as full:
        full.setattr(threading.Thread, "start", refusing(error))
        with pytest.raises(NoWorkerError):
            worker.submit(abs, -1)
        with pytest.raises(NoWorkerError):
            pool.submit(abs, -1)
    assert not worker.is_running
    with pytest.raises(BrokenProcessPool):
        pool.submit(abs, -1)
    assert worker.submit(abs, -1).result(timeout=patience(60)) == 1
    worker.shutdown()
    pool.shutdown(wait=False)
