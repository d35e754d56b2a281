"""``bearing-twin notifications``: whether messages about alarms arrive."""

import asyncio
from typing import Annotated

import typer

from service.cli.errors import BadInputError
from service.cli.keys import command_line_actor
from service.cli.serve import ConfigFile
from service.features.notifications.sections import sections_of
from service.site.settings import load_settings

notifications = typer.Typer(help="Messages about alarms.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add ``notifications``."""
    app.add_typer(notifications, name="notifications")


@notifications.callback()
def _notifications() -> None: ...


@notifications.command("test")
def send_message(
    notification: Annotated[
        str, typer.Argument(metavar="ID", help="Id of a notification of the configuration.")
    ],
    config: ConfigFile = None,
) -> None:
    """Send a test message to the recipients of a notification, whether a service runs or not.

    The status is 1 if no recipient accepted it; the line on standard error says why.
    """
    from service.features.notifications.senders import send_test
    from service.logs import configure_logging

    configure_logging("warning")
    settings = load_settings(config)
    sections = {one.id: one for one in sections_of(settings).notifications}
    if notification not in sections:
        names = ", ".join(sections) or "none"
        raise BadInputError(f"no notification {notification!r}; the configuration has: {names}")
    who = command_line_actor().who
    sent, detail = asyncio.run(send_test(settings, sections[notification], who))
    if detail:
        typer.echo(f"bearing-twin: {notification}: {detail}", err=True)
    if not sent:
        raise typer.Exit(1)
    typer.echo(f"{notification}: sent to {', '.join(sections[notification].receivers)}")
