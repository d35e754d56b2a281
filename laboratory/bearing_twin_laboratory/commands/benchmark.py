"""``bearing-twin benchmark``: how fast the product is on this machine."""

import json
from typing import Annotated

import typer
from rich.table import Table

from bearing_twin_laboratory.benchmarks.common import Measurement
from bearing_twin_laboratory.benchmarks.registry import BENCHMARKS, ON_REQUEST, chosen, run
from service.cli.consoles import make_console
from service.cli.progress import progress_bar
from service.offline.interruption import exit_on_signals


def benchmark(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]...",
            help=f"{', '.join(BENCHMARKS)}; by default all but {' and '.join(ON_REQUEST)}.",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Measure durations and rates, each with a reference measured next to it.

    Times are the shortest of many, in seconds; the ratio is the value over the reference.
    """
    results = {}
    with exit_on_signals():
        for name in chosen(names or []):
            with progress_bar(name) as progress:
                results[name] = run(name, progress)
    if as_json:
        typer.echo(json.dumps({name: result.to_dict() for name, result in results.items()}))
        return
    table = Table("benchmark", "value", "unit", "reference", "ratio", "beside")
    for name, result in results.items():
        table.add_row(
            name,
            f"{result.value:.4g}",
            result.unit,
            _text(result.reference),
            _text(result.ratio),
            result.compared_with,
        )
    console = make_console()
    console.print(table)
    for name, result in results.items():
        console.print(_details(name, result), soft_wrap=True)


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _details(name: str, result: Measurement) -> str:
    facts = ", ".join(
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in result.extra.items()
    )
    return f"{name}: {facts}" if facts else name
