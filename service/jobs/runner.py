"""Runs jobs in the background: worker, progress, result, and what to do when one of them fails.

Notes in the store what becomes of a job; a job whose row has ended is left alone.
"""

import asyncio
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Executor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import anyio.to_thread
import structlog

from adapters.protocol import Clock
from service.clock import wall_us
from service.documents.interfaces import LivePublisher
from service.domain.job_states import TRANSITIONS, UNFINISHED, JobEvent
from service.jobs.activation import Activations
from service.jobs.comparison import comparable_versions, report_change, with_drift
from service.jobs.documents import ProgressCache, shown
from service.jobs.executor import STALLED_AFTER_WALL_S, WorkerStalledError, watched
from service.jobs.family import relatives_of
from service.jobs.history import AssetHistory
from service.jobs.models import identified_document, machine_of
from service.jobs.worker import JobOrder, JobResult, run_identification
from service.jobs.workers import Worker, Workers
from service.jobs.workspace import JobFolder
from service.live.asset import AssetRuntime
from service.store import AuditEntry, NotOwnerError, Store, StoreUnavailableError
from service.store.records import Job, ModelStatus, ModelVersion
from service.worker_pools import NoWorkerError

STORE_RETRY_WALL_S = 2.0
STOP_WALL_S = 1.0
MOST_ATTEMPTS = 3
#: A job is given up when its worker hangs in this attempt or in a later one.
MOST_STALLED_ATTEMPTS = 2
AUTOMATIC = "automatic"

_log = structlog.get_logger(__name__)


