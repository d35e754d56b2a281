"""Runs the service of a configuration: all its sides under the supervisor, or one of them."""

import asyncio
import contextlib
import socket
from collections.abc import Callable

from service.app.sides import listen, run_side
from service.app.supervisor import supervise
from service.domain.errors import TemporaryError
from service.domain.sides import SideName
from service.plant.publishers import check_extras
from service.service_manager import ServiceManager
from service.site.settings import Settings
from service.waiting import StoppedError
from service.web.listening import bind


async def serve(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run all sides of a service until ``stop`` is set.

    Parameters
    ----------
    settings : Settings
        The configuration.
    announce : callable
        Called with the address of the web side once all sides are ready.
    stop : asyncio.Event
        Set it to end the service cleanly.

    Raises
    ------
    SettingsError
        If the address of the web side cannot be used, or a notification.
    TemporaryError
        If another program did not leave the port in time.
    SideEndedError
        If a side cannot work; it has said why.
    """
    check_extras(settings)
    if settings.notifications:  # what they need takes a while to load
        from service.notifications.senders import check_senders

        check_senders(settings)
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
        scheme = "http" if settings.tls is None else "https"
        host, port = settings.service.host, listener.getsockname()[1]
        address = f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/"
        return listener

    with contextlib.suppress(StoppedError):
        await supervise(
            settings,
            listen=listening,
            manager=manager,
            on_ready=lambda: announce(address),
            stop=stop,
        )


async def serve_side(
    side: SideName, settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run one side until ``stop`` is set; another program starts and watches the others."""
    with contextlib.suppress(StoppedError):
        await run_side(side, settings, stop, on_ready=lambda: announce(f"{side} is ready"))
