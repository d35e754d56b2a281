"""``bearing-twin virtual-bench``: the hardware stand-in as a process of its own."""

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.errors import BadInputError
from service.logs import configure_logging
from service.signals import stop_on_signals

if TYPE_CHECKING:
    from adapters.virtual_bench import BenchAnnouncement

# The bench itself is imported later, see below; a test holds the two together.
SCENARIO_NAMES = (
    "staircase",
    "load-steps",
    "rapid-acceleration",
    "sensor-break",
    "durability",
    "grease-degradation",
    "cooling-loss",
    "overload",
    "demo",
)


def virtual_bench(
    scenario_name: Annotated[
        str, typer.Option("--scenario", help=f"Test plan: {', '.join(SCENARIO_NAMES)}.")
    ] = "staircase",
    rate: Annotated[float, typer.Option(help="Process seconds per wall second.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Seed of noise and drift; runs can be repeated.")] = 0,
    specimen: Annotated[
        int | None,
        typer.Option(
            help="Seed of another specimen of the bench: bearing, housing and friction drawn again."
        ),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    modbus_port: Annotated[int, typer.Option(help="Modbus TCP port; 0 takes a free one.")] = 5020,
    can_port: Annotated[int, typer.Option(help="slcan port; 0 takes a free one.")] = 5021,
    truth: Annotated[
        Path | None, typer.Option(help="Write all node temperatures to this CSV file.")
    ] = None,
    wait_for_start: Annotated[
        bool,
        typer.Option(
            "--wait-for-start",
            help="Wait at standstill until coil 0 of the controller (unit 2) is set.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the addresses as one JSON line.")
    ] = False,
) -> None:
    """Run a virtual bench that talks real Modbus TCP and CAN (slcan over TCP)."""
    # Imported here: the compiled bench takes half a second, which no other command should pay.
    from adapters.virtual_bench import find_scenario, run

    configure_logging("warning")
    chosen = find_scenario(scenario_name)

    def announce(facts: "BenchAnnouncement") -> None:
        if as_json:
            typer.echo(json.dumps(facts))
            return
        typer.echo(
            f"Modbus TCP {facts['modbus']['host']}:{facts['modbus']['port']}, "
            f"CAN (slcan) {facts['can']['channel']}, scenario {facts['scenario']}, "
            f"rate x{facts['rate']:g}, seed {facts['seed']}"
        )

    async def until_stopped() -> None:
        await run(
            chosen,
            rate=rate,
            seed=seed,
            specimen=specimen,
            host=host,
            modbus_port=modbus_port,
            can_port=can_port,
            truth=truth,
            wait_for_start=wait_for_start,
            announce=announce,
            stop=stop_on_signals(),
        )

    try:
        asyncio.run(until_stopped())
    except ValueError as error:
        raise BadInputError(str(error)) from error
