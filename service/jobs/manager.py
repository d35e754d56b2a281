"""Runs identification jobs in the background and switches the live twin to what passes the gates.

A job is a row in the store. It survives a restart of the service: a job that was queued or running
when the service stopped is taken up again, and because a row that has ended never changes, none
takes effect twice.
"""

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import anyio.to_thread
import structlog

from adapters.drivers import Clock
from service.api.context import (
    ActivationRefusedError,
    IdentificationRequest,
    JobConflictError,
    RequestRefusedError,
)
from service.clock import rfc3339
from service.jobs.history import AssetHistory
from service.jobs.models import active_model, identified_document, model_json
from service.jobs.worker import JobOrder, JobResult, run_identification
from service.jobs.workspace import JobFolder
from service.live.asset import AssetRuntime
from service.live.bus import Bus
from service.store import ActiveJobError, Store
from service.store.records import Job, ModelStatus

PROGRESS_EVERY_WALL_S = 0.4
MOST_ATTEMPTS = 3
AUTOMATIC = "automatic"

_log = structlog.get_logger(__name__)


class IdentificationJobs:
    """The jobs of all assets; one worker runs them one after the other.

    Parameters
    ----------
    store, clock, bus
        Where rows live, process time, live messages.
    assets : mapping of str to AssetRuntime
        The live twins to be switched.
    histories : mapping of str to AssetHistory
        Where the data of each asset come from.
    make_executor : callable
        Makes the background executor; called again after a worker died.
    folder : pathlib.Path
        Where the workers' folders are made.
    """

    def __init__(
        self,
        store: Store,
        clock: Clock,
        bus: Bus,
        assets: Mapping[str, AssetRuntime],
        histories: Mapping[str, AssetHistory],
        make_executor: Callable[[], Executor],
        folder: Path,
        observe_seconds: Callable[[float], None],
    ) -> None:
        self._store = store
        self._clock = clock
        self._bus = bus
        self._assets = assets
        self._histories = histories
        self._make_executor = make_executor
        self._executor: Executor | None = None
        self._folder = folder
        self._observe_seconds = observe_seconds
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._one_at_a_time = asyncio.Lock()

    # ------------------------------------------------------------------ life
    async def start(self) -> None:
        """Take up the jobs that an earlier run of the service left unfinished."""
        self._executor = self._make_executor()
        for job in await anyio.to_thread.run_sync(self._store.unfinished_jobs):
            if job.asset not in self._assets:
                continue
            if job.status == "running":
                await self._update(job.id, only_if=["running"], status="queued", progress=0.0)
            self._begin(job)

    async def stop(self) -> None:
        """Stop the workers; what was running waits in the store for the next start."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        self._shut_down_executor()
        for job in await anyio.to_thread.run_sync(self._store.unfinished_jobs):
            # A clean stop is no failed attempt.
            await self._update(
                job.id,
                only_if=["running"],
                status="queued",
                progress=0.0,
                attempts=max(job.attempts - 1, 0),
            )

    # ------------------------------------------------------------------ the API's side
    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
    ) -> tuple[Mapping[str, Any], bool]:
        """Queue a job; see `service.api.context.JobManager`."""
        windows = await self._windows(asset_id, request)
        document = {
            "windows": [{"start": rfc3339(start), "end": rfc3339(end)} for start, end in windows],
            "windows_us": windows,
            "method": request.method,
            "seed": request.seed,
            "budget": request.budget,
            "who": who,
        }
        try:
            job, created = await anyio.to_thread.run_sync(
                self._store.add_job, asset_id, document, self._clock.now_us(), idempotency_key
            )
        except ActiveJobError as error:
            running = await anyio.to_thread.run_sync(self._store.job, error.job_id)
            if running is None:
                raise
            raise JobConflictError(job_json(running)) from error
        if created:
            _log.info("job_queued", asset=asset_id, job=job.id, who=who, windows=len(windows))
            self._publish(job)
            self._begin(job)
        return job_json(job), created

    async def _windows(
        self, asset_id: str, request: IdentificationRequest
    ) -> list[tuple[int, int]]:
        history = self._histories[asset_id]
        if request.windows == "auto":
            found = await history.windows()
            if not found:
                raise RequestRefusedError(
                    "/windows",
                    "no low-risk window in the store yet; expected at least 30 min of good data "
                    "inside the low-risk region",
                )
            return [history.span_us(window) for window in found]
        for number, span in enumerate(request.windows):
            problem = await history.problem_with(span.start, span.end)
            if problem:
                raise RequestRefusedError(f"/windows/{number}", problem)
        return [(span.start, span.end) for span in request.windows]

    async def job(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        """Return one job; None when the asset has no such job."""
        job = await anyio.to_thread.run_sync(self._store.job, job_id)
        return job_json(job) if job is not None and job.asset == asset_id else None

    async def jobs(self, asset_id: str) -> Sequence[Mapping[str, Any]]:
        """Jobs of an asset, newest first."""
        return [job_json(job) for job in await anyio.to_thread.run_sync(self._store.jobs, asset_id)]

    async def cancel(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        """Stop a job that has not ended; the answer shows its present state."""
        job = await anyio.to_thread.run_sync(self._store.job, job_id)
        if job is None or job.asset != asset_id:
            return None
        changed = await self._update(
            job_id, status="cancelled", ended_at_us=self._clock.now_us(), error="cancelled"
        )
        JobFolder(self._folder / job_id).cancel()
        if changed is not None and job.status == "queued" and job_id in self._tasks:
            self._tasks[job_id].cancel()
        return job_json(changed or job)

    async def activate(
        self, asset_id: str, version: int, who: str, comment: str | None, force: bool
    ) -> Mapping[str, Any]:
        """Make a version the active one and switch the live twin to it."""
        model = await anyio.to_thread.run_sync(self._store.model_version, asset_id, version)
        if model is None:
            raise KeyError(version)
        if model.status == "rejected" and not (force and comment):
            raise ActivationRefusedError(
                f"version {version} was rejected ({model.reason}); "
                'expected {"force": true} with a comment to activate it all the same'
            )
        asset = self._assets[asset_id]
        activated = await anyio.to_thread.run_sync(
            self._store.activate,
            asset_id,
            version,
            who,
            comment or f"activated by {who}",
            self._clock.now_us(),
        )
        asset.switch(active_model(asset.settings, activated))
        return model_json(activated)

    def busy(self, asset_id: str) -> bool:
        """Tell whether a job of this asset is queued or running in this service."""
        return any(task.get_name() == asset_id for task in self._tasks.values())

    # ------------------------------------------------------------------ running
    def _begin(self, job: Job) -> None:
        task = asyncio.create_task(self._run(job), name=job.asset)
        self._tasks[job.id] = task
        task.add_done_callback(lambda _: self._tasks.pop(job.id, None))

    async def _run(self, job: Job) -> None:
        async with self._one_at_a_time:
            folder = JobFolder(self._folder / job.id)
            try:
                await self._attempts(job, folder)
            finally:
                folder.cancel()  # a worker that is still at it has nothing left to do
            folder.remove()

    async def _attempts(self, job: Job, folder: JobFolder) -> None:
        for attempt in range(job.attempts + 1, MOST_ATTEMPTS + 1):
            started = await self._update(
                job.id,
                status="running",
                attempts=attempt,
                progress=0.0,
                started_at_us=self._clock.now_us(),
            )
            if started is None:
                return  # cancelled while it waited
            self._publish(started)
            began = asyncio.get_running_loop().time()
            try:
                result = await self._work(started, folder)
                await self._finish(started, result)
                self._observe_seconds(asyncio.get_running_loop().time() - began)
                return
            except BrokenProcessPool:
                _log.error("job_worker_died", job=job.id, attempt=attempt)
                self._shut_down_executor()
                self._executor = self._make_executor()
            except Exception as error:
                # Whatever went wrong in one job is that job's failure, not the service's.
                _log.exception("job_failed", job=job.id)
                await self._end(job.id, "failed", f"{type(error).__name__}: {error}")
                return
        await self._end(job.id, "failed", f"the worker process died {MOST_ATTEMPTS} times")

    async def _work(self, job: Job, folder: JobFolder) -> JobResult:
        asset, history = self._assets[job.asset], self._histories[job.asset]
        spans = [(int(start), int(end)) for start, end in job.request["windows_us"]]
        data = await history.identification_data(spans)
        await anyio.to_thread.run_sync(folder.make)
        order = JobOrder(
            folder=folder,
            model_name=asset.settings.model,
            bearing=asset.settings.bearing,
            data=data,
            active=asset.active.posterior.to_dict(),
            method=job.request["method"],
            seed=job.request["seed"],
            budget=job.request["budget"],
        )
        if self._executor is None:
            raise RuntimeError("the job manager has not started")
        future = asyncio.wrap_future(self._executor.submit(run_identification, order))
        while True:
            done, _ = await asyncio.wait([future], timeout=PROGRESS_EVERY_WALL_S)
            if done:
                return future.result()
            await self._pass_progress_on(job.id, folder)

    async def _pass_progress_on(self, job_id: str, folder: JobFolder) -> None:
        progress = await anyio.to_thread.run_sync(folder.read_progress)
        if progress is None:
            return
        changed = await self._update(
            job_id,
            only_if=["running"],
            progress=round(progress.fraction, 4),
            best_fitness=progress.best_fitness,
            evaluations=progress.evaluations,
        )
        if changed is not None:
            self._publish(changed, phase=progress.phase)

    async def _finish(self, job: Job, result: JobResult) -> None:
        if result.cancelled:
            await self._end(job.id, "cancelled", "cancelled")
            return
        current = await anyio.to_thread.run_sync(self._store.job, job.id)
        if current is None or current.status != "running":
            return  # cancelled at the very end: the result must not take effect
        asset = self._assets[job.asset]
        document = identified_document(job, result, asset.settings)
        status: ModelStatus = "candidate" if result.accepted else "rejected"
        version = await anyio.to_thread.run_sync(
            self._store.add_model_version,
            job.asset,
            status,
            result.reason,
            document,
            self._clock.now_us(),
        )
        ended = await self._update(
            job.id,
            status="succeeded",
            progress=1.0,
            best_fitness=result.best_fitness,
            evaluations=result.evaluations,
            ended_at_us=self._clock.now_us(),
            model_version=version,
        )
        if ended is None:
            return
        _log.info(
            "job_succeeded", asset=job.asset, version=version, status=status, reason=result.reason
        )
        if result.accepted and asset.settings.identification.ladder == "apply":
            await self.activate(job.asset, version, AUTOMATIC, result.reason, force=False)
        self._publish(ended)

    async def _end(self, job_id: str, status: Any, error: str) -> None:
        ended = await self._update(
            job_id, status=status, error=error, ended_at_us=self._clock.now_us()
        )
        if ended is not None:
            self._publish(ended)

    async def _update(self, job_id: str, **changes: Any) -> Job | None:
        updated = await anyio.to_thread.run_sync(lambda: self._store.update_job(job_id, **changes))
        if updated is not None and updated.status == "cancelled":
            self._publish(updated)
        return updated

    def _publish(self, job: Job, phase: str | None = None) -> None:
        self._bus.publish("job", job.asset, job_json(job) | {"phase": phase})

    def _shut_down_executor(self) -> None:
        if self._executor is None:
            return
        # A worker in the middle of a computation cannot be asked politely in time: end it. The
        # public API to do so (terminate_workers) exists from Python 3.14 only.
        processes = list((getattr(self._executor, "_processes", None) or {}).values())
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()


def job_json(job: Job) -> dict[str, Any]:
    """A job in the shape of the REST contract."""
    return {
        "id": job.id,
        "status": job.status,
        "progress": job.progress,
        "best_fitness": job.best_fitness,
        "evaluations": job.evaluations,
        "created_at": rfc3339(job.created_at_us),
        "started_at": rfc3339(job.started_at_us) if job.started_at_us is not None else None,
        "ended_at": rfc3339(job.ended_at_us) if job.ended_at_us is not None else None,
        "error": job.error,
        "model_version": job.model_version,
        "windows": job.request["windows"],
        "method": job.request["method"],
        "seed": job.request["seed"],
        "requested_by": job.request["who"],
        "attempts": job.attempts,
    }
