"""A whole service in this process, for tests that reach into it; wires and bus are real."""

import asyncio
import contextlib
import ssl
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from service.cell.start import run_cell
from service.plant.publishers import any_enabled, check_extras
from service.plant.start import run_plant
from service.security.tls import tls_context
from service.service_manager import ServiceManager
from service.site.settings import Settings
from service.site.wiring import wire
from service.tasks import background
from service.waiting import LEAVE_S, StoppedError, Waiting
from service.web.listening import bind
from service.web.start import run_web


async def serve(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run the service of a configuration until ``stop`` is set, all in this process.

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
    wire(settings)
    check_extras(settings)
    tls: ssl.SSLContext | None = None
    if settings.tls is not None:
        tls = tls_context(settings.path(settings.tls.certificate), settings.path(settings.tls.key))
    manager = ServiceManager()
    alive = asyncio.Event()

    def has_gone_on() -> bool:
        gone_on = alive.is_set()
        alive.clear()
        return gone_on

    async def web() -> None:
        service = settings.service
        waiting = Waiting(stop, lambda what, why: None)
        listener = await waiting.until(
            "its port", partial(bind, service.host, service.port), LEAVE_S
        )
        port = listener.getsockname()[1]
        scheme = "http" if tls is None else "https"
        host = f"[{service.host}]" if ":" in service.host else service.host
        await run_web(
            settings,
            listener=listener,
            tls=tls,
            stop=stop,
            ready=lambda: announce(f"{scheme}://{host}:{port}/"),
        )

    sides: list[Coroutine[Any, Any, None]] = [web()]
    if any_enabled(settings):
        sides.append(run_plant(settings, stop=stop, ready=lambda: None))
    cell_stop = asyncio.Event()
    cell = asyncio.create_task(
        run_cell(
            settings,
            stop=cell_stop,
            ready=manager.ready,
            status=manager.status,
            alive=alive.set,
        )
    )
    others = [asyncio.create_task(side) for side in sides]
    stopping = asyncio.create_task(stop.wait())
    async with background(manager.watch(has_gone_on), "supervision", stop):
        await asyncio.wait({cell, stopping, *others}, return_when=asyncio.FIRST_COMPLETED)
        stop.set()
        manager.stopping()
        # The cell last: what the others still bring is kept.
        await asyncio.wait(others)
        cell_stop.set()
        await asyncio.wait({cell})
    stopping.cancel()
    for task in (cell, *others):
        with contextlib.suppress(StoppedError):
            task.result()
