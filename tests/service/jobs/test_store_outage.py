"""The store is away while a job runs: that is no failed attempt of the job."""

from pathlib import Path

import pytest
from job_shop import ASSET, QUICK, HeldExecutor, Shop, away, until
from structlog.testing import capture_logs

from service.domain.requests import IdentificationRequest
from service.jobs.executor import make_executor
from service.jobs.workspace import JobFolder

pytestmark = pytest.mark.wires

PATIENCE_S = 180.0
LONG = IdentificationRequest(method="noa", budget=5_000_000)


async def test_progress_that_cannot_be_stored_costs_no_attempt(shop: Shop, tmp_path: Path) -> None:
    jobs = await shop.open(make_executor=make_executor)
    job, _ = await jobs.create(ASSET, LONG, None, "x")
    folder = JobFolder(shop.folder / job.id)
    await until(lambda: shop.row(job.id).evaluations, PATIENCE_S)
    [worker] = jobs.runner.workers.all[0].executor._processes.values()  # type: ignore[union-attr]
    with capture_logs() as logs, away(tmp_path, "jobs"):
        await until(lambda: any("store" in line["event"] for line in logs), PATIENCE_S)
    progress = folder.read_progress()
    assert progress is not None
    await until(lambda: shop.row(job.id).evaluations > progress.evaluations, PATIENCE_S)
    row = shop.row(job.id)
    assert (row.status, row.attempts) == ("running", 1)
    [same] = jobs.runner.workers.all[0].executor._processes.values()  # type: ignore[union-attr]
    assert same.pid == worker.pid, "the worker went on"


async def test_a_result_that_cannot_be_stored_costs_no_attempt(shop: Shop, tmp_path: Path) -> None:
    executor = HeldExecutor()
    jobs = await shop.open(executor)
    job, _ = await jobs.create(ASSET, QUICK, None, "x")
    await until(executor.computed.is_set, PATIENCE_S)
    with capture_logs() as logs, away(tmp_path, "model_versions"):
        executor.let_go.set()
        await until(
            lambda: any(line["event"] == "job_waits_for_the_store" for line in logs), PATIENCE_S
        )
    ended = await shop.ended(jobs, job.id)
    assert (ended.status, ended.attempts) == ("succeeded", 1)
