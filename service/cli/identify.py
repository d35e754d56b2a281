"""``bearing-twin identify``: parameters with intervals from a file of recorded data."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.cli.errors import BadInputError
from service.offline.interruption import exit_on_signals
from service.settings import load_settings

if TYPE_CHECKING:
    from service.offline.identification import Identified
    from twin_core.identification import Progress as FitProgress


def identify(
    data: Annotated[
        Path, typer.Argument(metavar="DATA.csv", help="Recorded low-risk data; all rows are used.")
    ],
    out: Annotated[Path, typer.Option(metavar="MODEL.json", help="Where the model goes.")],
    bearing: Annotated[
        str | None, typer.Option(help="Designation, such as 6311; or by --config and --asset.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Take bearing and model from this file.")
    ] = None,
    asset: Annotated[str | None, typer.Option(help="Asset of the configuration.")] = None,
    method: Annotated[str, typer.Option(help="noa+refine, noa or refine.")] = "noa+refine",
    budget: Annotated[
        int | None, typer.Option(help="Simulations that the global search may take.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same result.")] = 0,
    at_rest: Annotated[
        bool,
        typer.Option(
            "--at-rest",
            help="The machine stood at ambient temperature at the first row; "
            "otherwise the initial state is estimated.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Identify the thermal model from a CSV file.

    Columns: time (RFC 3339) or time_s, speed_rpm, load_n, ambient_c, t_inner_ring_c,
    t_outer_ring_c and any t_node_N_c; an empty cell is a missing value. A row's operating point
    holds until the next row.
    """
    designation, model_name = _machine(bearing, config, asset)
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.identification import (
            FailedFitError,
            check_options,
            identify_recording,
        )
        from service.offline.tables import check_writable, read_recording

        chosen, evaluations = check_options(method, budget, seed)
        check_writable(out)
        recording = read_recording(data)
        began = time.monotonic()
        try:
            with _progress_bar() as tell:
                found = identify_recording(
                    recording,
                    designation=designation,
                    model_name=model_name,
                    method=chosen,
                    budget=evaluations,
                    seed=seed,
                    at_rest=at_rest,
                    progress=tell,
                )
        except FailedFitError as error:
            sys.stderr.write(f"bearing-twin: {error}; {out} is not written\n")
            raise typer.Exit(1) from error
        seconds = time.monotonic() - began
        found.model.save(out)
    if as_json:
        document = found.to_dict() | {"seconds": seconds, "out": str(out)}
        typer.echo(json.dumps(document, allow_nan=False))
    else:
        _print(found, seconds, out)


def _machine(bearing: str | None, config: Path | None, asset: str | None) -> tuple[str, str]:
    """Bearing and model, from the option or from a configuration's asset."""
    if config is None:
        if asset is not None:
            raise BadInputError(f"--asset {asset!r} without --config: expected both or none")
        if bearing is None:
            raise BadInputError("--bearing is missing; expected it, or --config and --asset")
        return bearing, "default"
    known = load_settings(config).assets
    ids = ", ".join(section.id for section in known) or "none in this file"
    if asset is None:
        raise BadInputError(f"--config without --asset: expected one of its assets ({ids})")
    for section in known:
        if section.id == asset:
            if bearing not in (None, section.bearing):
                raise BadInputError(
                    f"--bearing {bearing!r}: expected {section.bearing!r}, the bearing of asset "
                    f"{asset!r} in {config}, or no --bearing"
                )
            return section.bearing, section.model
    raise BadInputError(f"--asset {asset!r}: expected one of the assets of {config} ({ids})")


@contextmanager
def _progress_bar() -> Iterator["Callable[[FitProgress], None] | None"]:
    """Yield what to call with the progress; nothing is shown where nobody watches."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %  {task.fields[evaluations]} simulations"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("preparing", total=1.0, evaluations=0)

        def tell(progress: "FitProgress") -> None:
            bar.update(
                task,
                completed=progress.fraction,
                description=progress.phase,
                evaluations=progress.evaluations,
            )

        yield tell


def _print(found: "Identified", seconds: float, out: Path) -> None:
    console = Console(highlight=False)
    table = Table("parameter", "value", "95 % interval", "unit", "verdict", "meaning")
    for name, row in found.parameters.items():
        table.add_row(
            name,
            f"{row['value']:.4g}",
            f"{row['low']:.4g} … {row['high']:.4g}",
            row["unit"],
            row["verdict"],
            row["description"],
        )
    console.print(table)
    posterior = found.model.posterior
    console.print(
        f"{found.rows} rows in {found.windows} windows, {found.evaluations} simulations, "
        f"{seconds:.1f} s; rank {posterior.rank}, condition {posterior.condition:.1e}, "
        f"{posterior.informed_combinations} combinations informed"
    )
    errors = Table("rms error in the data, K", *found.rms_by_sensor_k)
    errors.add_row("twin", *(f"{value:.2f}" for value in found.rms_by_sensor_k.values()))
    for kind, by_sensor in found.naive_k.items():
        cells = (by_sensor[name] for name in found.rms_by_sensor_k)
        errors.add_row(
            kind.replace("_", " "), *("–" if cell is None else f"{cell:.2f}" for cell in cells)
        )
    console.print(errors)
    console.print(f"Model: {out}", soft_wrap=True)
