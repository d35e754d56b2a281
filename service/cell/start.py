"""Starts the cell: devices are read first, and the rest joins as soon as its store is there."""

import asyncio
import contextlib
import gc
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import structlog
from anyio import to_thread

from service.bus.local import LocalCellBus
from service.bus.messages import CellState
from service.cell.acquisition import Acquisition
from service.cell.cell_clock import CellClock
from service.cell.kernels import Kernels
from service.cell.known_assets import read_copy
from service.cell.last_templates import check_at_start
from service.cell.share import EarlierRuns, Share
from service.clock import ProcessClock
from service.domain.errors import BearingTwinError
from service.feature_folders import declared
from service.ingest import Spool
from service.loading import load_numba, loading
from service.site.asset_section import AssetSection
from service.site.partitions import partitions_of
from service.site.settings import Settings
from service.site.wiring import Wiring, wire
from service.store import (
    DatabaseInUseError,
    DataDirectoryLock,
    Outbox,
    Store,
    StoreUnavailableError,
    lock_data_directory,
    lock_database,
)
from service.store.errors import StoreDoubtedError, opening_error
from service.store.identity import Witness
from service.store.opening import database_address
from service.tasks import INGEST, background
from service.waiting import LEAVE_DATABASE_S, LEAVE_S, StoppedError, Waiting

if TYPE_CHECKING:
    from service.bus.nats_bus import NatsCellBus
    from service.cell.cell import Cell
    from service.store.database_lock import DatabaseLock

#: Wall seconds after which devices are read though the store is not open yet.
ACQUIRE_AFTER_S = 1.0
#: Wall seconds for the last changes of alarms; what the store does not take then stays on the disk.
OUTBOX_S = 1.0
#: And for those that an earlier run left.
_DELIVERED_S = 10.0
_ALIVE_EVERY_S = 1.0
#: New objects until the youngest are looked at, how often those until the older ones are, and how
#: often these until all are: every two minutes with 500 assets.
_COLLECTED_AFTER = (1000, 10, 100)

_Bus: TypeAlias = "LocalCellBus | NatsCellBus"

_log = structlog.get_logger(__name__)


class StoreConfirmedError(BearingTwinError, RuntimeError):
    """A person has confirmed another store: nothing that this process knows holds any more."""


class PartitionsLostError(BearingTwinError, RuntimeError):
    """Another cell has taken over what this one owned: it hung, or did not reach the database."""


async def run_cell(
    settings: Settings,
    *,
    stop: asyncio.Event,
    ready: Callable[[], None],
    status: Callable[[str], None] = lambda text: None,
    alive: Callable[[], None] = lambda: None,
) -> None:
    """Run the cell of a configuration until ``stop`` is set: sources, store, twins, alarms, jobs.

    It needs none of the other processes. What is not there yet is waited for: another service
    that still holds the data directory or the database, a database server that is not up yet, a
    locked store, room on the disk. Devices are read meanwhile.

    Parameters
    ----------
    settings : Settings
        The configuration.
    stop : asyncio.Event
        Set it to end the cell cleanly.
    ready : callable
        Called when devices are read and what they say is kept.
    status : callable
        Takes one line about what the cell does, whenever that changes.
    alive : callable
        Called once a second as long as the event loop, the sources and the writer go on.

    Raises
    ------
    SettingsError, StoreError
        If the configuration or the data directory cannot be used.
    TemporaryError
        If another service did not leave in time.
    """
    with contextlib.suppress(StoppedError):
        await _Start(settings, stop, ready, status, alive).run()


