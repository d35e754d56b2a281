"""The cell with an open store: live twins, jobs and alarms, and the bus to all others."""

import asyncio
import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge, Histogram

from adapters.samples import Batch, PlannedProfile, Sample
from service.alarms import AlarmBook
from service.bus.following import packed
from service.bus.interface import STREAM_TOPIC, CellBus
from service.bus.messages import State
from service.bus.stream import Bus, Message, heartbeats
from service.cell.absences import Absences
from service.cell.acquisition import Acquisition
from service.cell.active_models import active_models
from service.cell.alarm_settings import AlarmTuning
from service.cell.answers import Answers, Parts
from service.cell.keeping import StateKeeper
from service.cell.ledger import ForecastLedger
from service.cell.provisioning import Provisioning, Site
from service.cell.reports import Reports, report_unconfigured
from service.cell.retention import StoreMaintenance
from service.cell.share import Share
from service.clock import ProcessClock
from service.documents.alarms import alarm_document
from service.ingest.metrics import watch_damage, watch_forecasts, watch_late
from service.jobs.automatic import identify_by_itself
from service.jobs.executor import make_executor
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.models import machine_of
from service.jobs.runner import JobRunner
from service.jobs.teaching import Teaching
from service.live.asset import AssetRuntime
from service.live.estimate import ActiveModel
from service.live.kept import KeptState
from service.live.twins import Twins
from service.notifications.notifier import Notifier
from service.site.asset_section import AssetSection
from service.site.provisioning import CheckedAsset
from service.site.settings import Settings
from service.site.wiring import ChannelFacts, Wiring
from service.store import Alarm, Outbox, Retention, Store, StoreUnavailableError
from service.tasks import background

STORE_RETRY_WALL_S = 2.0
STATE_EVERY_S = 0.25
#: Twins that are begun or ended in one go.
_AT_ONCE = 50
#: Wall seconds in which the store takes what is known of assets that another cell takes over.
_HANDED_OVER_S = 5.0

_log = structlog.get_logger(__name__)


