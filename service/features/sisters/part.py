"""Keeps what each machine of a family teaches its sisters, from all that it has run.

A version of an asset's model rests on its low-risk data; what its sisters want to know is how it
did under heavy load and at high speed. So a machine is identified once more, from everything: after
its first half hour, and whenever it has run half as long again, or somewhere it had not been.
"""

import asyncio
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from typing import Final

import numpy as np
import structlog
from anyio import to_thread

from adapters.protocol import Clock
from service.cell.core import Core
from service.features.sisters.worker import TeachingOrder, run_teaching
from service.jobs.executor import WorkerStalledError, watched
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.models import machine_of
from service.jobs.workspace import JobFolder
from service.live.guard import Guard
from service.site.asset_section import AssetSection
from service.site.machines.packed_rows import pack_rows
from service.store import NotOwnerError, Store, StoreUnavailableError
from service.store.sister_records import SisterRecord
from service.tasks import Part
from service.worker_pools import NoWorkerError
from twin_core.identification.data import IdentificationData
from twin_core.identification.posterior import Posterior
from twin_core.windows import MinuteData, Window

LOOK_EVERY_S: Final = 300.0
LOOK_LEAST_WALL_S: Final = 1.0
#: Minutes of operation before a machine teaches anything, and at a point where it had not been.
FEWEST_MINUTES: Final = 30
#: A record is made again when so much of its length is new.
_GROWN_BY: Final = 0.5
#: How far back a record looks, and how many minutes it takes at most.
_LOOK_BACK_US: Final = 30 * 86_400 * 1_000_000
MOST_MINUTES: Final = 24 * 60
#: Beyond where it had been by more than the noise of load and speed.
_BEYOND: Final = 1.05

_log = structlog.get_logger(__name__)


def part(core: Core) -> Part:
    """Make the part of the cell."""
    return Teaching(core.jobs, core.clock)


class Teaching(Part):
    """Keeps the records of the assets that are followed here.

    Parameters
    ----------
    jobs : IdentificationJobs
        Whose workers, assets and store.
    clock : Clock
        Process time.
    """

    name = "teaching"

    def __init__(self, jobs: IdentificationJobs, clock: Clock) -> None:
        self._jobs, self._runner, self._clock = jobs, jobs.runner, clock
        self._store: Store = self._runner.store
        self._known: dict[str, SisterRecord | None] = {}
        self._guards: dict[str, Guard] = {}
        # Until when the data were looked at that taught nothing.
        self._in_vain_us: dict[str, int] = {}

    async def run(self) -> None:
        """Look at every asset of a family from time to time, until cancelled."""
        await self._jobs.ready.wait()
        while True:
            await asyncio.sleep(max(LOOK_EVERY_S / self._clock.rate, LOOK_LEAST_WALL_S))
            for asset_id in list(self._runner.histories):
                # One asset must not keep the others from being looked at; an unreachable
                # store is reported by those that write samples.
                guard = self._guards.setdefault(asset_id, Guard("teaching_sisters", asset_id))
                with guard():
                    try:
                        await self.look(asset_id)
                    except (StoreUnavailableError, NotOwnerError):
                        self._known.pop(asset_id, None)

    async def look(self, asset_id: str) -> bool:
        """Make the record of an asset if it is due; returns whether it was made.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        NotOwnerError
            If another cell owns the asset.
        """
        asset = self._runner.assets.get(asset_id)
        history = self._runner.histories.get(asset_id)
        if asset is None or history is None:
            for kept in (self._known, self._guards, self._in_vain_us):
                kept.pop(asset_id, None)
            return False
        known = await self._record(asset_id)
        if not asset.settings.family:
            if known is not None:
                await to_thread.run_sync(self._store.sisters.remove, asset_id)
                self._known[asset_id] = None
            return False
        if known is not None and _is_of_another(known, asset.settings):
            known = None
        since_us = 0 if known is None else known.until_us
        since_us = max(since_us, self._in_vain_us.get(asset_id, 0))
        since_us = max(since_us, self._clock.now_us() - _LOOK_BACK_US)
        fresh = await history.running_minutes(since_us)
        if fresh is None or not _is_due(fresh, known):
            return False
        return await self._teach(asset.settings, history, round(fresh.time_s[-1] * 1e6))

    async def _record(self, asset_id: str) -> SisterRecord | None:
        if asset_id not in self._known:
            found = await to_thread.run_sync(self._store.sisters.of, [asset_id])
            self._known[asset_id] = found.get(asset_id)
        return self._known[asset_id]

    async def _teach(self, asset: AssetSection, history: AssetHistory, until_us: int) -> bool:
        windows = chosen(await history.all_operation(_LOOK_BACK_US))
        if not windows:
            self._in_vain_us[asset.id] = until_us
            return False
        spans = [history.span_us(window) for window in windows]
        data = await history.identification_data(spans)
        folder = JobFolder(self._runner.folder / f"teaching-{asset.id}")
        order = TeachingOrder(folder, machine_of(asset), data)
        try:
            found = await self._computed(order)
        except (BrokenProcessPool, NoWorkerError, WorkerStalledError) as error:
            found = str(error) or type(error).__name__
        if found is None:
            return False
        if isinstance(found, str):
            self._in_vain_us[asset.id] = until_us
            _log.info("teaches_nothing", asset=asset.id, reason=found)
            return False
        record = _record_of(asset, found, data, until_us)
        await to_thread.run_sync(self._store.sisters.put, record)
        self._known[asset.id] = record
        _log.info(
            "teaches_sisters",
            asset=asset.id,
            family=asset.family,
            minutes=record.minutes,
            load_n_max=record.load_n_max,
            speed_rpm_max=record.speed_rpm_max,
        )
        return True

    async def _computed(self, order: TeachingOrder) -> Posterior | str | None:
        async with self._runner.workers.turn(urgent=False) as worker:
            await to_thread.run_sync(order.folder.make)
            try:
                future = worker.executor.submit(run_teaching, order)
                return await watched(
                    asyncio.wrap_future(future),
                    order.folder.life,
                    lambda: self._runner.stalled_after_wall_s,
                    _nothing,
                )
            except (BrokenProcessPool, NoWorkerError, WorkerStalledError):
                worker.end()
                raise
            finally:
                order.folder.cancel()  # a worker that is still at it has nothing left to do
                order.folder.remove()


