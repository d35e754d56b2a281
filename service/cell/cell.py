"""The cell with an open store: live twins, jobs and alarms, and the bus to all others."""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import fields
from functools import partial

import structlog
from anyio import to_thread
from prometheus_client import Histogram

from service.alarms.records import assets_of
from service.bus import commands
from service.bus.calls import answering
from service.bus.interface import CellBus, Handlers
from service.bus.messages import CellState
from service.bus.stream import heartbeats
from service.cell.absences import Absences
from service.cell.acquisition import Acquisition
from service.cell.answers import (
    AlarmAnswers,
    AssetAnswers,
    PushAnswers,
    StreamAnswers,
    handlers_of,
)
from service.cell.cell_clock import CellClock
from service.cell.core import Core
from service.cell.followed import FollowedAssets
from service.cell.health import Health
from service.cell.kernels import Kernels
from service.cell.retention import StoreMaintenance
from service.cell.self_check import SelfCheck, report_unconfigured
from service.cell.share import Share
from service.cell.stored_assets import AssetActions, StoredAssets
from service.feature_folders import modules
from service.jobs.automatic import identify_automatically
from service.jobs.executor import make_executor
from service.jobs.manager import IdentificationJobs
from service.jobs.runner import JobRunner
from service.site.asset_tables import CheckedAsset
from service.site.settings import Settings
from service.site.wiring import Wiring
from service.store import Outbox, Retention, Store, StoreUnavailableError
from service.tasks import Part, Working

STORE_RETRY_WALL_S = 2.0
STATE_EVERY_S = 0.25
_KEPT = "The asset does not fit the configuration; it is followed by the templates before"

_log = structlog.get_logger(__name__)


