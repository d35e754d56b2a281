"""Starts the cell: devices are read first, and the rest joins as soon as its store is there."""

import asyncio
import contextlib
import gc
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
from anyio import to_thread

from service.bus.fleet_connection import connection_of
from service.bus.local import LocalCellBus
from service.bus.messages import State
from service.bus.nats_bus import NatsCellBus
from service.cell.acquisition import Acquisition
from service.cell.cell import Cell
from service.cell.known_assets import read_copy
from service.cell.share import Share
from service.clock import ProcessClock
from service.ingest import Spool
from service.kernels import compile_live_kernels
from service.site.provisioning import check_assets
from service.site.settings import Settings
from service.site.wiring import Wiring, wire
from service.store import (
    DatabaseInUseError,
    DatabaseLock,
    DataDirectoryLock,
    Outbox,
    Ownership,
    Store,
    StoreUnavailableError,
    lock_data_directory,
    lock_database,
    run_name,
)
from service.store.errors import opening_error
from service.store.opening import database_address
from service.tasks import INGEST, background
from service.waiting import LEAVE_DATABASE_S, LEAVE_S, StoppedError, Waiting

#: Wall seconds after which devices are read though the store is not open yet.
ACQUIRE_AFTER_S = 1.0
#: Wall seconds for the last changes of alarms; what the store does not take then stays on the disk.
OUTBOX_S = 1.0
#: And for those that an earlier run left.
_DELIVERED_S = 10.0
_ALIVE_EVERY_S = 1.0


class PartitionsLostError(RuntimeError):
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
        self._bus: LocalCellBus | NatsCellBus | None = None
        # Names this run among all cells, where there are several.
        self._run = run_name() if settings.is_fleet else ""
        # What is open until the last sample has been written.
        self._open = contextlib.ExitStack()

    def _waits_for(self, what: str, why: str) -> None:
        self._status(f"waits for {what}: {why}" if what else "starts")
        if self._bus is not None:
            self._bus.report(State(what))

    async def run(self) -> None:
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

    async def _make_bus(self, running: contextlib.AsyncExitStack) -> LocalCellBus | NatsCellBus:
        if self._settings.is_fleet:
            connection = connection_of(self._settings, "cell")
            bus = NatsCellBus(connection, self._run)
            await running.enter_async_context(background(connection.run(), "bus", self._stop))
            return bus
        local = LocalCellBus(self._settings.data_dir)
        self._open.callback(local.close)
        return local

    def _known_assets(self) -> dict[str, Wiring]:
        """What is read for assets of the store, as far as they were known before this start."""
        right, _ = check_assets(self._settings, read_copy(self._settings.data_dir))
        return {name: one.wiring for name, one in right.items()}

    async def _watch(self, acquisition: Acquisition) -> None:
        while True:
            await asyncio.sleep(_ALIVE_EVERY_S)
            if acquisition.ingest.has_gone_on():
                self._alive()

    def _open_spool(self) -> tuple[Spool, ProcessClock]:
        settings = self._settings
        spool = Spool.open(settings.data_dir, settings.service.spool_mib)
        try:
            return spool, ProcessClock.resume(settings.clock.rate, settings.data_dir)
        except OSError as error:
            spool.close()
            raise opening_error(f"data directory {settings.data_dir}: {error}", error) from error

    async def _open_store(self) -> tuple[Store, DatabaseLock | DataDirectoryLock | None]:
        """Open all that the cell needs beside its devices."""
        settings, until = self._settings, self._waiting.until
        service, data_dir = settings.service, settings.data_dir
        url = service.database_url
        store = await until("the store", partial(Store.open, url, data_dir, run=self._run))
        self._open.callback(store.close)
        if settings.is_fleet:
            return store, None
        loop = asyncio.get_running_loop()
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
        clock: ProcessClock,
        bus: LocalCellBus | NatsCellBus,
        answering: "asyncio.Task[None]",
    ) -> None:
        """Store what has been acquired so far, and run the rest of the cell."""
        settings, until = self._settings, self._waiting.until
        ends = {} if settings.is_fleet else await until("the store", store.samples.open_ends)
        acquisition.ingest.attach(store, ends)
        await until("its compiled kernels", compile_live_kernels)
        open_outbox = partial(Outbox.open, settings.data_dir, store, run=self._run)
        outbox = await until("room on the disk", open_outbox)
        share: Share | None = None
        try:
            if settings.is_fleet:
                share = await self._share(store, outbox)
            make = partial(
                Cell, settings, self._wiring, store, outbox, clock, acquisition, bus, share
            )
            cell = await until("the store", make)
            be_prompt()
            await _cancel(answering)
            await cell.run(self._stop, lambda: self._status("runs"))
        finally:
            await to_thread.run_sync(outbox.close, OUTBOX_S)
            if share is not None:
                # No device may have two readers: ours end before another cell may begin.
                await acquisition.read_for({})
                await to_thread.run_sync(share.ownership.close)
        if share is not None and share.ownership.lost:
            # Nothing that this process knows holds any more: a new one begins with the store.
            raise PartitionsLostError(share.ownership.lost)

    async def _share(self, store: Store, outbox: Outbox) -> Share:
        """Begin to own partitions, and with them assets."""
        settings, until = self._settings, self._waiting.until
        loop = asyncio.get_running_loop()
        changed = asyncio.Event()

        # What an earlier run left is written while nobody else has taken its partitions.
        def deliver() -> None:
            if not outbox.flush(_DELIVERED_S):
                raise StoreUnavailableError(outbox.problem or "changes of an earlier run wait")

        await until("the store", deliver)
        own = partial(
            Ownership,
            database_address(settings.service.database_url, settings.data_dir),
            self._run,
            settings.fleet.partitions,
            on_change=partial(loop.call_soon_threadsafe, changed.set),
            on_lost=partial(loop.call_soon_threadsafe, self._stop.set),
        )
        share = Share(await until("another service to leave the database", own), changed)
        store.write_only_what(share)
        return share


def be_prompt() -> None:
    """Keep the interpreter from holding up the event loop, and so the polls of the field buses.

    A collection of garbage that looks at all that the libraries brought along takes a tenth of a
    second; what is there now stays, and need not be looked at. A thread that reads or judges
    lets go of the interpreter after a millisecond instead of five. Forecasts follow each other in
    a thread: to share the members of each among threads of its own takes longer than it saves.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(0.001)
    numba.config.NUMBA_NUM_THREADS = 1


async def _cancel(task: "asyncio.Task[Any]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
