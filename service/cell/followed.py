"""The assets that a cell follows, each with its running twin: how they come, change and go."""

import asyncio
import gc
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import cast

from anyio import to_thread

from adapters.samples import Batch, PlannedProfile, Sample
from adapters.times import clock_ahead
from service.cell.absences import Absences
from service.cell.active_models import active_models
from service.cell.answers import AssetAnswers
from service.cell.core import Core
from service.cell.keeping import StateKeeper
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.models import machine_of
from service.live.asset import AssetRuntime
from service.live.estimate import RunningModel
from service.live.kept import KeptState
from service.live.saving import move_kept
from service.live.twins import Twins
from service.site.asset_section import AssetSection
from service.site.asset_tables import CheckedAsset
from service.site.wiring import ChannelFacts, Wiring
from service.store import StoreUnavailableError
from service.tasks import Part

#: Twins that are begun or ended in one go.
BATCH_SIZE = 50
#: Wall seconds between two looks whether all twins that came are complete.
LOOK_S = 5.0
#: Wall seconds in which the store takes what is known of assets that another cell takes over.
HANDOVER_TIMEOUT_S = 5.0


class FollowedAssets(Part):
    """Makes and runs the twins of the assets of `core`.

    Parameters
    ----------
    core
        Where the assets are, and what their twins are made of.
    jobs, absences, documents
        What else knows of assets that come and go.

    Attributes
    ----------
    changes : int
        Counts the changes of the assets that are followed here.
    """

    name = "twins"

    def __init__(
        self,
        core: Core,
        jobs: IdentificationJobs,
        absences: Absences,
        documents: AssetAnswers,
    ) -> None:
        self.changes = 0
        self._core = core
        self._jobs = jobs
        self._absences = absences
        self._documents = documents
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="forecast")
        self._states = StateKeeper(core.store.states.save_all)
        self._kept_states: dict[str, KeptState] = {}
        self._tasks = asyncio.TaskGroup()
        self._twins = Twins(core.clock, core.shared.evaluate)
        self._running_twins: dict[str, asyncio.Task[None]] = {}

    # ------------------------------------------------------------------ life
    def begin_with(self, assets: Sequence[CheckedAsset]) -> None:
        """Make the twins of the first assets; reads from the store."""
        self._add(self._made(assets))
        if self._core.share is None:
            self._kept_states = cast(dict[str, KeptState], self._core.store.states.load_all())
            for state in self._kept_states.values() if self._core.loaded_by_us else ():
                move_kept(state, self._core.loaded_by_us or 0)

    async def start(self, stop: asyncio.Event) -> None:
        """Begin to work, and to take samples."""
        await super().start(stop)
        self._core.acquisition.hand_to(self._take)

    async def stop(self) -> None:
        """End all twins; their states are saved."""
        await super().stop()
        self._executor.shutdown(wait=False, cancel_futures=True)

    async def run(self) -> None:
        """Step the twins until cancelled."""
        # Side by side: their last saving takes its time when the store does not answer.
        async with self._tasks:
            self._tasks.create_task(self._twins.run(), name="steps of the twins")
            self._tasks.create_task(self._be_prompt(), name="twins that stay")
            for asset_id in self._core.assets:
                self._follow(asset_id, self._kept_states.pop(asset_id, None))
            self._kept_states = {}
            await asyncio.Event().wait()

    async def _be_prompt(self) -> None:
        """Keep the twins out of every later collection of garbage, once they are complete.

        To look through a thousand of them takes a tenth of a second in which nothing is polled.
        """
        frozen = -1
        while True:
            await asyncio.sleep(LOOK_S)
            if frozen != self.changes and self._core.assets and self._are_complete():
                frozen = self.changes
                gc.freeze()

    def _are_complete(self) -> bool:
        """Whether every twin that has started has a forecast, which is the last thing to come."""
        return all(
            not one.estimate.started or not math.isnan(one.forecast_age_s())
            for one in self._core.assets.values()
        )

    # ------------------------------------------------------------------ assets that come and go
    async def change(
        self, gone: Sequence[str], left: Sequence[str], given: Sequence[CheckedAsset]
    ) -> None:
        """Follow assets that were removed or left to others no longer, and given ones from now on.

        Whatever needs the store comes first: where it fails, all are followed as before.
        """
        core, assets, jobs, absences = self._core, self._core.assets, self._jobs, self._absences
        await self._leave(left)
        changed = {one.section.id: one for one in given if one.section.id in assets}
        followed = [name for name in gone if name in assets]
        new = [one.section.id for one in given if one.section.id not in assets]
        await jobs.end(
            [*gone, *(name for name, one in changed.items() if self._is_another(name, one))]
        )
        # What is activated meanwhile must be what the new twin runs on.
        async with jobs.switching:
            runtimes = await to_thread.run_sync(self._made, given)
            load = partial(core.store.states.load_all, new)
            kept = cast(dict[str, KeptState | None], await to_thread.run_sync(load))
            again: set[str] = set()
            if core.share is None:
                again = await to_thread.run_sync(absences.known, new)
            elif new:
                await to_thread.run_sync(self._take_over, new)
            await self._stop_twins([*gone, *changed])
            for runtime in runtimes:
                if runtime.id in changed:
                    kept[runtime.id] = await runtime.take_over(assets[runtime.id])
            latest = {name: assets.pop(name).readings.latest for name in followed}
            for name in followed:
                core.histories.pop(name, None)
            core.shared.forget(gone)
            core.alarms.forget(gone)
            absences.note(latest, again)
            absences.compare(new)
            self._documents.forget([*gone, *changed])
            self._add(runtimes)
            self.changes += 1
        for number, runtime in enumerate(runtimes):
            self._follow(runtime.id, kept.get(runtime.id))
            if number % BATCH_SIZE == BATCH_SIZE - 1:
                await asyncio.sleep(0)
        await jobs.resume(new)

    async def read_for(self, assets: Mapping[str, Wiring | None]) -> None:
        """Read other channels for some assets; None: nothing."""
        await self._core.acquisition.change(assets)
        gone = [name for name, wiring in assets.items() if wiring is None]
        self._absences.mark(gone, self._core.clock.now_us())

    def _take_over(self, assets: Sequence[str]) -> None:
        """Go on where the cell that owned some assets before ended; reads from the store."""
        core = self._core
        core.alarms.take_over(assets)
        for part in core.parts:
            part.take_over(assets)
        core.acquisition.ingest.expect(core.store.samples.open_ends(assets))

    async def _leave(self, assets: Sequence[str]) -> None:
        """Leave assets to another cell: all that is known of them is in the store then."""
        if not assets:
            return
        core = self._core
        await self._jobs.leave(assets)
        async with self._jobs.switching:
            await self._stop_twins(assets)
            for name in assets:
                core.assets.pop(name, None)
                core.histories.pop(name, None)
            core.shared.leave(assets)
            core.alarms.leave(assets)
            for part in core.parts:
                part.leave(assets)
            self._documents.forget(assets)
            core.acquisition.ingest.expect_no_more(assets)
            self.changes += 1
        if not await to_thread.run_sync(core.outbox.flush, HANDOVER_TIMEOUT_S):
            raise StoreUnavailableError(core.outbox.problem or "changes of alarms wait")

    def _is_another(self, asset_id: str, changed: CheckedAsset) -> bool:
        """Whether an asset becomes another machine: what is identified is of the one before."""
        return machine_of(self._core.assets[asset_id].settings) != machine_of(changed.section)

    # ------------------------------------------------------------------ twins
    def _made(self, assets: Sequence[CheckedAsset]) -> list[AssetRuntime]:
        """Make what follows some assets; it reads from the store."""
        core = self._core
        models = active_models(core.store, core.clock, [one.section for one in assets])
        return [
            self._runtime(one.section, one.wiring.channels[one.section.id], models[one.section.id])
            for one in assets
        ]

    def _runtime(
        self, asset: AssetSection, channels: Mapping[str, ChannelFacts], active: RunningModel
    ) -> AssetRuntime:
        core = self._core
        return AssetRuntime(
            asset,
            channels,
            active,
            clock=core.clock,
            bus=core.live,
            alarms=core.alarms,
            executor=self._executor,
            store_samples=core.acquisition.ingest.submit,
            save_state=partial(self._states.save, asset.id),
            doubt=partial(self._doubt, asset.id),
            ahead_s=partial(self._ahead_s, asset.id),
            shared=core.shared,
        )

    def _add(self, runtimes: Iterable[AssetRuntime]) -> None:
        core = self._core
        for runtime in runtimes:
            core.shared.expect((runtime.id,))
            core.histories[runtime.id] = AssetHistory(runtime.settings, core.store, core.clock)
            core.assets[runtime.id] = runtime
            for part in core.parts:
                part.settle(runtime)

    def _follow(self, asset_id: str, kept: KeptState | None) -> None:
        self._running_twins[asset_id] = self._tasks.create_task(
            self._run_twin(self._core.assets[asset_id], kept), name=f"twin of {asset_id}"
        )

    async def _run_twin(self, twin: AssetRuntime, kept: KeptState | None) -> None:
        with self._twins.stepping(twin):
            await twin.run(kept, self._core.kernels.ready)

    async def _stop_twins(self, assets: Sequence[str]) -> None:
        running = self._running_twins
        for begin in range(0, len(assets), BATCH_SIZE):
            portion = assets[begin : begin + BATCH_SIZE]
            tasks = [running.pop(name) for name in portion if name in running]
            for task in tasks:
                task.cancel()
            if tasks:  # their last states go together
                await asyncio.wait(tasks)

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
            asset = self._core.assets.get(asset_id)
            if asset is not None:
                asset.take(samples.get(asset_id, ()), plans.get(asset_id, ()))

    def _doubt(self, asset: str, channel: str) -> str:
        """Why a channel's latest sample is not good, as a check found or its source says."""
        acquisition = self._core.acquisition
        ahead_s = self._core.assets[asset].readings.clock_ahead_s(channel)
        found = "" if ahead_s is None else clock_ahead(ahead_s)
        found = found or acquisition.checks.reason(asset, channel)
        if found:
            return found
        facts = self._core.assets[asset].facts.get(channel)
        return "" if facts is None else acquisition.problem(facts.source, asset, channel)

    def _ahead_s(self, asset: str, channel: str) -> float | None:
        """By how many seconds the clock of a channel's source is ahead; None where it is not."""
        acquisition = self._core.acquisition
        found = acquisition.ingest.clocks.ahead_s(asset, channel)
        facts = self._core.assets[asset].facts.get(channel)
        if found is not None or facts is None:
            return found
        return acquisition.clock_ahead_s(facts.source, asset, channel)
