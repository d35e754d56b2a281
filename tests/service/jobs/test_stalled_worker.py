"""A worker process that hangs: it is ended, and no other job waits for it without limit."""

import os
import signal
from multiprocessing.process import BaseProcess

import pytest
from job_shop import ASSET, QUICK, Shop, until

from service.domain.requests import IdentificationRequest
from service.jobs.executor import STALLED_AFTER_WALL_S, make_executor
from service.jobs.manager import IdentificationJobs
from service.jobs.workspace import JobFolder

pytestmark = pytest.mark.wires

PATIENCE_S = 180.0
HANGS_S = 2.0
LONG = IdentificationRequest(method="noa", budget=5_000_000)


async def suspend(jobs: IdentificationJobs, job_id: str, shop: Shop) -> BaseProcess:
    """Suspend the worker as soon as it has left a checkpoint."""
    folder = JobFolder(shop.folder / job_id)
    await until(lambda: folder.life() and folder.read_progress(), PATIENCE_S)
    await until(folder.read_checkpoint, PATIENCE_S)
    [process] = jobs.runner.workers.all[0].executor._processes.values()  # type: ignore[union-attr]
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    return process


async def test_a_worker_that_hangs_once_goes_on_from_its_checkpoint(shop: Shop) -> None:
    jobs = await shop.open(make_executor=make_executor)
    hung, _ = await jobs.create(ASSET, LONG, None, "x")
    process = await suspend(jobs, hung.id, shop)
    folder = JobFolder(shop.folder / hung.id)
    kept = folder.read_checkpoint()
    assert kept is not None
    jobs.runner.stalled_after_wall_s = HANGS_S
    await until(lambda: shop.row(hung.id).attempts == 2, PATIENCE_S)
    jobs.runner.stalled_after_wall_s = STALLED_AFTER_WALL_S
    await until(lambda: not process.is_alive(), PATIENCE_S)
    await until(folder.read_progress, PATIENCE_S)
    progress = folder.read_progress()
    assert progress is not None
    assert progress.evaluations >= kept["evaluations"] > 0, "it does not begin once more"
    assert shop.row(hung.id).status == "running"


async def test_a_worker_that_hangs_twice_fails_its_job_and_the_next_job_runs(shop: Shop) -> None:
    shop.copy_run("bench-2")
    jobs = await shop.open(make_executor=make_executor)
    hung, _ = await jobs.create(ASSET, LONG, None, "x")
    waiting, _ = await jobs.create("bench-2", LONG, None, "x")
    await suspend(jobs, hung.id, shop)
    jobs.runner.stalled_after_wall_s = HANGS_S
    await until(lambda: shop.row(hung.id).attempts == 2, PATIENCE_S)
    jobs.runner.stalled_after_wall_s = STALLED_AFTER_WALL_S
    assert shop.row(waiting.id).status == "queued"
    await suspend(jobs, hung.id, shop)
    jobs.runner.stalled_after_wall_s = HANGS_S
    await until(lambda: shop.row(hung.id).ended_at_us, PATIENCE_S)
    jobs.runner.stalled_after_wall_s = STALLED_AFTER_WALL_S
    job = shop.row(hung.id)
    assert (job.status, job.attempts) == ("failed", 2)
    assert job.error == f"the worker did not respond for {HANGS_S:g} s and was terminated"
    await until(lambda: (shop.row(waiting.id).evaluations or 0) > 0, PATIENCE_S)


async def test_a_stop_ends_a_worker_that_hangs(shop: Shop) -> None:
    jobs = await shop.open(make_executor=make_executor)
    hung, _ = await jobs.create(ASSET, LONG, None, "x")
    process = await suspend(jobs, hung.id, shop)
    await jobs.stop()
    await until(lambda: not process.is_alive(), PATIENCE_S)
    left = shop.row(hung.id)
    assert (left.status, left.attempts) == ("queued", 0)


async def test_the_gates_show_signs_of_life_too(shop: Shop) -> None:
    jobs = await shop.open(make_executor=make_executor)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    folder = JobFolder(shop.folder / shown.id)

    def at_gates() -> int | None:
        progress = folder.read_progress()
        return folder.life() if progress is not None and progress.phase == "gates" else None

    await until(at_gates, PATIENCE_S)
    first = at_gates()
    await until(lambda: at_gates() not in (first, None), PATIENCE_S)
    job = await shop.ended(jobs, shown.id)
    assert (job.status, job.attempts) == ("succeeded", 1)
