"""``bearing-twin identify``: parameters with intervals from a file of recorded data."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, get_args

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.cli.known_assets import asset_names, find_asset
from service.offline.interruption import exit_on_signals
from service.site.asset_section import ModelName
from service.site.machines.bearings import BearingSection, named_bearing
from service.site.machines.networks import NetworkSection
from service.site.settings import load_settings
from twin_core.bearings import UnknownBearingError

if TYPE_CHECKING:
    from service.offline.identification import Identified
    from twin_core.identification import IdentificationProgress

MODELS: tuple[str, ...] = get_args(ModelName)


def identify(
    data: Annotated[
        Path, typer.Argument(metavar="DATA.csv", help="Recorded low-risk data; all rows are used.")
    ],
    out: Annotated[Path, typer.Option(metavar="MODEL.json", help="File to write the model to.")],
    bearing: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help="Designation such as 6311, a bearing of --config, or a file with dimensions; or "
            "by --asset.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Take bearing, network and model from this file."),
    ] = None,
    asset: Annotated[str | None, typer.Option(help="Asset of the configuration.")] = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"{', '.join(MODELS)} of a bearing; by default the asset's, or {MODELS[0]}.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="METHOD",
            help="noa+refine, noa or refine. For comparison another search in NOA's place: de, "
            "trf, and with the extra bench pso or cma-es, alone or followed by +refine.",
        ),
    ] = "noa+refine",
    budget: Annotated[
        int | None,
        typer.Option(
            help="Evaluations that the search may take: 1000, or 20000 where no refinement follows."
        ),
    ] = None,
    loss: Annotated[
        str,
        typer.Option(
            metavar="LOSS",
            help="What a reading's error costs: linear, its square; or less than that far out, so "
            "that outliers do not bend the fit: soft_l1, huber or cauchy.",
        ),
    ] = "linear",
    seed: Annotated[int, typer.Option(help="Same seed, same result.")] = 0,
    at_rest: Annotated[
        bool,
        typer.Option(
            "--at-rest",
            help="The machine stood at ambient temperature at the first row; "
            "otherwise the initial state is estimated.",
        ),
    ] = False,
    sisters: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="MODEL.json …",
            help="Models of machines of the same type, at least two: what they know is the prior, "
            "where the data speak for it.",
        ),
    ] = None,
    population: Annotated[
        Path | None,
        typer.Option(
            metavar="FAMILY.json", help="The same from what 'bearing-twin population' wrote."
        ),
    ] = None,
    skip_strangers: Annotated[
        bool,
        typer.Option(
            "--skip-strangers",
            help="Leave out sisters of another bearing, network, model or family, instead of "
            "refusing them.",
        ),
    ] = False,
    without_data: Annotated[
        bool,
        typer.Option(
            "--without-data",
            help="Leave the minute rows out of the model file; with them it can calibrate the "
            "bands of its sisters.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Identify the thermal model from a CSV file.

    Columns: time (RFC 3339) or time_s, speed_rpm, load_n, ambient_c, t_inner_ring_c,
    t_outer_ring_c and any t_node_N_c; an empty cell is a missing value. A row's operating point
    holds until the next row. For an asset with a network of its own the temperatures are those of
    its sensors and nodes.
    """
    chosen = _with_model(model, _machine(bearing, config, asset))
    if sisters and population is not None:
        raise BadInputError("--sisters with --population: expected one of them")
    if skip_strangers and not sisters and population is None:
        raise BadInputError("--skip-strangers without --sisters or --population")
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.identification import (
            FailedFitError,
            check_options,
            identify_recording,
        )
        from service.offline.population_file import Population
        from service.offline.tables import check_writable, read_recording
        from service.offline.unit_doubts import doubts_of_recording
        from service.site.machines.machine import Machine

        procedure = check_options(method, budget, seed, loss)
        check_writable(out)
        machine = Machine(*chosen[:3])
        family: Population | None = None
        if sisters:
            family = Population.of_files(
                sisters, machine=machine, family=chosen.family, skip_strangers=skip_strangers
            )
        elif population is not None:
            family = Population.load(population)
        recording = read_recording(data, machine.network)
        for line in doubts_of_recording(recording, machine):
            sys.stderr.write(f"bearing-twin: warning: {line}\n")
        began = time.monotonic()
        try:
            with _progress_bar() as report:
                found = identify_recording(
                    recording,
                    machine=machine,
                    procedure=procedure,
                    seed=seed,
                    at_rest=at_rest,
                    family=chosen.family,
                    sisters_of=None
                    if family is None
                    else partial(
                        family.for_machine, machine, chosen.family, skip_strangers=skip_strangers
                    ),
                    progress=report,
                )
        except FailedFitError as error:
            sys.stderr.write(f"bearing-twin: {error}; {out} is not written\n")
            raise typer.Exit(1) from error
        seconds = time.monotonic() - began
        found.model.save(out, with_data=not without_data)
    skipped = {} if family is None else family.skipped
    if as_json:
        document = found.to_dict() | {"seconds": seconds, "out": str(out), "skipped": skipped}
        typer.echo(json.dumps(document, allow_nan=False))
    else:
        for path, why in skipped.items():
            make_console().print(f"Skipped: {path}: {why}", soft_wrap=True)
        _print(found, seconds, out)


