"""The connection of a process to the bus of a fleet, as the configuration says."""

import asyncio
import importlib.util
import os
import socket
import ssl
from functools import partial
from typing import Final
from urllib.parse import urlsplit

from anyio import to_thread

from service.bus.directory import Directory
from service.bus.fleet_cells import Fleet
from service.bus.nats_bus import NatsConnection
from service.site.configuration import SettingsError
from service.site.settings import Settings
from service.store import Store

_TRY_S: Final = 5


def connection_of(settings: Settings, what: str) -> NatsConnection:
    """Make the connection of a process; it connects when it is run.

    Raises
    ------
    SettingsError
        If the extra is not installed, or a certificate cannot be read.
    """
    _require_extra()
    name = f"bearing-twin {what} {socket.gethostname()} {os.getpid()}"
    return NatsConnection(settings.fleet.nats_url, _tls(settings), name)


def fleet_of(settings: Settings, store: Store, directory: Directory, what: str) -> Fleet:
    """Give all cells of a fleet to a web or plant side; see `connection_of`."""
    return Fleet(
        connection_of(settings, what),
        settings.fleet.partitions,
        directory.ids,
        partial(to_thread.run_sync, store.alarms.load, abandon_on_cancel=True),
        partial(to_thread.run_sync, store.partition_owners.load, abandon_on_cancel=True),
    )


def connection_problem(settings: Settings) -> str | None:
    """Try to reach the server; say in one line why it cannot be, or None."""
    from nats.aio.client import Client
    from nats.errors import Error

    async def connect() -> None:
        client = Client()

        async def quiet(error: Exception) -> None:
            pass

        try:
            await client.connect(
                settings.fleet.nats_url,
                tls=_tls(settings),
                allow_reconnect=False,
                connect_timeout=_TRY_S,
                error_cb=quiet,
            )
        finally:
            await client.close()

    try:
        _require_extra()
        asyncio.run(connect())
    except SettingsError as error:
        return str(error)
    except (Error, OSError, TimeoutError) as error:
        place = urlsplit(settings.fleet.nats_url)
        why = " ".join(str(error).split()) or type(error).__name__
        return f"fleet.nats_url ({place.hostname}:{place.port or 4222}): {why}"
    return None


def _require_extra() -> None:
    if importlib.util.find_spec("nats") is None:
        raise SettingsError(
            "fleet.nats_url: needs the extra 'fleet'; pip install 'bearing-twin[fleet]'"
        )


def _tls(settings: Settings) -> ssl.SSLContext | None:
    fleet = settings.fleet
    if not fleet.nats_url.startswith("tls:"):
        return None
    ca, certificate, key = (
        None if file is None else str(settings.path(file))
        for file in (fleet.nats_ca, fleet.nats_certificate, fleet.nats_key)
    )
    try:
        context = ssl.create_default_context(cafile=ca)
        if certificate is not None:
            context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise SettingsError(f"fleet.nats_ca, nats_certificate, nats_key: {error}") from error
    return context
