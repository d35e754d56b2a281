"""Identifies the machines of a fleet in one night: each asset once, also where a process is killed.

Each result is stored as soon as it is there, under asset and night: a run that was stopped goes on
where it ended, and a second run of the same night finds nothing to do.
"""

import asyncio
import contextlib
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Final
from uuid import uuid4

import structlog
from anyio.to_thread import run_sync as in_thread

from service.clock import wall_us
from service.domain.errors import ServiceError
from service.features.nights.account import (
    FleetIdentification,
    IdentifiedAsset,
    summary,
)
from service.features.nights.batch_executors import BatchExecutor, BatchFailedError, WorkerLostError
from service.features.nights.batches import (
    MachineOrder,
    MachineResult,
    packed_orders,
    unpacked_results,
)
from service.features.nights.night import Night, Prepared, store_result
from service.features.nights.results import Nights
from service.features.nights.tables import MAX_PROBLEMS, FleetRun, FleetRuns
from service.jobs.comparison import comparable_versions, earlier_versions
from service.jobs.family import relatives_of
from service.jobs.history import AssetHistory
from service.jobs.models import machine_of, prior, why_not_of_this_asset
from service.site.asset_section import AssetSection
from service.store.records import Job, ModelVersion
from twin_core.identification.posterior import Posterior

#: A batch whose worker died so often is divided, to find the machine that kills it.
MAX_ATTEMPTS: Final = 3
#: A worker that dies takes a batch with it: few enough that it costs little, and enough that a
#: worker is busy for longer than it takes to hand it the next one.
SIZE_MIN, SIZE_MAX = 4, 16
_BATCHES_PER_WORKER = 8
#: Wall seconds between two reports on how far a run is.
REPORT_EVERY_S: Final = 5.0

_log = structlog.get_logger(__name__)


def night_of(now: datetime) -> str:
    """Name the night of a local time: the date of the evening; it ends at noon."""
    return (now - timedelta(hours=12)).date().isoformat()


