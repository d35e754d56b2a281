"""``bearing-twin serve``: the service of one configuration file."""

import asyncio
import gc
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import structlog
import typer

from service.domain.sides import SideName
from service.logs import configure_logging
from service.signals import leave_tasks_behind, leave_threads_behind, stop_on_signals
from service.site.settings import Settings

ConfigFile = Annotated[
    Path | None,
    typer.Option("-c", "--config", help="Configuration file (TOML).", dir_okay=False),
]

_FIRST_LINE = "# Configuration of Bearing Twin. The page Commissioning fills it.\n"

_log = structlog.get_logger(__name__)


def begin_file(config: ConfigFile) -> None:
    """Make a configuration file that is not there yet, so that the page can fill it."""
    if config is None or config.exists() or not config.parent.is_dir():
        return
    try:
        config.write_text(_FIRST_LINE, encoding="utf-8")
    except OSError:
        return  # whoever reads it says that it cannot be read
    sys.stderr.write(f"bearing-twin: {config} is new and empty; commission the bench on the page\n")


def serve(
    config: ConfigFile = None,
    only: Annotated[
        SideName | None,
        typer.Option(
            "--only",
            help="Run one side alone: cell (acquisition, twins, alarms), web (REST, stream, pages) "
            "or plant (OPC UA, MQTT, Modbus). Without it all run, and each is started again if it "
            "dies.",
        ),
    ] = None,
) -> int:
    """Run the service: acquisition, store, live twin, REST, WebSocket and dashboard.

    Ends cleanly on SIGTERM or SIGINT; nothing that was accepted is lost.
    """
    # Imported here: drivers and store take a second to load, which --help should not pay.
    from service.plant.publishers import warnings as publisher_warnings
    from service.site.examination import load_site

    begin_file(config)
    settings, warnings = load_site(config)
    warnings += tuple(f"{config}: {line}" for line in publisher_warnings(settings))
    configure_logging()
    status = asyncio.run(_serve(settings, warnings, only))
    leave_threads_behind()
    return status


async def _serve(settings: Settings, warnings: Sequence[str], only: SideName | None) -> int:
    from service.app.serve import serve, serve_side
    from service.app.supervisor import SideEndedError

    stop = stop_on_signals()
    # What has been loaded stays: a garbage collection need not look through it while samples,
    # of which every one is an object, come and go.
    gc.freeze()

    def announce(address: str) -> None:
        typer.echo(address)
        # Not before: a start that is refused ends with its own line alone.
        for warning in warnings:
            _log.warning("configuration", detail=warning)

    try:
        if only is None:
            await serve(settings, announce=announce, stop=stop)
        else:
            await serve_side(only, settings, announce=announce, stop=stop)
    except SideEndedError as error:
        return error.status
    await leave_tasks_behind()
    return 0
