"""``bearing-twin demo``: the whole product at work on a virtual bench, one command."""

import asyncio
import contextlib
import json
import sys
import time
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.errors import BadInputError
from service.signals import stop_on_signals

if TYPE_CHECKING:
    from rich.console import Console

    from service.demo.score import Account


def demo(
    rate: Annotated[
        float, typer.Option(help="Process seconds per wall second.", min=1, max=1000)
    ] = 120.0,
    port: Annotated[
        int, typer.Option(help="Port of the page; 0 takes a free one.", min=0, max=65535)
    ] = 8080,
    headless: Annotated[
        bool, typer.Option("--headless", help="Exit after the last stage.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
    duration_s: Annotated[
        float | None, typer.Option(help="Stop after this many wall seconds.", min=1)
    ] = None,
    stay: Annotated[
        bool,
        typer.Option("--stay", help="Keep the page after the last stage, also without a terminal."),
    ] = False,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait/--no-wait",
            help="Let the bench wait before a high-risk stage until the identification has ended.",
        ),
    ] = True,
    sisters: Annotated[
        bool,
        typer.Option(
            "--sisters",
            help="Run three bearings; the last learns from the others before its high-risk stages.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the virtual bench.")] = 0,
) -> None:
    """Watch the twin do its job: a virtual bench, real Modbus and CAN, the whole service.

    A staircase of speeds and a light extra load stage (low risk), automatic re-identification,
    then high speed and heavy load, each forecast before it begins.
    """
    # Imported here: no other command should wait for what the demo needs.
    import httpx2

    from service.cli.consoles import make_console
    from service.demo.processes import DemoError
    from service.web.listening import bind

    if sisters and not wait:
        raise BadInputError("--sisters --no-wait: expected --wait, the last bench waits for them")
    # Now, not after the minute that the preparation may take.
    with contextlib.closing(bind("127.0.0.1", port)):
        pass
    console = make_console(stderr=as_json)
    try:
        document = asyncio.run(
            _demo(
                rate,
                port,
                stay or (not headless and sys.stdin.isatty()),
                wait,
                sisters,
                duration_s,
                seed,
                console,
            )
        )
    except DemoError as error:
        sys.stderr.write(f"bearing-twin: {error}\n")
        raise typer.Exit(error.status) from error
    except httpx2.HTTPError as error:
        sys.stderr.write(f"bearing-twin: the service does not answer: {error!r}\n")
        raise typer.Exit(1) from error
    if as_json:
        typer.echo(json.dumps(document))


async def _demo(
    rate: float,
    port: int,
    stay: bool,
    wait: bool,
    sisters: bool,
    duration_s: float | None,
    seed: int,
    console: "Console",
) -> "Account":
    from rich.text import Text

    from service.demo.run import BenchWatch, run
    from service.demo.table import print_account

    # The terminal that goes away hangs up: the processes of the demo must not stay behind.
    stop = stop_on_signals()
    began = time.monotonic()

    def report(line: str) -> None:
        minutes, seconds = divmod(int(time.monotonic() - began), 60)
        at = Text(f"{minutes:02d}:{seconds:02d}", "dim")
        console.print(at, f" {line}", soft_wrap=True)

    def at_the_end(document: "Account") -> None:
        print_account(document, console)

    return await run(
        rate=rate,
        port=port,
        seed=seed,
        watch=BenchWatch(stop, duration_s),
        wait=wait,
        stay=stay,
        sisters=sisters,
        report=report,
        at_the_end=at_the_end,
    )