async def _nothing() -> None:
    """Show no progress."""


def _record_of(
    asset: AssetSection, own: Posterior, data: IdentificationData, until_us: int
) -> SisterRecord:
    """Make the record of what a machine teaches its sisters.

    Parameters
    ----------
    asset, until_us
        Whose machine, and the end of its data.
    own, data
        What all that it has run says of it with the literature's prior, and these rows.
    """
    bare = replace(own, samples=np.empty((0, own.z.size)), sisters=None)
    return SisterRecord(
        asset=asset.id,
        family=asset.family,
        machine=dict(machine_of(asset).to_dict()),
        until_us=until_us,
        minutes=sum(int(window.minutes.good.sum()) for window in data.windows),
        load_n_max=own.trained.load_n_max,
        speed_rpm_max=own.trained.speed_rpm_max,
        document={"posterior": bare.to_dict(), "rows": pack_rows(data)},
    )


def _is_of_another(known: SisterRecord, asset: AssetSection) -> bool:
    return known.family != asset.family or known.machine != machine_of(asset).to_dict()


def _is_due(fresh: MinuteData, known: SisterRecord | None) -> bool:
    """Whether these new minutes of operation are worth another identification."""
    if known is None:
        return fresh.size >= FEWEST_MINUTES
    beyond = (fresh.load_n > _BEYOND * known.load_n_max) | (
        np.abs(fresh.speed_rpm) > _BEYOND * known.speed_rpm_max
    )
    half_again = max(FEWEST_MINUTES, _GROWN_BY * known.minutes)
    return bool(fresh.size >= half_again or np.count_nonzero(beyond) >= FEWEST_MINUTES)


def chosen(windows: Sequence[Window]) -> list[Window]:
    """Choose the windows of a record: the farthest ones and the newest, in time order.

    Parameters
    ----------
    windows
        All there are, oldest first.
    """
    if not windows:
        return []
    first = [
        max(windows, key=lambda window: window.load_n_max),
        max(windows, key=lambda window: window.speed_rpm_max),
    ]
    taken: list[Window] = []
    minutes = 0.0
    for window in [*first, *reversed(windows)]:
        if window in taken or (taken and minutes >= MOST_MINUTES):
            continue
        taken.append(window)
        minutes += window.duration_s / 60.0
    return sorted(taken, key=lambda window: window.start_s)
