"""Runs identification jobs in the background and switches the live twin to what passes the gates.

A job is a row in the store. It survives a restart of the service: a job that was queued or running
when the service stopped is taken up again where the worker's last checkpoint left it. None takes
effect twice: a row that has ended never changes, and one whose model version is stored already
goes on from there.
"""

import asyncio
from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise

import anyio.to_thread
import structlog

from service.clock import rfc3339
from service.documents.identification import JobDocument
from service.documents.models import ModelDocument
from service.domain.errors import JobConflictError, KeyUsedBeforeError, RequestRefusedError
from service.domain.requests import IdentificationRequest
from service.jobs.documents import shown
from service.jobs.family import NewSisters, new_sisters
from service.jobs.runner import AUTOMATIC, STOP_WALL_S, JobRunner, audit_line
from service.jobs.workspace import JobFolder, clear_folders
from service.store import ActiveJobError, AuditEntry, Job, NotOwnerError, StoreUnavailableError

_log = structlog.get_logger(__name__)


class IdentificationJobs:
    """The jobs of all assets, at most one unfinished of each.

    Parameters
    ----------
    runner : JobRunner
        Runs them.

    Attributes
    ----------
    ready : asyncio.Event
        Set when what an earlier run left unfinished is taken up.
    """

    def __init__(self, runner: JobRunner) -> None:
        self.runner = runner
        self._store, self._clock, self._assets = runner.store, runner.clock, runner.assets
        self.ready = asyncio.Event()

    @property
    def switching(self) -> asyncio.Lock:
        """Held while a twin and its version change."""
        return self.runner.activations.switching

    # ------------------------------------------------------------------ life
    async def start(self) -> None:
        """Take up the jobs that an earlier run of the service left unfinished."""
        self.runner.start()
        unfinished = await anyio.to_thread.run_sync(self._store.jobs.unfinished)
        kept = {job.id for job in unfinished}
        await anyio.to_thread.run_sync(clear_folders, self.runner.folder, kept)
        await self._begin_again([job for job in unfinished if job.asset in self._assets])
        self.ready.set()

    async def resume(self, assets: Collection[str]) -> None:
        """Take up the unfinished jobs of assets that are followed from now on.

        Before `start` there is nothing to do: it takes up all.
        """
        if not self.runner.started:
            return
        unfinished = await anyio.to_thread.run_sync(self._store.jobs.unfinished)
        await self._begin_again([job for job in unfinished if job.asset in assets])

    async def _begin_again(self, jobs: Iterable[Job]) -> None:
        for job in jobs:
            if self.runner.busy(job.asset):
                continue
            await self.runner.change(job.id, "interrupt", progress=0.0)
            self.runner.begin(job)

    async def stop(self) -> None:
        """Stop the workers; what was running waits in the store for the next start."""
        await self.runner.stop()
        await self._interrupt(None)

    async def leave(self, assets: Collection[str]) -> None:
        """Leave the jobs of some assets to another cell, which takes them up again."""
        await self.runner.stop_those_of(assets)
        await self._interrupt(assets)

    async def _interrupt(self, assets: Collection[str] | None) -> None:
        """Have the jobs of these assets, or of all, wait in the store for the cell that goes on."""
        try:
            async with asyncio.timeout(STOP_WALL_S):
                for job in await anyio.to_thread.run_sync(
                    self._store.jobs.unfinished, abandon_on_cancel=True
                ):
                    if job.asset not in (self._assets if assets is None else assets):
                        continue
                    # A clean stop is no failed attempt.
                    await self.runner.change(
                        job.id, "interrupt", progress=0.0, attempts=max(job.attempts - 1, 0)
                    )
        except (StoreUnavailableError, NotOwnerError, TimeoutError) as error:
            _log.warning("jobs_left_running", error=str(error))  # the next start takes them up

    async def end(self, assets: Collection[str]) -> None:
        """Cancel the jobs of assets that are followed no longer."""
        for job in await anyio.to_thread.run_sync(self._store.jobs.unfinished):
            if job.asset in assets:
                await self.cancel(job.asset, job.id)

    # ------------------------------------------------------------------ the API's side
    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
        audit: AuditEntry | None = None,
    ) -> tuple[JobDocument, bool]:
        """Queue a job; returns it and whether it is new (False: the idempotency key matched).

        Raises
        ------
        JobConflictError
            While another job runs for this asset.
        RequestRefusedError
            When the request cannot be served, for example windows without data.
        KeyUsedBeforeError
            When the idempotency key stands for another request.
        """
        windows = await self._windows(asset_id, request)
        document = {
            "windows": [{"start": rfc3339(start), "end": rfc3339(end)} for start, end in windows],
            "windows_us": windows,
            "method": request.method,
            "seed": request.seed,
            "budget": request.budget,
            "who": who,
            "asked": request.model_dump(mode="json"),
        }
        if who == AUTOMATIC:
            audit = audit_line("identification.start", f"asset {asset_id}")
        try:
            job, created = await anyio.to_thread.run_sync(
                self._store.jobs.add,
                asset_id,
                document,
                self._clock.now_us(),
                idempotency_key,
                audit,
            )
        except ActiveJobError as error:
            running = await anyio.to_thread.run_sync(self._store.jobs.get, error.job_id)
            if running is None:
                raise
            raise JobConflictError(
                f"identification {running.id} is {running.status}", shown(running)
            ) from error
        if not created and job.request.get("asked", document["asked"]) != document["asked"]:
            raise KeyUsedBeforeError(
                f"belongs to identification {job.id}, which was requested with another body; "
                "expected the same body, or a new key"
            )
        if created:
            _log.info("job_queued", asset=asset_id, job=job.id, who=who, windows=len(windows))
            self.runner.publish(job)
            self.runner.begin(job)
        return shown(job), created

    async def new_sisters(self, asset_id: str) -> NewSisters:
        """Name the sisters that an asset should be identified again for; mostly none."""
        asset = self._assets[asset_id]
        return await anyio.to_thread.run_sync(
            new_sisters, self._store, asset.settings, asset.active.posterior
        )

    async def _windows(
        self, asset_id: str, request: IdentificationRequest
    ) -> list[tuple[int, int]]:
        history = self.runner.histories[asset_id]
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
        spans = sorted((span.start, span.end) for span in request.windows)
        for (_, end_us), (start_us, _) in pairwise(spans):
            if start_us < end_us:
                raise RequestRefusedError(
                    "/windows",
                    f"the window that begins at {rfc3339(start_us)} overlaps another; data that "
                    "count twice would make the intervals too narrow",
                )
        return spans

    async def job(self, asset_id: str, job_id: str) -> JobDocument | None:
        """Return one job; None when the asset has no such job."""
        job = await anyio.to_thread.run_sync(self._store.jobs.get, job_id)
        if job is None or job.asset != asset_id:
            return None
        document = shown(job, self.runner.progress.get(job_id), convergence=True)
        if job.model_version is None:
            return document
        # The model version has the whole course; the last report of progress ends somewhat before.
        version = await anyio.to_thread.run_sync(
            self._store.models.version, asset_id, job.model_version
        )
        kept = version.document if version is not None else {}
        names = {"convergence", "active_fitness"} & kept.keys()
        return document.model_copy(update={name: kept[name] for name in names})

    async def jobs(self, asset_id: str) -> Sequence[JobDocument]:
        """Jobs of an asset, newest first."""
        jobs = await anyio.to_thread.run_sync(self._store.jobs.of_asset, asset_id)
        return [shown(job, self.runner.progress.get(job.id)) for job in jobs]

    async def cancel(
        self, asset_id: str, job_id: str, audit: AuditEntry | None = None
    ) -> JobDocument | None:
        """Stop a job that has not ended; the answer shows its present state."""
        job = await anyio.to_thread.run_sync(self._store.jobs.get, job_id)
        if job is None or job.asset != asset_id:
            return None
        async with self.runner.deciding:
            cancelled = await self.runner.change(
                job_id, "cancel", ended_at_us=self._clock.now_us(), error="cancelled", line=audit
            )
        if cancelled is None:  # it had ended before
            return await self.job(asset_id, job_id)
        await anyio.to_thread.run_sync(JobFolder(self.runner.folder / job_id).cancel)
        self.runner.publish(cancelled)
        return shown(cancelled, self.runner.progress.get(job_id))

    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        audit: AuditEntry | None = None,
    ) -> ModelDocument:
        """Make a version the active one and switch the live twin to it.

        Raises
        ------
        ActivationRefusedError
            When the version was rejected and is not forced.
        KeyError
            When there is no such version.
        """
        return await self.runner.activations.activate(asset_id, version, who, comment, force, audit)

    def busy(self, asset_id: str) -> bool:
        """Return whether a job of this asset is queued or running in this service."""
        return self.runner.busy(asset_id)
