"""Starts the service, waits for what is not there yet, and stops it cleanly."""

import asyncio
import contextlib
import gc
import ssl
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from anyio import to_thread

from service.cell.acquisition import Acquisition
from service.cell.cell import Service
from service.clock import ProcessClock, wall_us
from service.ingest import Spool
from service.kernels import compile_kernels
from service.plant.protocol import Host
from service.plant.publishers import check_extras, check_ports, make_publishers
from service.security.loopback import is_loopback
from service.security.tls import tls_context
from service.service_manager import ServiceManager
from service.site.configuration import SettingsError
from service.site.settings import Settings
from service.site.wiring import wire
from service.store import (
    DatabaseInUseError,
    DatabaseLock,
    DataDirectoryLock,
    Outbox,
    Store,
    lock_data_directory,
    lock_database,
)
from service.store.errors import opening_error
from service.tasks import INGEST, background
from service.waiting import StoppedError, Waiting
from service.web.listening import bind
from service.web.side import WebSide

#: Wall seconds that another service is given to leave the data directory or the port. A service
#: that is stopped needs ten at most.
LEAVE_S = 30.0
#: And the database: a server notices within half a minute that another machine is gone.
LEAVE_DATABASE_S = 60.0
#: Wall seconds after which devices are read though the store is not open yet.
ACQUIRE_AFTER_S = 1.0
#: Wall seconds for the last changes of alarms; what the store does not take then stays on the disk.
OUTBOX_S = 1.0


async def serve(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run the service of a configuration until ``stop`` is set.

    What is not there yet is waited for: another service that still holds the data directory, the
    port or the database, a database server that is not up yet, a locked store, room on the disk.
    Devices are read meanwhile, as soon as the data directory and the spool can be used, and the
    web side answers that the service is not ready.

    Parameters
    ----------
    settings : Settings
        The configuration.
    announce : callable
        Called with the address of the web side once the service is ready.
    stop : asyncio.Event
        Set it to end the service cleanly.

    Raises
    ------
    SettingsError, StoreError
        If the configuration or the data directory cannot be used.
    TemporaryError
        If another service, or another program on the port, did not leave in time.
    """
    with contextlib.suppress(StoppedError):
        await _Start(settings, announce, stop).run()


class _Start:
    """One run of a service, from its first wait to its end."""

    def __init__(
        self, settings: Settings, announce: Callable[[str], None], stop: asyncio.Event
    ) -> None:
        self._settings = settings
        self._announce = announce
        self._stop = stop
        self._wiring = wire(settings)
        check_extras(settings)
        tls = settings.tls
        self._tls: ssl.SSLContext | None = None
        if tls is not None:
            self._tls = tls_context(settings.path(tls.certificate), settings.path(tls.key))
        self._port = settings.service.port
        self._web = WebSide()
        self._manager = ServiceManager()
        self._waiting = Waiting(stop, self._waits_for)
        # What is open until the last sample has been written.
        self._open = contextlib.ExitStack()

    def _waits_for(self, what: str, why: str) -> None:
        self._web.waits_for = what
        self._manager.status(f"waits for {what}: {why}" if what else "starts")

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
            acquisition = Acquisition(self._wiring, clock, spool)
            async with contextlib.AsyncExitStack() as running:
                opening = asyncio.create_task(self._open_store(running))
                running.push_async_callback(_cancel, opening)
                # What a person must mend is mostly found at once, before any device is asked.
                await asyncio.wait({opening}, timeout=ACQUIRE_AFTER_S)
                if opening.done():
                    opening.result()
                await running.enter_async_context(
                    background(acquisition.ingest.run(acquisition.drivers), INGEST, self._stop)
                )
                await running.enter_async_context(
                    background(
                        self._manager.watch(acquisition.ingest.has_gone_on),
                        "supervision",
                        self._stop,
                    )
                )
                running.callback(self._manager.stopping)
                # Devices are read and what they say is kept, whatever is waited for.
                self._manager.ready()
                store, database_lock = await opening
                await self._work(store, acquisition, clock)
                lost = database_lock.lost
        if lost:
            raise DatabaseInUseError(lost)

    def _open_spool(self) -> tuple[Spool, ProcessClock]:
        settings = self._settings
        spool = Spool.open(settings.data_dir, settings.service.spool_mib)
        try:
            return spool, ProcessClock.resume(settings.clock.rate, settings.data_dir)
        except OSError as error:
            spool.close()
            raise opening_error(f"data directory {settings.data_dir}: {error}", error) from error

    async def _open_store(
        self, running: contextlib.AsyncExitStack
    ) -> tuple[Store, DatabaseLock | DataDirectoryLock]:
        """Listen, and open all that the service needs next to its devices."""
        settings, until = self._settings, self._waiting.until
        service, data_dir = settings.service, settings.data_dir
        listener = await until("its port", partial(bind, service.host, service.port), LEAVE_S)
        self._open.callback(listener.close)
        self._port = listener.getsockname()[1]
        await running.enter_async_context(
            background(self._web.run(listener, self._tls), "web", self._stop)
        )
        await until("the port for OPC UA", partial(check_ports, settings), LEAVE_S)
        url = service.database_url
        store = await until("the store", partial(Store.open, url, data_dir))
        self._open.callback(store.close)
        loop = asyncio.get_running_loop()
        lost = partial(loop.call_soon_threadsafe, self._stop.set)
        lock = await until(
            "another service to leave the database",
            partial(lock_database, url, data_dir, lost),
            LEAVE_DATABASE_S,
        )
        self._open.callback(lock.close)
        if not is_loopback(service.host):
            await until("the store", partial(_check_key, store, service.host))
        return store, lock

    async def _work(self, store: Store, acquisition: Acquisition, clock: ProcessClock) -> None:
        """Store what has been acquired so far, and run the rest of the service."""
        settings, until = self._settings, self._waiting.until
        acquisition.ingest.attach(store, await until("the store", store.samples.open_ends))
        await until("its compiled kernels", compile_kernels)
        outbox = await until("room on the disk", partial(Outbox.open, settings.data_dir, store))
        try:
            make = partial(Service, settings, self._wiring, store, outbox, clock, acquisition)
            service = await until("the store", make)
            state = service.app.state
            host = Host(tuple(service.assets), state.authenticator, state.trail, settings.data_dir)
            publishers = make_publishers(
                settings, service.assets, service.bus, host, service.registry
            )
            _be_prompt()
            beside = [(one.name, one.run) for one in publishers]
            await service.run(self._web, self._stop, beside, self._ready)
        finally:
            await to_thread.run_sync(outbox.close, OUTBOX_S)

    def _ready(self) -> None:
        host = self._settings.service.host
        scheme = "http" if self._tls is None else "https"
        self._manager.status("runs")
        self._announce(f"{scheme}://{f'[{host}]' if ':' in host else host}:{self._port}/")


def _be_prompt() -> None:
    """Keep the interpreter from holding up the event loop, and so the polls of the field buses.

    A collection of garbage that looks at all that the libraries brought along takes a tenth of a
    second; what is there now stays, and need not be looked at. A thread that reads or judges
    lets go of the interpreter after a millisecond instead of five.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(0.001)


def _check_key(store: Store, host: str) -> None:
    now_us = wall_us()
    if not any(key.is_valid(now_us) for key in store.access.list_keys()):
        raise SettingsError(
            f"service.host = {host!r}: reachable from other machines, so at least one API key "
            "is needed; make one with 'bearing-twin keys create --role admin -c FILE'"
        )


async def _cancel(task: "asyncio.Task[Any]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