class JobRunner:
    """Some workers, and the jobs that wait for them.

    Parameters
    ----------
    store, clock, bus
        Where rows live, process time, live messages.
    assets : mapping of str to AssetRuntime
        The live twins to be switched.
    histories : mapping of str to AssetHistory
        Where the data of each asset come from.
    make_executor : callable
        Makes the background executor; called again after a worker died or was ended.
    folder : pathlib.Path
        Where the workers' folders are made.
    observe_seconds : callable
        Takes the wall seconds of a job that has ended.
    worker_count : int
        How many jobs run at a time.

    Attributes
    ----------
    stalled_after_wall_s : float
        A worker without a sign of life for this many wall seconds is ended; its job goes on once
        from the checkpoint, then it fails.
    progress : ProgressCache
        What the workers last reported.
    activations : Activations
        Makes a version the active one.
    deciding : asyncio.Lock
        Whether a job is cancelled or its result takes effect is decided for good under this.
    """

    def __init__(
        self,
        store: Store,
        clock: Clock,
        bus: LivePublisher,
        assets: Mapping[str, AssetRuntime],
        histories: Mapping[str, AssetHistory],
        make_executor: Callable[[], Executor],
        folder: Path,
        observe_seconds: Callable[[float], None],
        worker_count: int = 1,
    ) -> None:
        self.stalled_after_wall_s = STALLED_AFTER_WALL_S
        self.progress = ProgressCache()
        self.deciding = asyncio.Lock()
        self.store, self.clock, self.folder = store, clock, folder
        self.assets, self.histories = assets, histories
        self.activations = Activations(store, clock, assets)
        self._bus = bus
        self._make_executor = make_executor
        self._worker_count = worker_count
        self._workers: Workers | None = None
        self._observe_seconds = observe_seconds
        self._tasks: dict[str, asyncio.Task[None]] = {}
        # Jobs whose latest attempt the store broke off, and whose progress it does not have.
        self._interrupted: set[str] = set()
        self._behind: set[str] = set()

    @property
    def started(self) -> bool:
        """Whether there are workers."""
        return self._workers is not None

    @property
    def workers(self) -> Workers:
        """The workers; ask `started` first."""
        if self._workers is None:
            raise RuntimeError("the job manager has not started")
        return self._workers

    def start(self) -> None:
        """Make the workers."""
        self._workers = Workers(self._make_executor, self._worker_count)

    async def stop(self) -> None:
        """End the workers and all that waits for them."""
        for task in self._tasks.values():
            task.cancel()
        if self._tasks:  # one may wait for a store that does not answer
            await asyncio.wait(self._tasks.values(), timeout=STOP_WALL_S)
        if self._workers is not None:
            self._workers.end()

    async def stop_those_of(self, assets: Collection[str]) -> None:
        """End the jobs of some assets as a stop of the service does."""
        tasks = [task for task in self._tasks.values() if task.get_name() in assets]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=STOP_WALL_S)

    def busy(self, asset_id: str) -> bool:
        """Return whether a job of this asset is queued or running here."""
        return any(task.get_name() == asset_id for task in self._tasks.values())

    def begin(self, job: Job) -> None:
        """Have a job run when a worker is free for it; those that people ask for come first."""
        urgent = job.request.get("who") != AUTOMATIC
        task = asyncio.create_task(self._run(job.id, urgent), name=job.asset)
        self._tasks[job.id] = task
        task.add_done_callback(lambda _: self._forget(job.id))

    def _forget(self, job_id: str) -> None:
        self._tasks.pop(job_id, None)
        self._interrupted.discard(job_id)
        self._behind.discard(job_id)

    async def _run(self, job_id: str, urgent: bool) -> None:
        async with self.workers.turn(urgent) as worker:
            folder = JobFolder(self.folder / job_id)
            try:
                while not await self._has_ended(job_id, folder, worker):
                    pass
            finally:
                folder.cancel()  # a worker that is still at it has nothing left to do
            folder.remove()

    async def _has_ended(self, job_id: str, folder: JobFolder, worker: Worker) -> bool:
        """Try once to bring a job to its end; False when it is to be tried again."""
        try:
            job = await anyio.to_thread.run_sync(self.store.jobs.get, job_id)
            if job is None or job.status not in UNFINISHED:
                return True  # cancelled while it waited
            known = await self._model_of(job)
            if known is not None:
                async with self.deciding:
                    await self._take_effect(job, known)
                return True
            if job.attempts >= MOST_ATTEMPTS:
                await self._end(job_id, "fail", f"gave up after {job.attempts} attempts")
                return True
            await self._attempt(job, folder, worker)
        except BrokenProcessPool:
            _log.error("job_worker_died", job=job_id)
            worker.end()
            return False
        except WorkerStalledError as error:
            _log.error("job_worker_stalled", job=job_id, reason=str(error))
            worker.end()
            if job is not None and job.attempts + 1 < MOST_STALLED_ATTEMPTS:
                return False
            await self._end(job_id, "fail", str(error))
        except NoWorkerError as error:
            _log.error("job_without_worker", job=job_id, reason=str(error))
            worker.end()
            await self._end(job_id, "fail", str(error))
        except StoreUnavailableError as error:
            _log.warning("job_waits_for_the_store", job=job_id, error=str(error))
            await asyncio.sleep(STORE_RETRY_WALL_S)
            return False
        except NotOwnerError as error:
            _log.warning("job_left_to_another_cell", job=job_id, reason=str(error))
        except Exception as error:
            # Whatever went wrong in one job is that job's failure, not the service's.
            _log.exception("job_failed", job=job_id)
            await self._end(job_id, "fail", f"{type(error).__name__}: {error}")
        return True

    async def _attempt(self, job: Job, folder: JobFolder, worker: Worker) -> None:
        # The folder comes first: from now on a cancellation leaves its mark there.
        await anyio.to_thread.run_sync(folder.make)
        started = await self.change(
            job.id,
            "start",
            attempts=job.attempts if job.id in self._interrupted else job.attempts + 1,
            progress=0.0,
            started_at_us=self.clock.now_us(),
        )
        if started is None:
            return
        self._interrupted.discard(job.id)
        self.publish(started)
        began = asyncio.get_running_loop().time()
        try:
            await self._finish(started, await self._work(started, folder, worker))
        except StoreUnavailableError:
            self._interrupted.add(job.id)  # the attempt did not fail: it is made again
            raise
        self._observe_seconds(asyncio.get_running_loop().time() - began)

    async def _model_of(self, job: Job) -> ModelVersion | None:
        """Find the version that a job stored before the service was stopped or killed."""
        versions = await anyio.to_thread.run_sync(self.store.models.versions, job.asset)
        return next((one for one in versions if one.document["job"] == job.id), None)

    async def _work(self, job: Job, folder: JobFolder, worker: Worker) -> JobResult | None:
        asset, history = self.assets[job.asset], self.histories[job.asset]
        spans = [(int(start), int(end)) for start, end in job.request["windows_us"]]
        data = await history.identification_data(spans)
        versions = await anyio.to_thread.run_sync(comparable_versions, self.store, job.asset)
        relatives = await anyio.to_thread.run_sync(relatives_of, self.store, asset.settings)
        order = JobOrder(
            folder=folder,
            machine=machine_of(asset.settings),
            data=data,
            active=asset.active.posterior,
            earlier=versions,
            method=job.request["method"],
            seed=job.request["seed"],
            budget=job.request["budget"],
            relatives=relatives,
        )
        future = asyncio.wrap_future(worker.executor.submit(run_identification, order))
        return await watched(
            future,
            folder.life,
            lambda: self.stalled_after_wall_s,
            lambda: self._pass_progress_on(job.id, folder),
        )

    async def _pass_progress_on(self, job_id: str, folder: JobFolder) -> None:
        progress = await anyio.to_thread.run_sync(folder.read_progress)
        if progress is None:
            return
        self.progress.remember(job_id, progress, asyncio.get_running_loop().time())
        try:
            changed = await self.change(
                job_id,
                "progress",
                progress=round(progress.fraction, 4),
                best_fitness=progress.best_fitness,
                evaluations=progress.evaluations,
            )
        except StoreUnavailableError as error:
            # The worker goes on; the row gets what it has done when the store is back.
            if job_id not in self._behind:
                _log.warning("job_progress_waits_for_the_store", job=job_id, error=str(error))
            self._behind.add(job_id)
            return
        self._behind.discard(job_id)
        if changed is not None:
            self.publish(changed)

    async def _finish(self, job: Job, result: JobResult | None) -> None:
        if result is None:
            await self._end(job.id, "cancel", "cancelled")
            return
        document = identified_document(job, result, self.assets[job.asset].settings)
        status: ModelStatus = "candidate" if result.gates.accepted else "rejected"
        async with self.deciding:
            still_wanted = await self.change(
                job.id,
                "progress",
                best_fitness=result.best_fitness,
                evaluations=result.evaluations,
            )
            if still_wanted is None:
                return  # cancelled at the very end: the result must not take effect
            number = await anyio.to_thread.run_sync(
                self.store.models.add,
                job.asset,
                status,
                with_drift(result.gates.reason, result.drift),
                document,
                self.clock.now_us(),
            )
            version = await anyio.to_thread.run_sync(self.store.models.version, job.asset, number)
            if version is None:
                raise RuntimeError(f"model version {number} of {job.asset!r} is gone")
            report_change(job.asset, version, self.assets[job.asset].drift_reported)
            await self._take_effect(still_wanted, version)

    async def _take_effect(self, job: Job, version: ModelVersion) -> None:
        """Activate what may be activated automatically, before the job's end is shown."""
        ladder = self.assets[job.asset].settings.identification.ladder
        if version.status == "candidate" and ladder == "apply":
            number, reason = version.version, version.reason
            line = audit_line("model.activate", f"asset {job.asset}, version {number}", reason)
            # In one transaction: a service that is killed leaves no change without its line.
            await self.activations.activate(
                job.asset, number, AUTOMATIC, reason, force=False, line=line
            )
        ended = await self.change(
            job.id,
            "succeed",
            progress=1.0,
            ended_at_us=self.clock.now_us(),
            model_version=version.version,
        )
        if ended is not None:
            _log.info(
                "job_succeeded",
                asset=job.asset,
                version=version.version,
                status=version.status,
                reason=version.reason,
            )
            self.publish(ended)

    async def _end(self, job_id: str, event: JobEvent, error: str) -> None:
        while True:
            try:
                ended = await self.change(
                    job_id, event, error=error, ended_at_us=self.clock.now_us()
                )
            except StoreUnavailableError as away:
                _log.warning("job_waits_for_the_store", job=job_id, error=str(away))
                await asyncio.sleep(STORE_RETRY_WALL_S)
                continue
            if ended is not None:
                self.publish(ended)
            return

    async def change(self, job_id: str, event: JobEvent, **changes: Any) -> Job | None:
        """Let an event change a job; None when its state is one that the event does not change."""
        transition = TRANSITIONS[event]
        # A service that stops does not wait for a store that does not answer.
        return await anyio.to_thread.run_sync(
            lambda: self.store.jobs.update(
                job_id, only_if=transition.before, status=transition.after, **changes
            ),
            abandon_on_cancel=True,
        )

    def publish(self, job: Job) -> None:
        """Publish the state of a job."""
        self._bus.publish("job", job.asset, shown(job, self.progress.get(job.id)))


def audit_line(action: str, target: str, detail: str = "") -> AuditEntry:
    """Line of the audit trail about what the service does automatically."""
    return AuditEntry(wall_us(), AUTOMATIC, "", action, target, detail)
