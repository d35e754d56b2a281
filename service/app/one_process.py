"""Runs all sides of a service in one process, where a debugger reaches them all."""

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from service.app.serve import check_installed
from service.app.sides import address_of, listen, tls_of
from service.cell.start import run_cell
from service.plant.publishers import any_enabled
from service.plant.start import run_plant
from service.service_manager import ServiceManager
from service.site.settings import Settings
from service.tasks import background
from service.waiting import StoppedError
from service.web.start import run_web


async def serve_in_one_process(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run all sides of a service until ``stop`` is set; a call of one can delay the others.

    Raises `SettingsError` or `StoreError` if the configuration or the data directory cannot be
    used; `TemporaryError` if another service, or another program on the port, did not leave in
    time.
    """
    check_installed(settings)
    manager = ServiceManager()
    alive = asyncio.Event()

    def has_gone_on() -> bool:
        gone_on = alive.is_set()
        alive.clear()
        return gone_on

    async def web() -> None:
        listener = await listen(settings, stop)
        address = address_of(settings, listener)
        await run_web(
            settings,
            listener=listener,
            tls=tls_of(settings),
            stop=stop,
            ready=partial(announce, address),
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
