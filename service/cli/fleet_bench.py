"""``bearing-twin virtual-fleet``: many virtual benches behind few Modbus ports, in one process."""

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.errors import BadInputError
from service.logs import configure_logging
from service.signals import stop_on_signals

if TYPE_CHECKING:
    from adapters.virtual_bench import FleetAnnouncement


def virtual_fleet(
    benches: Annotated[int, typer.Option(help="Number of benches.")] = 50,
    rate: Annotated[float, typer.Option(help="Process seconds per wall second.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Seed of benches, duties, noise and drift.")] = 0,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    modbus_port: Annotated[
        int, typer.Option(help="First Modbus TCP port, one per gateway; 0 takes free ones.")
    ] = 5020,
    gateways: Annotated[
        int | None,
        typer.Option(
            help="Spread the benches evenly over so many ports at most; by default 247 go to one."
        ),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Write the true temperatures of all to this CSV file.")
    ] = None,
    configuration: Annotated[
        Path | None,
        typer.Option(help="Write a configuration of a service that reads all benches."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the addresses as one JSON line.")
    ] = False,
) -> None:
    """Run many virtual benches; each is a unit of a Modbus TCP gateway."""
    # Imported here: the compiled bench takes half a second, which no other command should pay.
    from adapters.virtual_bench import run_fleet
    from service.demo.fleet_configuration import write_fleet_configuration

    configure_logging("warning")

    def announce(facts: "FleetAnnouncement") -> None:
        if configuration is not None:
            try:
                write_fleet_configuration(configuration, facts)
            except OSError as error:
                reason = error.strerror or str(error)
                raise BadInputError(
                    f"configuration {str(configuration)!r}: cannot be written: {reason}"
                ) from error
        if as_json:
            typer.echo(json.dumps(facts))
            return
        where = ", ".join(
            f"{one['host']}:{one['port']} (units 1 to {one['units']})" for one in facts["modbus"]
        )
        typer.echo(
            f"Modbus TCP {where}, {facts['benches']} benches, rate x{facts['rate']:g}, "
            f"seed {facts['seed']}"
        )

    async def until_stopped() -> None:
        await run_fleet(
            benches,
            rate=rate,
            seed=seed,
            host=host,
            modbus_port=modbus_port,
            gateways=gateways,
            truth=truth,
            announce=announce,
            stop=stop_on_signals(),
        )

    try:
        asyncio.run(until_stopped())
    except ValueError as error:
        raise BadInputError(str(error)) from error
