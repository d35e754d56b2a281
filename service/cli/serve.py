"""``bearing-twin serve``: the service of one configuration file."""

import asyncio
import gc
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import structlog
import typer

from service.logs import configure_logging
from service.signals import leave_tasks_behind, leave_threads_behind, stop_on_signals
from service.site.settings import Settings

ConfigFile = Annotated[
    Path | None,
    typer.Option("-c", "--config", help="Configuration file (TOML).", dir_okay=False),
]

_log = structlog.get_logger(__name__)


def serve(config: ConfigFile = None) -> None:
    """Run the service: acquisition, store, live twin, REST, WebSocket and dashboard.

    Ends cleanly on SIGTERM or SIGINT; nothing that was accepted is lost.
    """
    # Imported here: drivers and store take a second to load, which --help should not pay.
    from service.app.checking import load_site

    settings, warnings = load_site(config)
    configure_logging()
    asyncio.run(_serve(settings, warnings))
    leave_threads_behind()


async def _serve(settings: Settings, warnings: Sequence[str]) -> None:
    stop = stop_on_signals()
    # Imported here: the compiled twin takes a second to load, which no other command should pay.
    from service.app import start

    # What has been loaded stays: a garbage collection need not look through it while samples,
    # of which every one is an object, come and go.
    gc.freeze()

    def announce(address: str) -> None:
        typer.echo(address)
        # Not before: a start that is refused ends with its own line alone.
        for warning in warnings:
            _log.warning("configuration", detail=warning)

    await start.serve(settings, announce=announce, stop=stop)
    await leave_tasks_behind()
