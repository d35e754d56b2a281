"""``bearing-twin serve``: the service of one configuration file."""

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import structlog
import typer

from service.cli.errors import BadInputError
from service.domain.sides import SideName
from service.loading import loading
from service.logs import configure_logging
from service.signals import leave_tasks_behind, leave_threads_behind, stop_on_signals
from service.site.configuration import readable_secrets
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
        return  # its reader says that it cannot be read
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
    one_process: Annotated[
        bool,
        typer.Option(
            "--one-process",
            help="Run cell, web and plant side in this process, for a debugger. Not for a plant: "
            "callers delay the reading of devices, and nothing is started again.",
        ),
    ] = False,
) -> int:
    """Run the service: acquisition, store, live twin, REST, WebSocket and dashboard.

    Ends cleanly on SIGTERM or SIGINT; nothing that was accepted is lost.
    """
    # Imported here: drivers and store take a second to load, which --help should not pay.
    with loading():
        from service.app.checking import machine_warnings
        from service.app.work_folders import use_work_folders
        from service.plant.publishers import warnings as publisher_warnings
        from service.site.examination import load_site

    if one_process and only is not None:
        raise BadInputError("--one-process: expected without --only")
    begin_file(config)
    settings, warnings = load_site(config)
    lines = [*publisher_warnings(settings), *readable_secrets(config)]
    warnings += (*(f"{config}: {line}" for line in lines), *machine_warnings())
    use_work_folders(settings.data_dir)
    configure_logging()
    status = asyncio.run(_serve(settings, warnings, only, one_process))
    leave_threads_behind()
    return status


async def _serve(
    settings: Settings, warnings: Sequence[str], only: SideName | None, one_process: bool
) -> int:
    with loading():
        from service.app.serve import serve, serve_side
        from service.app.supervisor import SideEndedError

    stop = stop_on_signals()

    def announce(address: str) -> None:
        typer.echo(address)
        # Not before: a start that is refused ends with its own line alone.
        for warning in warnings:
            _log.warning("configuration", detail=warning)

    try:
        if one_process:
            with loading():
                from service.app.one_process import serve_in_one_process

            await serve_in_one_process(settings, announce=announce, stop=stop)
        elif only is None:
            await serve(settings, announce=announce, stop=stop)
        else:
            await serve_side(only, settings, announce=announce, stop=stop)
    except SideEndedError as error:
        return error.status
    await leave_tasks_behind()
    return 0
