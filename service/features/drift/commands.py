"""``bearing-twin drift``: has a machine changed between the data of several model files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.offline.interruption import exit_on_signals

if TYPE_CHECKING:
    from service.features.drift.documents import DriftOfFiles


def register(app: typer.Typer) -> None:
    """Add ``drift``."""
    app.command()(drift)


def drift(
    models: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL.json MODEL.json …",
            help="Model file from 'bearing-twin identify', of one machine and one network each.",
        ),
    ],
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Compare models of one machine from different spans of its data.

    Identify each span separately first. Models are taken in the order of their data's dates, or as
    given where there are none. Says whether the machine has changed, what moved and by how much;
    the exit status is 0 either way.
    """
    if len(models) < 2:
        raise BadInputError(f"MODEL.json: {len(models)} given, expected at least two")
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.features.drift.model_files import compare_models, load_models

        document = compare_models(load_models(models))
    if as_json:
        typer.echo(document.model_dump_json())
    else:
        _print(document)


def _print(found: "DriftOfFiles") -> None:
    console = make_console()
    for one in found.models:
        when = f" ({one.start} to {one.end})" if one.start else ""
        console.print(f"{one.file}{when}", soft_wrap=True, markup=False)
        against = f", compared with {one.against}" if one.against else ""
        console.print(f"  {one.text}{against}", soft_wrap=True, markup=False)
    table = Table("quantity", *(str(k + 1) for k in range(len(found.models))), "unit")
    described = {name: row for one in found.models for name, row in one.quantities.items()}
    for name, row in described.items():
        cells = [one.quantities.get(name) for one in found.models]
        table.add_row(
            row.text, *("–" if cell is None else f"{cell.value:.3g}" for cell in cells), row.unit
        )
    console.print(table)
    said = {True: "Changed", False: "Not changed", None: "Not compared"}[found.changed]
    console.print(f"{said}: {found.text}", soft_wrap=True, markup=False)