class _Chosen(NamedTuple):
    """The parts of a machine as of `Machine`, and its family, empty where it is not known."""

    model: str
    bearing: BearingSection | None
    network: NetworkSection | None
    family: str = ""


def _machine(bearing: str | None, config: Path | None, asset: str | None) -> _Chosen:
    """Model, bearing, network and family, from the option or from a configuration's asset."""
    if config is None:
        if asset is not None:
            raise BadInputError(f"--asset {asset!r} without --config: expected both or none")
        if bearing is None:
            raise BadInputError("--bearing is missing; expected it, or --config and --asset")
        return _Chosen("default", _named(bearing, {}), None)
    settings = load_settings(config)
    if asset is None:
        if bearing is None:
            raise BadInputError(
                f"--config without --asset: expected one of its assets ({asset_names(settings)}), "
                "or --bearing"
            )
        return _Chosen("default", _named(bearing, settings.bearings), None)
    section = find_asset(settings, asset)
    if section is None:
        raise BadInputError(
            f"--asset {asset!r}: expected one of the assets of {config} ({asset_names(settings)})"
        )
    known = section.bearing and section.bearing.name
    if known is None and bearing is not None:
        raise BadInputError(
            f"--bearing {bearing!r}: expected none, asset {asset!r} in {config} has a "
            "network of its own"
        )
    if bearing not in (None, known):
        raise BadInputError(
            f"--bearing {bearing!r}: expected {known!r}, the bearing of asset {asset!r} in "
            f"{config}, or no --bearing"
        )
    return _Chosen(section.model, section.bearing, section.network, section.family)


def _with_model(model: str | None, chosen: _Chosen) -> _Chosen:
    """The machine with the model that the option names."""
    if model is None:
        return chosen
    if model not in MODELS:
        raise BadInputError(f"--model {model!r}: expected one of {', '.join(MODELS)}")
    if chosen.network is not None:
        raise BadInputError(
            f"--model {model!r}: expected none, network {chosen.network.name!r} is the model itself"
        )
    return chosen._replace(model=model)


def _named(bearing: str, known: Mapping[str, BearingSection]) -> BearingSection:
    try:
        return named_bearing(bearing, known)
    except UnknownBearingError as error:
        raise BadInputError(f"--bearing: {error}") from error


@contextmanager
def _progress_bar() -> Iterator["Callable[[IdentificationProgress], None] | None"]:
    """Yield what to call with the progress; nothing is shown where no one watches."""
    console = make_console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %  {task.fields[evaluations]} simulations"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("preparing", total=1.0, evaluations=0)

        def report(progress: "IdentificationProgress") -> None:
            bar.update(
                task,
                completed=progress.fraction,
                description=progress.phase,
                evaluations=progress.evaluations,
            )

        yield report


def _print(found: "Identified", seconds: float, out: Path) -> None:
    console = make_console()
    table = Table("parameter", "value", "95 % interval", "unit", "informed", "verdict", "meaning")
    for name, row in found.parameters.items():
        table.add_row(
            name,
            f"{row.value:.4g}",
            f"{row.low:.4g} … {row.high:.4g}",
            row.unit,
            f"{row.informed_share:.0%}",
            row.verdict + (f", at its {row.at_bound} bound" if row.at_bound else ""),
            row.description,
        )
    console.print(table)
    _print_combinations(console, found)
    if found.paper_view:
        view = Table("the paper's number", "value", "95 % interval")
        for name, number in found.paper_view.items():
            view.add_row(name, f"{number.value:.4g}", f"{number.low:.4g} … {number.high:.4g}")
        console.print(view)
    console.print(
        f"{found.rows} rows in {found.windows} windows, {found.method}: "
        f"{found.evaluations} simulations, {seconds:.1f} s"
    )
    errors = Table("rms error in the data, K", *found.rms_by_sensor_k)
    errors.add_row("twin", *(f"{value:.2f}" for value in found.rms_by_sensor_k.values()))
    for kind, by_sensor in found.naive_k.items():
        cells = (by_sensor[name] for name in found.rms_by_sensor_k)
        errors.add_row(
            kind.replace("_", " "), *("–" if cell is None else f"{cell:.2f}" for cell in cells)
        )
    console.print(errors)
    if found.sisters is not None and found.sisters.accepted:
        said = found.sisters
        console.print(
            f"Sisters: {said.reason}. Up to {said.load_n_max:.0f} N and {said.speed_rpm_max:.0f} "
            f"rpm; bands calibrated on {said.calibrated_runs} runs of theirs",
            soft_wrap=True,
        )
    for check in found.gates.checks:
        if check.passed:
            console.print(f"Passed: {check.detail}", soft_wrap=True)
    for warning in found.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, markup=False)
    console.print(f"Model: {out}", soft_wrap=True)


def _print_combinations(console: Console, found: "Identified") -> None:
    """What the data determine, as combinations of parameters in units of their priors' spreads."""
    informed = found.identifiability
    table = Table("identifiability", "std over prior's", "verdict")
    combinations = informed.combinations or []
    for one in combinations:
        if one.verdict != "prior only":
            table.add_row(one.combination, f"{one.std_over_prior:.2f}", one.verdict)
    console.print(table)
    console.print(
        f"Of {len(combinations)} combinations {informed.informed} are informed, "
        f"{informed.weak} weakly, {informed.prior_only} rest on the prior alone; rank "
        f"{informed.rank}, condition {informed.condition:.1e}"
    )
