"""``bearing-twin notifications``: whether messages about alarms arrive."""

import asyncio
from typing import Annotated

import typer

from service.cli.errors import BadInputError
from service.cli.keys import command_line_actor
from service.cli.serve import ConfigFile
from service.site.settings import load_settings

notifications = typer.Typer(help="Messages about alarms.", no_args_is_help=True)


@notifications.callback()
def _notifications() -> None: ...


@notifications.command("test")
def send_message(
    notification: Annotated[
        str, typer.Argument(metavar="ID", help="Id of a notification of the configuration.")
    ],
    config: ConfigFile = None,
) -> None:
    """Send a test message to a notification's receivers, whether a service runs or not.

    The status is 1 if nobody took it; the line on standard error says why.
    """
    from service.logs import configure_logging
    from service.notifications.notifier import send_test

    configure_logging("warning")
    settings = load_settings(config)
    known = {one.id: one for one in settings.notifications}
    if notification not in known:
        names = ", ".join(known) or "none"
        raise BadInputError(f"no notification {notification!r}; the configuration has: {names}")
    who = command_line_actor().who
    told, detail = asyncio.run(send_test(settings, known[notification], who))
    if detail:
        typer.echo(f"bearing-twin: {notification}: {detail}", err=True)
    if not told:
        raise typer.Exit(1)
    typer.echo(f"{notification}: told {', '.join(known[notification].receivers)}")
