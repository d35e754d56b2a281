"""Runs the service of a configuration: all its sides under the supervisor, or one of them."""

import asyncio
import contextlib
import socket
from collections.abc import Callable

from service.app.sides import address_of, listen, run_side
from service.app.supervisor import supervise
from service.domain.errors import TemporaryError
from service.domain.sides import SideName
from service.feature_folders import modules
from service.plant.publishers import check_extras
from service.service_manager import ServiceManager
from service.site.settings import Settings
from service.waiting import StoppedError
from service.web.listening import bind


async def serve(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run all sides of a service until ``stop`` is set.

    Raises `SettingsError` if the address of the web side cannot be used, or a section of a
    feature. Raises
    `TemporaryError` if another program did not leave the port in time. Raises `SideEndedError` if a
    side cannot work; it has said why.
    """
    check_installed(settings)
    manager = ServiceManager()
    address = ""

    async def listening(cell_is_ready: asyncio.Event) -> socket.socket:
        nonlocal address
        try:
            listener = bind(settings.service.host, settings.service.port)
        except TemporaryError:
            # If another service has the port it has the data directory too, and that says more.
            await cell_is_ready.wait()
            listener = await listen(
                settings, stop, lambda what, why: manager.status(f"waits for {what}: {why}")
            )
        address = address_of(settings, listener)
        return listener

    with contextlib.suppress(StoppedError):
        await supervise(
            settings,
            listen=listening,
            manager=manager,
            on_ready=lambda: announce(address),
            stop=stop,
        )


def check_installed(settings: Settings) -> None:
    """Refuse a configuration that needs what is not installed.

    Raises `SettingsError` if a publisher or a section of a feature cannot be used.
    """
    check_extras(settings)
    for _, feature in modules("settings"):
        feature.check(settings)


async def serve_side(
    side: SideName, settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run one side until ``stop`` is set; another program starts and watches the others."""
    with contextlib.suppress(StoppedError):
        await run_side(side, settings, stop, on_ready=lambda: announce(f"{side} is ready"))
