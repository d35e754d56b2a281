"""``bearing-twin population``: what sisters know together, in one file."""

import json
from pathlib import Path
from typing import Annotated

import typer

from service.cli.consoles import make_console
from service.offline.interruption import exit_on_signals


def register(app: typer.Typer) -> None:
    """Add ``population``."""
    app.command()(population)


def population(
    models: Annotated[
        list[Path],
        typer.Argument(metavar="MODEL.json …", help="Models of machines of one type, at least 2."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FAMILY.json", help="File to write the population to.")
    ],
    skip_strangers: Annotated[
        bool,
        typer.Option(
            "--skip-strangers",
            help="Leave out models of another bearing, network, model or family than the first "
            "one, instead of refusing them.",
        ),
    ] = False,
    without_data: Annotated[
        bool,
        typer.Option(
            "--without-data",
            help="Leave the minute rows out; without them bands cannot be calibrated.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Put identified machines of one type together, for 'identify --population'.

    The file holds each machine's parameters with their uncertainty and, unless they are left out,
    the minute rows that these come from.
    """
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.population_file import Population
        from service.offline.tables import check_writable
        from twin_core.sisters import strangers

        check_writable(out)
        found = Population.of_files(models, skip_strangers=skip_strangers)
        strange = strangers(found.machine.build(), [member.sister for member in found.members])
        found.save(out, with_data=not without_data)
    trained = [member.posterior.trained for member in found.members]
    rows = 0 if without_data else sum(member.data is not None for member in found.members)
    document = {
        "out": str(out),
        "bearing": found.machine.name,
        "family": found.family or None,
        "sisters": len(found.members),
        "with_data": rows,
        "load_n_max": max(one.load_n_max for one in trained),
        "speed_rpm_max": max(one.speed_rpm_max for one in trained),
        "skipped": found.skipped,
        "strangers": strange,
    }
    if as_json:
        typer.echo(json.dumps(document, allow_nan=False))
        return
    console = make_console()
    for path, why in found.skipped.items():
        console.print(f"Skipped: {path}: {why}", soft_wrap=True)
    for name, why in strange.items():
        console.print(f"Warning: {name} will not be used as a sister: {why}", soft_wrap=True)
    console.print(
        f"{document['sisters']} sisters, {rows} of them with minute rows; up to "
        f"{document['load_n_max']:.0f} N and {document['speed_rpm_max']:.0f} rpm",
        soft_wrap=True,
    )
    console.print(f"Population: {out}", soft_wrap=True)
