"""``bearing-twin demo``: the whole product at work on a virtual bench, one command."""

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import httpx2
import typer
from rich.console import Console
from rich.table import Table

from adapters.virtual_bench import find_scenario
from service.cli.signals import stop_on_signals
from service.demo.configuration import write_configuration
from service.demo.processes import DemoError, running
from service.demo.story import Story
from service.security.keys import create_key
from service.settings import load_settings
from service.store import Store

SCENARIO = "demo"


def demo(
    rate: Annotated[
        float, typer.Option(help="Process seconds per wall second.", min=1, max=1000)
    ] = 120.0,
    port: Annotated[
        int, typer.Option(help="Port of the page; 0 takes a free one.", min=0, max=65535)
    ] = 8080,
    headless: Annotated[
        bool, typer.Option("--headless", help="Exit when the story is over.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
    duration_s: Annotated[
        float | None, typer.Option(help="Stop after so many wall seconds.", min=1)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the virtual bench.")] = 0,
) -> None:
    """Watch the twin do its job: a virtual bench, real Modbus and CAN, the whole service.

    A staircase of speeds and a light extra load stage (low risk), re-identification by itself,
    then high speed and heavy load, each forecast before it begins.
    """
    console = Console(stderr=as_json, highlight=False)
    try:
        document = asyncio.run(_demo(rate, port, headless, duration_s, seed, console))
    except DemoError as error:
        sys.stderr.write(f"bearing-twin: {error}\n")
        raise typer.Exit(1) from error
    if as_json:
        typer.echo(json.dumps(document))


async def _demo(
    rate: float,
    port: int,
    headless: bool,
    duration_s: float | None,
    seed: int,
    console: Console,
) -> dict[str, Any]:
    deadline = time.monotonic() + duration_s if duration_s is not None else None
    stop = stop_on_signals()
    began = time.monotonic()

    def tell(line: str) -> None:
        minutes, seconds = divmod(int(time.monotonic() - began), 60)
        console.print(f"[dim]{minutes:02d}:{seconds:02d}[/dim]  {line}", soft_wrap=True)

    with tempfile.TemporaryDirectory(prefix="bearing-twin-demo-") as name:
        folder = Path(name)
        await _prepare(folder, tell)
        bench_arguments = (
            "virtual-bench", "--scenario", SCENARIO, "--rate", f"{rate:g}", "--seed", str(seed),
            "--modbus-port", "0", "--can-port", "0", "--truth", str(folder / "truth.csv"),
            "--wait-for-start", "--json",
        )  # fmt: skip
        async with running("virtual bench", bench_arguments, folder / "bench.log") as (_, line):
            bench = json.loads(line)
            configuration = write_configuration(folder, bench, rate, port)
            settings = load_settings(configuration)
            with Store.open(settings.service.database_url, settings.data_dir) as store:
                key = create_key(store, "admin").text
            serve = ("serve", "-c", str(configuration))
            async with running("service", serve, folder / "service.log") as (service, address):
                tell(f"Open [bold]{address}#key={key}[/bold]")
                async with httpx2.AsyncClient(
                    base_url=address, headers={"X-API-Key": key}, timeout=30
                ) as client:
                    document = await _follow(client, bench, stop, deadline, tell)
                    _print_table(document, console)
                    if not headless and sys.stdin.isatty() and document["complete"]:
                        tell("The page stays up; Ctrl-C ends the demo.")
                        await _first_of(stop.wait(), service.wait())
                return document


async def _prepare(folder: Path, tell: Callable[[str], None]) -> None:
    """Compile the kernels once, before process time starts to run fast."""
    tell("Preparing: the numerical kernels are compiled on the first run (about a minute).")
    async with running("preparation", ("warm-up",), folder / "warm-up.log"):
        pass


async def _follow(
    client: httpx2.AsyncClient,
    bench: dict[str, Any],
    stop: asyncio.Event,
    deadline: float | None,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    story = Story(client, find_scenario(SCENARIO), tell)
    await story.ready()
    tell("The twin follows the standing machine; the bench starts its profile.")
    await press_start(bench)
    await _first_of(story.follow(deadline), stop.wait())
    return await story.account()


async def press_start(bench: dict[str, Any]) -> None:
    """Press the start button of the bench controller: a coil, as a SCADA system would."""
    from pymodbus.client import AsyncModbusTcpClient

    async with AsyncModbusTcpClient(
        bench["modbus"]["host"], port=bench["modbus"]["port"], timeout=3
    ) as modbus:
        answer = await modbus.write_coil(0, True, device_id=2)
        if answer.isError():
            raise DemoError(f"the bench did not take the start command: {answer}")


async def _first_of(*waits: Any) -> None:
    """Wait for the first to end; the others are cancelled, an error of the first is raised."""
    tasks = [asyncio.ensure_future(wait) for wait in waits]
    done, rest = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in rest:
        task.cancel()
    await asyncio.gather(*rest, return_exceptions=True)
    for task in done:
        task.result()


def _print_table(document: dict[str, Any], console: Console) -> None:
    table = Table(title="Forecast before each high-risk stage and what was measured at its end, °C")
    for heading in ("stage", "ring", "forecast (95 % band)", "measured", "error", "in band"):
        table.add_column(heading, justify="left" if heading in ("stage", "ring") else "right")
    for stage in document["stages"]:
        for sensor, row in stage["sensors"].items():
            if row["forecast_c"] is None:
                cells = ["no forecast", _figure(row["measured_c"]), "", ""]
            else:
                cells = [
                    f"{row['forecast_c']:.1f} ({row['q025']:.1f} … {row['q975']:.1f})",
                    _figure(row["measured_c"]),
                    f"{row['error_c']:+.1f}",
                    f"{row['coverage_95']:.0%} of the time",
                ]
            table.add_row(stage["name"], sensor.split("_")[1], *cells)
    console.print(table)
    for stage in document["stages"]:
        if stage["forecast_made_at"]:
            console.print(
                f"{stage['name']}: began at {stage['start'][11:19]}, forecast made at "
                f"{stage['forecast_made_at'][11:19]} by model {stage['forecast_model_version']}."
            )
    for stage in document["stages"]:
        warning = stage["warning"]
        if warning["forecast_limit_at"]:
            reached = warning["measured_limit_at"]
            console.print(
                f"{stage['name']}: limit announced at {warning['forecast_limit_at'][11:19]}, "
                + (f"reached at {reached[11:19]}" if reached else "not reached")
            )
    samples = document["samples"]
    console.print(f"Good samples stored: {samples['modbus']} by Modbus, {samples['can']} by CAN.")


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