class Cell:
    """What follows the machines: a list of parts that start in their order.

    It is made in a thread, since it reads from the store.

    Parameters
    ----------
    settings : Settings
        The checked configuration.
    wiring : Wiring
        The configuration's sources and channels, from `service.site.wiring.wire`.
    store, outbox
        Open store, and where changes of alarms wait for it.
    clock, acquisition
        Process time, and what brings the samples.
    bus : CellBus
        Where others follow and ask.
    kernels : Kernels
        The compiled kernels; estimates and forecasts begin when they are there.
    share : Share, optional
        Which assets this cell follows, where several cells share them; None: all.

    Attributes
    ----------
    core : Core
        What the parts are made of, and the assets that are followed.
    handlers : mapping of type to callable
        What answers which command.

    Raises
    ------
    StoreUnavailableError
        If the store does not answer.
    """

    def __init__(
        self,
        settings: Settings,
        wiring: Wiring,
        store: Store,
        outbox: Outbox,
        clock: CellClock,
        acquisition: Acquisition,
        bus: CellBus,
        kernels: Kernels,
        share: Share | None = None,
    ) -> None:
        core = self.core = Core(settings, store, outbox, clock, acquisition, bus, kernels, share)
        core.jobs = _jobs_of(core)
        absences = Absences(store, outbox, acquisition.ingest, core.alarms, clock)
        documents = AssetAnswers(core.assets, self._apply_changes)
        self._followed = FollowedAssets(core, core.jobs, absences, documents)
        actions = AssetActions(self._followed.change, self._followed.read_for)
        self._stored_assets = StoredAssets(settings, store, actions, share)
        maintenance = _maintenance_of(core)
        self_check = SelfCheck(core, maintenance, self._stored_assets)
        health = _health_of(core, self_check, self._stored_assets)
        core.parts += [
            self._followed,
            Working("stored assets", self._follow_stored),
            _Jobs(core),
            kernels,
            Working("models", core.jobs.runner.activations.follow),
            *(absences, self_check, health),
            *(feature.part(core) for _, feature in modules("part")),
            Working("heartbeat", partial(heartbeats, core.live)),
            maintenance,
            Working("check of the store", maintenance.check),
            Working("bus", lambda: bus.serve(self.handlers)),
            Working("state", self._report),
        ]
        core.parts.sort(key=lambda part: not part.is_first)
        self.handlers = self._handlers(documents, health)
        self._begin(wiring, absences)

    def _handlers(self, documents: AssetAnswers, health: Health) -> Handlers:
        core = self.core
        is_fleet = core.share is not None
        handlers = {
            **handlers_of(
                documents,
                StreamAnswers(core.live),
                PushAnswers(core.acquisition.ingest, core.store, core.assets),
                AlarmAnswers(core.alarms, core.outbox, is_fleet, lambda: self._followed.changes),
            ),
            **answering(commands.Identifications)(core.jobs),
            **answering(commands.Presence)(health),
        }
        for part in core.parts:
            handlers |= part.handlers()
        return handlers

    def _begin(self, wiring: Wiring, absences: Absences) -> None:
        """Take up what earlier runs left; reads from the store."""
        core = self.core
        of_store = self._stored_assets.first().values()
        of_file = [] if core.share else [CheckedAsset(one, wiring) for one in core.settings.assets]
        for part in core.parts:
            part.read_store()
        self._followed.begin_with([*of_file, *of_store])
        if core.share is not None:
            core.clock.move_with(self._clock_set)
            return
        left = [
            alarm
            for alarm in core.alarms.loaded()
            if core.assets.keys().isdisjoint(assets_of(alarm))
        ]
        report_unconfigured(core.store, core.assets, left)
        for alarm in left:
            core.alarms.withdraw(alarm.asset, ())
        for part in core.parts:
            part.take_over(None)
        absences.compare()
        core.alarms.record_events(
            sorted(self._stored_assets.newly_kept), "configuration not used", _KEPT
        )
        # The last: nothing is moved twice if a store that is away lets all begin again.
        if core.loaded_by_us:
            core.alarms.keep_moved()
            for part in core.parts:
                part.keep_moved()
        core.clock.move_with(self._clock_set, lambda: not core.outbox.unkept)

    def _clock_set(self, by_us: int) -> None:
        """Let all spans go on as they were: the clock was set while they are counted."""
        core = self.core
        moves = [
            # Before the alarms: a part that knows an alarm by its times finds it again.
            *(part.clock_set for part in core.parts),
            core.alarms.clock_set,
            core.shared.clock_set,
            core.acquisition.ingest.clocks.clock_set,
            *(twin.clock_set for twin in core.assets.values()),
        ]
        for move in moves:
            try:
                move(by_us)
            except Exception:
                # What one of them stumbles over keeps the others from nothing.
                _log.exception("times_not_moved")

    async def _apply_changes(self) -> dict[str, str]:
        """Take up what has changed in the store; returns which assets cannot be followed, and why.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        wrong = await self._stored_assets.apply()
        for part in self.core.parts:
            await part.apply_changes()
        return wrong

    async def run(self, stop: asyncio.Event, ready: Callable[[], None] = lambda: None) -> None:
        """Work until ``stop`` is set, then stop cleanly; acquisition ends after that.

        Parameters
        ----------
        stop : asyncio.Event
            Set it to end the cell.
        ready : callable
            Called when all of it runs.
        """
        async with contextlib.AsyncExitStack() as stack:
            for part in self.core.parts:
                stack.push_async_callback(part.stop)
                await part.start(stop)
            ready()
            await stop.wait()
            await to_thread.run_sync(self.core.clock.keep_mark)
            self.core.clock.leave()
            self.core.bus.report(CellState("the start after a stop"))
            self.core.live.close("the service stops")

    async def _follow_stored(self) -> None:
        await self.core.acquisition.read_for(self._stored_assets.wirings())
        await self._stored_assets.follow()

    async def _report(self) -> None:
        """Say how far the live messages are, so that no subscriber misses the last one."""
        core = self.core
        while True:
            partitions = {} if core.share is None else dict(core.share.ownership.owned)
            state = CellState(
                ready=True,
                stream=core.live.seq,
                assets=self._stored_assets.revision,
                partitions=partitions,
                followed=self._followed.changes,
                follows=core.kernels.ready.is_set(),
            )
            core.bus.report(state)
            await asyncio.sleep(STATE_EVERY_S)


class _Jobs(Part):
    """The identification jobs, also those that the service begins itself."""

    name = "jobs"

    def __init__(self, core: Core) -> None:
        self._core = core

    async def run(self) -> None:
        """Go on with what an earlier run left unfinished, then identify automatically."""
        core, jobs = self._core, self._core.jobs
        await core.kernels.ready.wait()
        while True:
            try:
                await jobs.start()
            except StoreUnavailableError as error:
                _log.warning("jobs_wait_for_the_store", error=str(error))
                await asyncio.sleep(STORE_RETRY_WALL_S)
            else:
                break
        await identify_automatically(jobs, core.histories, core.clock)

    async def stop(self) -> None:
        """Stop the workers; what was running waits for the next start."""
        await super().stop()
        await self._core.jobs.stop()


def _jobs_of(core: Core) -> IdentificationJobs:
    seconds = Histogram(
        "bearing_twin_job_seconds",
        "Wall seconds of an identification job.",
        registry=core.registry,
        buckets=(1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600),
    )
    runner = JobRunner(
        core.store,
        core.clock,
        core.live,
        core.assets,
        core.histories,
        make_executor,
        core.settings.data_dir / "jobs",
        seconds.observe,
        core.settings.jobs.workers,
    )
    return IdentificationJobs(runner)


def _maintenance_of(core: Core) -> StoreMaintenance:
    days = core.settings.retention.model_dump()
    retention = Retention(**{one.name: days[one.name] for one in fields(Retention)})
    return StoreMaintenance(
        core.store,
        core.clock,
        retention,
        is_ours=core.is_maintenance_leader,
        owns=None if core.share is None else core.share.owns,
        parts=core.parts,
    )


def _health_of(core: Core, self_check: SelfCheck, stored_assets: StoredAssets) -> Health:
    return Health(
        core.bus,
        core.store,
        core.acquisition.ingest,
        core.assets,
        core.registry,
        core.acquisition.health,
        self_check.all_problems,
        lambda: core.kernels.progress,
        lambda: stored_assets.follows_nothing,
    )
