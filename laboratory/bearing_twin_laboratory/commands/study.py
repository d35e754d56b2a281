"""``bearing-twin study``: the paper's studies, its figures next to ours."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from bearing_twin_laboratory.studies.registry import ALL, STUDIES, chosen
from bearing_twin_laboratory.studies.study import Options, Report, prepare
from service.cli.consoles import make_console
from service.cli.progress import progress_bar
from service.offline.interruption import exit_on_signals

# Columns of a table that no terminal limits.
_FILE_WIDTH = 140


def study(
    name: Annotated[str, typer.Argument(metavar="NAME", help=f"{', '.join(STUDIES)}, or all.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write figures, tables and plots into this folder."),
    ] = None,
    benches: Annotated[
        int | None,
        typer.Option(metavar="N", help="Random virtual benches; each study has its own default."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="S", help="Seed of the first bench, by default 200.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with recorded field data.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short cases; shows that all of it works.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Repeat the paper's studies and print its figures next to ours.

    With "all" the JSON document holds one document per study, by name.
    """
    options = Options(benches, seed, data, quick)
    studies = chosen(name, options)
    if out is not None:
        prepare(out)
    documents = {}
    with exit_on_signals():
        for title, one in studies.items():
            with progress_bar(title) as progress:
                report = one.run(progress, options)
            written = report.write(out) if out is not None else []
            documents[title] = report.document
            if not as_json:
                _print(report, written)
    if as_json:
        typer.echo(json.dumps(documents if name == ALL else documents[name]))


def _print(report: Report, written: list[Path]) -> None:
    console = make_console()
    if not console.is_terminal:
        console.width = max(console.width, _FILE_WIDTH)
    for table in report.tables:
        shown = Table(*table.columns, title=table.title)
        for row in table.rows:
            shown.add_row(*row)
        console.print(shown)
        for note in table.notes:
            console.print(note)
    for path in written:
        console.print(str(path), soft_wrap=True)