class _Start:
    """One run of a cell, from its first wait to its end."""

    def __init__(
        self,
        settings: Settings,
        stop: asyncio.Event,
        ready: Callable[[], None],
        status: Callable[[str], None],
        alive: Callable[[], None],
    ) -> None:
        self._settings = settings
        self._stop = stop
        self._ready = ready
        self._status = status
        self._alive = alive
        self._wiring = wire(settings)
        self._waiting = Waiting(stop, self._waits_for)
        self._bus: _Bus | None = None
        # Names this run among all cells, where there are several.
        self._run = ""
        self._witness: Witness | None = None
        if settings.is_fleet:
            from service.store.ownership import run_name

            self._run = run_name()
        # What is open until the last sample has been written.
        self._open = contextlib.ExitStack()

    def _waits_for(self, what: str, why: str) -> None:
        self._status(f"waits for {what}: {why}" if what else "starts")
        if self._bus is not None:
            self._bus.report(CellState(what))

    async def run(self) -> None:
        # A thread that loads, reads or judges releases the interpreter after 1 ms instead of 5.
        sys.setswitchinterval(0.001)
        data_dir = self._settings.data_dir
        until = self._waiting.until
        lost = ""
        with self._open:
            lock = await until(
                "the data directory", partial(lock_data_directory, data_dir), LEAVE_S
            )
            self._open.enter_context(lock)
            spool, clock = await until("room on the disk", self._open_spool)
            self._open.callback(spool.close)
            async with contextlib.AsyncExitStack() as running:
                await running.enter_async_context(background(clock.run(), "clock", self._stop))
                bus = self._bus = await self._make_bus(running)
                if self._settings.is_fleet:  # what is read is known when partitions are owned
                    acquisition = Acquisition(Wiring([], {}), clock, spool)
                    acquisition.ingest.expect_no_more()
                else:
                    others = await to_thread.run_sync(self._known_assets)
                    acquisition = Acquisition(self._wiring, clock, spool, others)
                # Who asks meanwhile is answered that there is nothing yet.
                answering = asyncio.create_task(bus.serve({}))
                running.push_async_callback(_cancel, answering)
                opening = asyncio.create_task(self._open_store())
                running.push_async_callback(_cancel, opening)
                # What a person must mend is mostly found at once, before any device is asked.
                await asyncio.wait({opening}, timeout=ACQUIRE_AFTER_S)
                if opening.done():
                    opening.result()
                await running.enter_async_context(
                    background(acquisition.ingest.run(acquisition.drivers), INGEST, self._stop)
                )
                await running.enter_async_context(
                    background(self._watch(acquisition), "supervision", self._stop)
                )
                # Devices are read and what they say is kept, whatever is waited for.
                self._ready()
                store, database_lock = await opening
                await self._work(store, acquisition, clock, bus, answering)
                lost = database_lock.lost if database_lock is not None else ""
        if lost:
            raise DatabaseInUseError(lost)
        if self._witness is not None and self._witness.ended:
            raise StoreConfirmedError(self._witness.ended)

    async def _make_bus(self, running: contextlib.AsyncExitStack) -> _Bus:
        if self._settings.is_fleet:
            from service.bus.fleet_connection import connection_of
            from service.bus.nats_bus import NatsCellBus

            connection = connection_of(self._settings, "cell")
            bus = NatsCellBus(connection, self._run)
            await running.enter_async_context(background(connection.run(), "bus", self._stop))
            return bus
        local = LocalCellBus(self._settings.data_dir)
        self._open.callback(local.close)
        return local

    def _known_assets(self) -> dict[str, Wiring]:
        """What is read for assets of the store, as far as they were known before this start."""
        checked = check_at_start(self._settings, read_copy(self._settings.data_dir))
        return {name: one.wiring for name, one in checked.right.items()}

    async def _watch(self, acquisition: Acquisition) -> None:
        while True:
            await asyncio.sleep(_ALIVE_EVERY_S)
            if acquisition.ingest.has_gone_on():
                self._alive()

    def _open_spool(self) -> tuple[Spool, CellClock]:
        settings = self._settings
        spool = Spool.open(settings.data_dir, settings.service.spool_mib)
        try:
            clock = ProcessClock.resume(settings.clock.rate, settings.data_dir)
            return spool, CellClock(clock, settings.data_dir)
        except OSError as error:
            spool.close()
            raise opening_error(f"data directory {settings.data_dir}: {error}", error) from error

    async def _open_store(self) -> "tuple[Store, DatabaseLock | DataDirectoryLock | None]":
        """Open all that the cell needs beside its devices."""
        settings, until = self._settings, self._waiting.until
        service, data_dir = settings.service, settings.data_dir
        url = service.database_url
        store = await until("the store", partial(Store.open, url, data_dir, run=self._run))
        self._open.callback(store.close)
        loop = asyncio.get_running_loop()
        begin_again = partial(loop.call_soon_threadsafe, self._stop.set)
        witness = self._witness = Witness(data_dir, store.name, begin_again)
        self._open.callback(witness.close)
        store.write_if(witness)
        if settings.is_fleet:
            return store, None
        lost = partial(loop.call_soon_threadsafe, self._stop.set)
        lock = await until(
            "another service to leave the database",
            partial(lock_database, url, data_dir, lost),
            LEAVE_DATABASE_S,
        )
        self._open.callback(lock.close)
        return store, lock

    async def _work(
        self,
        store: Store,
        acquisition: Acquisition,
        clock: CellClock,
        bus: _Bus,
        answering: "asyncio.Task[None]",
    ) -> None:
        """Store what has been acquired so far, and run the rest of the cell."""
        settings, until = self._settings, self._waiting.until
        ends = {} if settings.is_fleet else await until("the store", store.samples.open_ends)
        acquisition.ingest.attach(store, ends)
        Cell, loaded = await until("the live twin", _load_twin)
        kernels = Kernels(loaded)
        known: tuple[int, list[AssetSection]] = (0, [])
        if settings.is_fleet:
            known = await until("the store", partial(fence_earlier, settings, store))
        open_outbox = partial(Outbox.open, settings.data_dir, store, run=self._run)
        outbox = await until("room on the disk", open_outbox)
        share: Share | None = None
        try:
            if settings.is_fleet:
                share = await self._share(store, outbox, *known)
            make = partial(
                Cell, settings, self._wiring, store, outbox, clock, acquisition, bus, kernels, share
            )
            cell = await until("the store", make)
            be_prompt()
            await _cancel(answering)
            await cell.run(self._stop, lambda: self._status("runs"))
        finally:
            clock.leave()  # a cell that is being made still moves nothing
            await to_thread.run_sync(outbox.close, OUTBOX_S)
            if share is not None:
                # No device may have two readers: ours end before another cell may begin.
                await acquisition.read_for({})
                await to_thread.run_sync(share.ownership.close)
        if share is not None and share.ownership.lost:
            # Nothing that this process knows holds any more: a new one begins with the store.
            raise PartitionsLostError(share.ownership.lost)

    async def _share(
        self, store: Store, outbox: Outbox, revision: int, assets: Sequence[AssetSection]
    ) -> Share:
        """Begin to own partitions, and with them assets."""
        from service.store.ownership import Ownership

        settings, until = self._settings, self._waiting.until
        loop = asyncio.get_running_loop()
        changed = asyncio.Event()
        deliver = partial(deliver_earlier, settings.data_dir, store, outbox)
        await until("the store", deliver)
        own = partial(
            Ownership,
            database_address(settings.service.database_url, settings.data_dir),
            self._run,
            settings.fleet.partitions,
            on_change=partial(loop.call_soon_threadsafe, changed.set),
            on_lost=partial(loop.call_soon_threadsafe, self._stop.set),
            assets=Counter(partitions_of(assets, settings.fleet.partitions).values()),
        )
        share = Share(await until("another service to leave the database", own), changed)
        share.arrange(assets, revision)
        # The store asks it only when it knows the partition of each asset.
        store.write_only_what(share)
        return share