def batches_of(assets: Sequence[AssetSection], worker_count: int) -> list[Sequence[AssetSection]]:
    """Divide assets into batches, so many that all workers end at about the same time."""
    size = min(max(len(assets) // (_BATCHES_PER_WORKER * worker_count), SIZE_MIN), SIZE_MAX)
    return [assets[first : first + size] for first in range(0, len(assets), size)]


async def identify_fleet(
    night: Night,
    assets: Sequence[AssetSection],
    executor: BatchExecutor,
    progress: Callable[[float, str], None],
    wrong: Mapping[str, str],
    so_far: Callable[[FleetIdentification], None] = lambda found: None,
) -> FleetIdentification:
    """Identify all machines that have no result of this night.

    What it did and cost becomes a line of the audit trail, also where it is stopped or fails.

    Parameters
    ----------
    night
        Store, clock and name of the night.
    assets
        Whose machines.
    executor
        Computes the batches.
    progress
        Called with the fraction done and a few words.
    wrong
        Assets that cannot be identified, and why.
    so_far
        Called at the end, also where it is stopped or fails, with what was done until then.

    Raises
    ------
    ServiceError
        If store or workers are offline; what was identified until then is stored.
    """
    run = _Run(night, executor, progress)
    reporting = asyncio.create_task(run.report())
    try:
        await run.run(assets, wrong)
    finally:
        reporting.cancel()
        await asyncio.wait({reporting})
        await run.all_kept()
        found = run.account()
        so_far(found)
        run.report_end()
        if found.machines:
            with contextlib.suppress(ServiceError):  # the store may be what is offline
                night.store.audit.add(night.audit("fleet.identify", night.chosen, summary(found)))
    numbers = await in_thread(night.store.models.active_numbers)
    items = [
        one.model_copy(update={"active": one.model_version == numbers.get(one.asset, 0)})
        for one in found.items
    ]
    return found.model_copy(update={"items": items})


class _Run:
    def __init__(
        self, night: Night, executor: BatchExecutor, progress: Callable[[float, str], None]
    ) -> None:
        self._night, self._executor, self._progress = night, executor, progress
        self._nights = night.store.part(Nights)
        self._waiting: deque[Sequence[AssetSection]] = deque()
        self._items: dict[str, IdentifiedAsset] = {}
        self._keeping: set[asyncio.Task[None]] = set()
        self._worker_s = 0.0
        self._refused = self._without_new_data = 0
        self._id, self._began_us = uuid4().hex, wall_us()
        self._names: list[str] = []
        self._began_s, self._began_processor_s = time.monotonic(), time.process_time()

    async def run(self, assets: Sequence[AssetSection], wrong: Mapping[str, str]) -> None:
        workers = self._executor.worker_count
        self._names = [*(asset.id for asset in assets), *wrong]
        for name, why in wrong.items():
            self._note(IdentifiedAsset(asset=name, status="failed", reason=why))
        done = await in_thread(self._nights.done, self._night.name, [one.id for one in assets])
        for job in done.values():
            self._note(_done_before(job))
        self._waiting.extend(
            batches_of([asset for asset in assets if asset.id not in done], workers)
        )
        # One batch is read from the store while another one is computed.
        try:
            async with asyncio.TaskGroup() as group:
                for _ in range(min(2 * workers, len(self._waiting))):
                    group.create_task(self._work())
        except BaseExceptionGroup as failures:
            raise _first(failures) from None

    def account(self) -> FleetIdentification:
        """Give what was done so far, in the order in which the assets were asked for."""
        items = [self._items[name] for name in self._names if name in self._items]
        counts = Counter(one.status for one in items)
        machines = counts["identified"]
        seconds = time.monotonic() - self._began_s
        return FleetIdentification(
            night=self._night.name,
            executor=self._executor.name,
            workers=self._executor.worker_count,
            workers_lost=self._executor.workers_lost,
            machines=machines,
            warm_starts=sum(bool(one.warm_start) for one in items),
            done_before=counts["done before"],
            skipped=counts["skipped"],
            failed=counts["failed"],
            seconds=seconds,
            processor_seconds=self._worker_s + time.process_time() - self._began_processor_s,
            seconds_per_machine=seconds / machines if machines else None,
            items=items,
        )

    async def report(self) -> None:
        """Keep in the store how far the run is, until cancelled."""
        while True:
            # A store that is offline ends the run, which is not done here.
            with contextlib.suppress(ServiceError):
                await in_thread(self._night.store.part(FleetRuns).save, self._how_far(None))
            await asyncio.sleep(REPORT_EVERY_S)

    def report_end(self) -> None:
        """Keep in the store how the run has ended."""
        with contextlib.suppress(ServiceError):
            self._night.store.part(FleetRuns).save(self._how_far(wall_us()))

    def _how_far(self, ended_us: int | None) -> FleetRun:
        found = self.account()
        failed = [one for one in found.items if one.status == "failed"]
        return FleetRun(
            id=self._id,
            night=found.night,
            chosen=self._night.chosen,
            executor=found.executor,
            workers=found.workers,
            workers_lost=found.workers_lost,
            asked=len(self._names),
            identified=found.machines,
            warm_starts=found.warm_starts,
            refused=self._refused,
            done_before=found.done_before,
            skipped=found.skipped,
            without_new_data=self._without_new_data,
            failed=found.failed,
            processor_s=found.processor_seconds,
            began_us=self._began_us,
            told_us=wall_us(),
            ended_us=ended_us,
            problems={one.asset: one.reason for one in failed[:MAX_PROBLEMS]},
        )

    async def _work(self) -> None:
        while self._waiting:
            batch = self._waiting.popleft()
            prepared = await self._prepared(batch)
            if not prepared:
                continue
            results = await self._results([one.order for one in prepared.values()])
            for result in results:
                with self._guarding(result.asset):
                    # What is being stored is counted, also where the run ends meanwhile.
                    keeping = asyncio.create_task(self._keep(prepared[result.asset], result))
                    self._keeping.add(keeping)
                    keeping.add_done_callback(self._kept)
                    await asyncio.shield(keeping)

    async def all_kept(self) -> None:
        """Wait until no result is being stored any more."""
        if self._keeping:
            await asyncio.wait(self._keeping)

    def _kept(self, keeping: "asyncio.Task[None]") -> None:
        self._keeping.discard(keeping)
        if not keeping.cancelled():
            keeping.exception()  # raised where it is waited for, if the run goes on

    def _note(self, item: IdentifiedAsset) -> None:
        self._items[item.asset] = item
        done = len(self._items)
        self._progress(done / max(len(self._names), 1), f"{done} of {len(self._names)}")

    @contextlib.contextmanager
    def _guarding(self, asset: str) -> Iterator[None]:
        """Let an error be that of one machine, unless store or workers are offline."""
        try:
            yield
        except ServiceError:
            raise
        except Exception as error:
            _log.exception("machine_failed", asset=asset)
            reason = f"{type(error).__name__}: {error}"
            self._note(IdentifiedAsset(asset=asset, status="failed", reason=reason))

    # ------------------------------------------------------------------ what goes to a worker
    async def _prepared(self, batch: Sequence[AssetSection]) -> dict[str, Prepared]:
        names = [asset.id for asset in batch]
        nights = self._nights
        # Asked again: the first look may be hours ago.
        done = await in_thread(nights.done, self._night.name, names)
        busy = await in_thread(nights.busy, names)
        latest = await in_thread(nights.latest, names)
        prepared = {}
        for asset in batch:
            if asset.id in done:
                self._note(_done_before(done[asset.id]))
            elif asset.id in busy:
                job = busy[asset.id]
                self._note(_skipped(asset.id, f"identification {job.id} is {job.status}"))
            else:
                with self._guarding(asset.id):
                    one = await self._order(asset, latest.get(asset.id))
                    if one is not None:
                        prepared[asset.id] = one
        return prepared

    async def _order(self, asset: AssetSection, latest: Job | None) -> Prepared | None:
        store, clock = self._night.store, self._night.clock
        history = AssetHistory(asset, store, clock)
        windows = await history.windows()
        if not windows:
            self._note(_skipped(asset.id, "no low-risk window in the store"))
            return None
        spans_us = [history.span_us(window) for window in windows]
        versions = await in_thread(comparable_versions, store, asset.id)
        active = next((one for one in versions if one.status == "active"), None)
        if active is None:  # it may be older
            active = await in_thread(store.models.active, asset.id)
        is_of_another = active is not None and why_not_of_this_asset(asset, active) is not None
        if latest is not None and not is_of_another and not _has_news(latest, spans_us, active):
            self._without_new_data += 1
            night = (latest.idempotency_key or "").partition(" ")[2]
            self._note(_skipped(asset.id, f"no new low-risk data since the night of {night}"))
            return None
        try:
            data = await history.identification_data(spans_us)
        except ValueError as error:
            self._note(_skipped(asset.id, str(error)))
            return None
        posterior = prior(asset)
        if active is not None and not is_of_another:
            posterior = Posterior.from_dict(active.document["posterior"])
        # Without its samples, which no gate asks for and which are most of it.
        posterior = replace(posterior, samples=posterior.samples[:0])
        order = MachineOrder(
            asset.id,
            machine_of(asset),
            data,
            posterior,
            earlier_versions(versions),
            relatives=await in_thread(relatives_of, store, asset),
        )
        return Prepared(order, asset, spans_us, active, clock.now_us())

    async def _results(self, orders: Sequence[MachineOrder]) -> list[MachineResult]:
        content = await in_thread(packed_orders, orders)
        reason = f"{MAX_ATTEMPTS} workers died of it"
        for _ in range(MAX_ATTEMPTS):
            try:
                found = await self._executor.compute(content)
            except WorkerLostError as error:
                _log.warning("batch_worker_lost", machines=len(orders), reason=str(error))
                continue
            except BatchFailedError as error:
                reason = str(error)
                _log.warning("batch_failed", machines=len(orders), reason=reason)
                break
            return await in_thread(unpacked_results, found)
        if len(orders) == 1:
            self._note(IdentifiedAsset(asset=orders[0].asset, status="failed", reason=reason))
            return []
        half = len(orders) // 2
        return [*await self._results(orders[:half]), *await self._results(orders[half:])]

    # ------------------------------------------------------------------ what comes back
    async def _keep(self, prepared: Prepared, result: MachineResult) -> None:
        self._worker_s += result.processor_seconds
        stored = await in_thread(store_result, self._night, prepared, result)
        if stored is None:  # another run was quicker
            names = [result.asset]
            done = await in_thread(self._nights.done, self._night.name, names)
            self._note(_done_before(done[result.asset]))
            return
        self._refused += result.found is not None and not result.found.gates.accepted
        self._note(
            IdentifiedAsset(
                asset=result.asset,
                status="failed" if result.found is None else "identified",
                model_version=stored.model_version,
                reason=result.error if result.found is None else result.found.gates.reason,
                warm_start=None if result.found is None else result.method == "refine",
                seconds=result.seconds,
            )
        )


def _has_news(
    latest: Job, spans_us: Sequence[tuple[int, int]], active: ModelVersion | None
) -> bool:
    """Whether an asset is worth another identification after its last night."""
    if latest.status != "succeeded":
        return True
    # A version that became active later says that something else has changed.
    if active is not None and active.version > (latest.model_version or 0):
        return True
    before_us = max(int(end_us) for _, end_us in latest.request["windows_us"])
    return max(end_us for _, end_us in spans_us) > before_us


def _done_before(job: Job) -> IdentifiedAsset:
    return IdentifiedAsset(
        asset=job.asset,
        status="failed" if job.status == "failed" else "done before",
        model_version=job.model_version,
        reason=job.error or "",
    )


def _skipped(asset: str, reason: str) -> IdentifiedAsset:
    return IdentifiedAsset(asset=asset, status="skipped", reason=reason)


def _first(failures: BaseExceptionGroup[BaseException]) -> BaseException:
    first = failures.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first