class Cell:
    """What follows the machines: store, live twins, jobs and alarms.

    It is made in a thread, since it reads from the store.

    Parameters
    ----------
    settings : Settings
        The checked configuration.
    wiring : Wiring
        The configuration's sources and channels, from `service.site.wiring.wire`.
    store : Store
        Open store.
    outbox : Outbox
        Where changes of alarms wait for the store.
    clock : ProcessClock
        Process time.
    acquisition : Acquisition
        What brings the samples.
    bus : CellBus
        Where others follow and ask.
    share : Share, optional
        Which assets this cell follows, where several cells share them; None: all.

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
        clock: ProcessClock,
        acquisition: Acquisition,
        bus: CellBus,
        share: Share | None = None,
    ) -> None:
        self.settings = settings
        self._share = share
        self.store = store
        self.clock = clock
        self.acquisition = acquisition
        self.registry = CollectorRegistry()
        self.registry.register(acquisition.registry)
        self._others = bus
        self.bus = Bus(clock, bus.epoch, on_message=self._hand_on)
        self.outbox = outbox
        Gauge(
            "bearing_twin_outbox_changes",
            "Alarm changes and audit lines that wait for the store, in memory or on the disk.",
            registry=self.registry,
        ).set_function(lambda: self.outbox.waiting)
        watch_damage(
            {"spool": lambda: acquisition.spool.mended, "outbox": lambda: self.outbox.mended},
            lambda: self.outbox.lost,
            self.registry,
        )
        self.notifier = Notifier(settings, store, self.outbox, clock, self._names_of, self.registry)
        self.alarms = AlarmBook(
            self.outbox, clock, self._alarm_changed, begins_empty=share is not None
        )
        watch_late(
            lambda: {asset.id: asset.readings.late for asset in list(self.assets.values())},
            self.registry,
        )
        watch_forecasts(
            lambda: {asset.id: asset.forecast_age_s() for asset in list(self.assets.values())},
            self.registry,
        )

        def keeps_house() -> bool:
            return share is None or share.keeps_house

        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="forecast")
        self._states = StateKeeper(store.states.save_all)
        run = "" if share is None else share.ownership.cell
        self._ledger = ForecastLedger(
            store, settings.data_dir, clock, self.registry, keeps_house, run
        )
        self.histories: dict[str, AssetHistory] = {}
        self.assets: dict[str, AssetRuntime] = {}
        self.provisioning = Provisioning(
            settings, store, Site(self._change_assets, self._read_for), share
        )
        self._absences = Absences(store, acquisition.ingest, self.alarms)
        of_store = self.provisioning.first().values()
        of_file = [CheckedAsset(asset, wiring) for asset in settings.assets] if not share else []
        self._tuning = AlarmTuning(store, self.assets)
        self._tuning.first()
        self._take_in(self._made([*of_file, *of_store]))
        self._kept_states: dict[str, KeptState] = {}
        self._tasks = asyncio.TaskGroup()
        self._twins = Twins(clock)
        self._running: dict[str, asyncio.Task[None]] = {}
        # Counts the changes of the assets that are followed here.
        self._followed = 0
        if share is None:
            self._kept_states = cast(dict[str, KeptState], store.states.load_all())
            left = [alarm for alarm in self.alarms.active() if alarm.asset not in self.assets]
            report_unconfigured(store, self.assets, left)
            for alarm in left:
                self.alarms.withdraw(alarm.asset, ())
            self.notifier.take_over(self.alarms)
        job_seconds = Histogram(
            "bearing_twin_job_seconds",
            "Wall seconds of an identification job.",
            registry=self.registry,
            buckets=(1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600),
        )
        self.jobs = IdentificationJobs(
            JobRunner(
                store,
                clock,
                self.bus,
                self.assets,
                self.histories,
                make_executor,
                settings.data_dir / "jobs",
                job_seconds.observe,
                settings.jobs.workers,
            )
        )
        self.maintenance = StoreMaintenance(
            store,
            clock,
            Retention(**settings.retention.model_dump()),
            is_ours=keeps_house,
        )
        self._reports = Reports(
            clock,
            self.bus,
            self.alarms,
            self.assets,
            outbox,
            acquisition,
            self.maintenance,
            self.provisioning,
            self.notifier,
            share,
            self.registry,
        )
        self.answers = Answers(
            Parts(
                clock=clock,
                store=store,
                outbox=self.outbox,
                stream=self.bus,
                ingest=acquisition.ingest,
                alarms=self.alarms,
                notifier=self.notifier,
                assets=self.assets,
                jobs=self.jobs,
                registry=self.registry,
                sources=acquisition.health,
                problems=self._reports.problems,
                apply_assets=self._apply_changes,
                is_fleet=share is not None,
                followed=lambda: self._followed,
            )
        )

    async def _apply_changes(self) -> dict[str, str]:
        """Take up what has changed in the store; returns which assets cannot be followed, and why.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        wrong = await self.provisioning.apply()
        await self._tuning.apply()
        return wrong

    def _made(self, assets: Sequence[CheckedAsset]) -> list[AssetRuntime]:
        """Make what follows some assets; it reads from the store."""
        models = active_models(self.store, self.clock, [one.section for one in assets])
        return [
            self._runtime(one.section, one.wiring.channels[one.section.id], models[one.section.id])
            for one in assets
        ]

    def _take_in(self, runtimes: Iterable[AssetRuntime]) -> None:
        for runtime in runtimes:
            self.histories[runtime.id] = AssetHistory(runtime.settings, self.store, self.clock)
            self.assets[runtime.id] = runtime
            self._tuning.settle(runtime)

    async def _change_assets(
        self, gone: Sequence[str], left: Sequence[str], given: Sequence[CheckedAsset]
    ) -> None:
        """Follow assets that were removed or left to others no longer, and given ones from now on.

        Whatever needs the store comes first: where it fails, all are followed as before.
        """
        await self._leave(left)
        changed = {one.section.id: one for one in given if one.section.id in self.assets}
        followed = [name for name in gone if name in self.assets]
        new = [one.section.id for one in given if one.section.id not in self.assets]
        await self.jobs.end(
            [*gone, *(name for name, one in changed.items() if self._is_another(name, one))]
        )
        # What is activated meanwhile must be what the new twin runs on.
        async with self.jobs.switching:
            runtimes = await to_thread.run_sync(self._made, given)
            load = partial(self.store.states.load_all, new)
            kept = cast(dict[str, KeptState | None], await to_thread.run_sync(load))
            again: set[str] = set()
            if self._share is None:
                again = await to_thread.run_sync(self._absences.known, new)
            elif new:
                await to_thread.run_sync(self._take_over, new)
            await self._stop([*gone, *changed])
            for runtime in runtimes:
                if runtime.id in changed:
                    kept[runtime.id] = await runtime.take_over(self.assets[runtime.id])
            latest = {name: self.assets.pop(name).readings.latest for name in followed}
            for name in followed:
                self.histories.pop(name, None)
            self.alarms.forget(gone)
            self._absences.note(latest, again)
            self.answers.forget([*gone, *changed])
            self._take_in(runtimes)
            self._followed += 1
        for number, runtime in enumerate(runtimes):
            self._follow(runtime.id, kept.get(runtime.id))
            if number % _AT_ONCE == _AT_ONCE - 1:
                await asyncio.sleep(0)
        await self.jobs.resume(new)

    def _take_over(self, assets: Sequence[str]) -> None:
        """Go on where the cell that owned some assets before ended; reads from the store."""
        self.alarms.take_over(assets)
        self.notifier.take_over(self.alarms, assets)
        self.acquisition.ingest.expect(self.store.samples.open_ends(assets))

    async def _leave(self, assets: Sequence[str]) -> None:
        """Leave assets to another cell: all that is known of them is in the store then."""
        if not assets:
            return
        await self.jobs.leave(assets)
        async with self.jobs.switching:
            await self._stop(assets)
            for name in assets:
                self.assets.pop(name, None)
                self.histories.pop(name, None)
            self.alarms.leave(assets)
            self.notifier.leave(assets)
            self.answers.forget(assets)
            self.acquisition.ingest.expect_no_more(assets)
            self._followed += 1
        if not await to_thread.run_sync(self.outbox.flush, _HANDED_OVER_S):
            raise StoreUnavailableError(self.outbox.problem or "changes of alarms wait")

    async def _read_for(self, assets: Mapping[str, Wiring | None]) -> None:
        await self.acquisition.change(assets)
        gone = [name for name, wiring in assets.items() if wiring is None]
        self._absences.mark(gone, self.clock.now_us())

    async def _stop(self, assets: Sequence[str]) -> None:
        for begin in range(0, len(assets), _AT_ONCE):
            portion = assets[begin : begin + _AT_ONCE]
            tasks = [self._running.pop(name) for name in portion if name in self._running]
            for task in tasks:
                task.cancel()
            if tasks:  # their last states go together
                await asyncio.wait(tasks)

    def _is_another(self, asset_id: str, changed: CheckedAsset) -> bool:
        """Whether an asset becomes another machine: what is identified is of the one before."""
        return machine_of(self.assets[asset_id].settings) != machine_of(changed.section)

    def _follow(self, asset_id: str, kept: KeptState | None) -> None:
        self._running[asset_id] = self._tasks.create_task(
            self._run_twin(self.assets[asset_id], kept), name=f"twin of {asset_id}"
        )

    async def _run_twin(self, twin: AssetRuntime, kept: KeptState | None) -> None:
        with self._twins.stepping(twin):
            await twin.run(kept)

    def _runtime(
        self, asset: AssetSection, channels: Mapping[str, ChannelFacts], active: ActiveModel
    ) -> AssetRuntime:
        return AssetRuntime(
            asset,
            channels,
            active,
            clock=self.clock,
            bus=self.bus,
            alarms=self.alarms,
            executor=self._executor,
            store_samples=self._store_derived,
            save_state=partial(self._states.save, asset.id),
            keep_forecast=self._ledger.take,
            doubt=partial(self._doubt, asset.id),
        )

    # ------------------------------------------------------------------ what flows
    def _take(self, batch: Batch) -> None:
        # Each asset gets its own: most have nothing to do with a batch.
        samples: defaultdict[str, list[Sample]] = defaultdict(list)
        plans: defaultdict[str, list[PlannedProfile]] = defaultdict(list)
        for sample in batch.samples:
            samples[sample.asset].append(sample)
        for plan in batch.plans:
            plans[plan.asset].append(plan)
        for asset_id in samples.keys() | plans.keys():
            asset = self.assets.get(asset_id)
            if asset is not None:
                asset.take(samples.get(asset_id, ()), plans.get(asset_id, ()))

    def _store_derived(self, samples: Any) -> None:
        self.acquisition.ingest.submit(samples)

    def _hand_on(self, message: Message) -> None:
        self._others.publish(STREAM_TOPIC, message.seq, packed(message))

    def _alarm_changed(self, alarm: Alarm) -> None:
        if alarm.asset in self.assets:
            self.assets[alarm.asset].alarms_changed()
        self.bus.publish("alarm", alarm.asset, alarm_document(alarm))
        self.notifier.take(alarm)

    def _names_of(self, asset: str) -> tuple[str, str]:
        """Name and family of an asset, also of one that was removed a moment ago."""
        runtime = self.assets.get(asset)
        return (runtime.settings.name or asset, runtime.settings.family) if runtime else (asset, "")

    def _doubt(self, asset: str, channel: str) -> str:
        """Why a channel's latest sample is not good, as a check found or its source says."""
        found = self.acquisition.checks.reason(asset, channel)
        if found:
            return found
        facts = self.assets[asset].facts.get(channel)
        return "" if facts is None else self.acquisition.problem(facts.source, asset, channel)

    # ------------------------------------------------------------------ life
    async def run(self, stop: asyncio.Event, ready: Callable[[], None] = lambda: None) -> None:
        """Work until ``stop`` is set, then stop cleanly; acquisition ends after that.

        Parameters
        ----------
        stop : asyncio.Event
            Set it to end the cell.
        ready : callable
            Called when all of it runs.
        """
        try:
            async with contextlib.AsyncExitStack() as stack:
                ledger = background(self._ledger.run(), "forecast ledger", stop)
                await stack.enter_async_context(ledger)
                await stack.enter_async_context(background(self._run_twins(), "twins", stop))
                self.acquisition.hand_to(self._take)
                stack.push_async_callback(self.jobs.stop)
                for name, task in (
                    ("jobs", self._take_up_jobs()),
                    ("models", self.jobs.runner.activations.follow()),
                    ("alarm settings", self._tuning.follow()),
                    ("health", self._reports.tell()),
                    ("notifications", self.notifier.run()),
                    ("heartbeat", heartbeats(self.bus)),
                    ("maintenance", self.maintenance.run()),
                    ("check of the store", self.maintenance.check()),
                    ("bus", self._others.serve(self.answers.handlers())),
                    ("state", self._report()),
                ):
                    await stack.enter_async_context(background(task, name, stop))
                ready()
                await stop.wait()
                self._others.report(State("the start after a stop"))
                self.bus.close("the service stops")
        finally:
            self._executor.shutdown(wait=False, cancel_futures=True)

    async def _report(self) -> None:
        """Say how far the live messages are, so that nobody misses the last one."""
        while True:
            partitions = {} if self._share is None else dict(self._share.ownership.owned)
            state = State(
                ready=True,
                stream=self.bus.seq,
                assets=self.provisioning.revision,
                partitions=partitions,
                followed=self._followed,
            )
            self._others.report(state)
            await asyncio.sleep(STATE_EVERY_S)

    async def _run_twins(self) -> None:
        # Side by side: their last saving takes its time when the store does not answer.
        async with self._tasks:
            self._tasks.create_task(self._twins.run(), name="steps of the twins")
            for asset_id in self.assets:
                self._follow(asset_id, self._kept_states.pop(asset_id, None))
            self._kept_states = {}
            await self.acquisition.read_for(self.provisioning.wirings())
            await self.provisioning.follow()

    async def _take_up_jobs(self) -> None:
        """Go on with what an earlier run left unfinished, then identify by itself."""
        while True:
            try:
                await self.jobs.start()
            except StoreUnavailableError as error:
                _log.warning("jobs_wait_for_the_store", error=str(error))
                await asyncio.sleep(STORE_RETRY_WALL_S)
            else:
                break
        async with asyncio.TaskGroup() as group:
            group.create_task(identify_by_itself(self.jobs, self.histories, self.clock))
            group.create_task(Teaching(self.jobs.runner, self.clock).run())