def fence_earlier(settings: Settings, store: Store) -> tuple[int, list[AssetSection]]:
    """Let the store take what earlier runs of this cell left, as far as no one owned it since.

    Returns all assets of the fleet, and their revision.

    Raises
    ------
    StoreUnavailableError
        If the store does not answer.
    """
    provisioned = store.assets.changed_since(0)
    tables = {one.id: one.table for one in provisioned if one.table is not None}
    checked = check_at_start(settings, tables)
    assets = [*settings.assets, *(one.section for one in checked.right.values())]
    store.write_only_what(EarlierRuns(assets, settings.fleet.partitions))
    return max((one.revision for one in provisioned), default=0), assets


def deliver_earlier(data_dir: Path, store: Store, outbox: Outbox) -> None:
    """Wait until all is delivered that earlier runs of this cell left; this one owns nothing yet.

    To a store that is another one nothing is delivered: that may last until a person comes, and
    devices are read meanwhile. The cell starts again when it is confirmed.

    Raises
    ------
    StoreUnavailableError
        If something waits still.
    """
    try:
        store.identity.check()
    except StoreDoubtedError as error:
        _log.warning("earlier_changes_wait", error=str(error))
        return
    if not outbox.flush(_DELIVERED_S):
        raise StoreUnavailableError(outbox.problem or "changes of an earlier run wait")
    for name in declared("tables", "OUTBOXES"):
        if (data_dir / name).exists():
            with Outbox.open(data_dir, store, name) as other:
                if not other.flush(_DELIVERED_S):
                    raise StoreUnavailableError(other.problem or f"changes wait in {name}")


def _load_twin() -> "tuple[type[Cell], bool]":
    """Load the live twin and what stands on it; devices are read and stored meanwhile.

    Returns
    -------
    Cell, loaded
        Loaded is False where its kernels must be compiled first, see `service.cell.kernels`.
    """
    with loading():
        load_numba()
        from service.cell.cell import Cell
        from service.kernels import load_live_kernels

        return Cell, load_live_kernels()


def be_prompt() -> None:
    """Keep the interpreter from holding up the event loop, and so the polls of the field buses.

    A collection of garbage that looks at all that the libraries brought along takes a tenth of a
    second; what is there now stays, and need not be looked at. Of 500 twins 11,000 objects live
    from one step to the next, for which the interpreter would look at everything every six
    seconds. Forecasts follow each other in a thread: to share the members of each among threads of
    its own takes longer than it saves.
    """
    import numba

    gc.freeze()
    gc.set_threshold(*_COLLECTED_AFTER)
    numba.config.NUMBA_NUM_THREADS = 1


async def _cancel(task: "asyncio.Task[Any]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
