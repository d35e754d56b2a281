"""``bearing-twin fleet``: what is done with many machines at once."""

import asyncio
import sys
from contextlib import AsyncExitStack
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.cli.keys import command_line_actor
from service.cli.progress import progress_bar
from service.cli.serve import ConfigFile
from service.clock import ProcessClock, wall_us
from service.domain.errors import ServiceError
from service.features.nights.account import ExecutorName, nothing_done, summary
from service.site.settings import Settings, load_settings

# The compiled twin takes a second to load, which --help should not pay.
if TYPE_CHECKING:
    from collections.abc import Callable

    from service.features.nights.account import FleetIdentification
    from service.features.nights.batch_executors import BatchExecutor
    from service.site.asset_section import AssetSection
    from service.site.configuration import TomlTable
    from service.store import Store

fleet = typer.Typer(help="Many machines at once.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.add_typer(fleet, name="fleet")


#: Without a terminal: wall seconds between lines on standard error.
_LINE_EVERY_S = 60.0


@fleet.callback()
def _fleet() -> None: ...


@fleet.command()
def identify(
    all_assets: Annotated[bool, typer.Option("--all", help="All assets.")] = False,
    family: Annotated[
        str | None, typer.Option(metavar="FAMILY", help="The assets of this family.")
    ] = None,
    executor: Annotated[
        ExecutorName | None,
        typer.Option(
            help="Executor: processes of this machine, as many as jobs.workers, or the "
            "workers of a Dask scheduler (extra fleet). By default Dask where a scheduler is "
            "given or configured."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Of the Dask scheduler, such as tls://HOST:8786; instead of fleet.scheduler.",
        ),
    ] = None,
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Identify many machines again from what the store holds, each once a night.

    Each result is stored at once as a version of the asset's model: what passes the gates becomes
    active where the asset's ladder is apply. The search begins at the active version. A run that
    was stopped goes on with the next call; a night ends at noon, and a second run of the same
    night changes nothing. Services may run meanwhile: they take up the new versions.

    The status is 1 if a machine failed, 75 if store or scheduler are offline, and 0 after a signal,
    which leaves the rest to the next call. The JSON document is printed in each case; what ended
    the run too early stands in its ended_by.
    """
    if all_assets == (family is not None):
        raise BadInputError("expected either --all or --family FAMILY")
    from service.logs import configure_logging

    configure_logging("warning")
    settings = load_settings(config)
    if executor == "process" and scheduler is not None:
        raise BadInputError(f"--scheduler {scheduler!r}: expected none with --executor process")
    if executor is None:
        executor = "dask" if scheduler or settings.fleet.scheduler else "process"
    from service.features.nights.identification import night_of

    done = nothing_done(night_of(datetime.now()), executor)

    def keep(found: "FleetIdentification") -> None:
        nonlocal done
        done = found

    def print_cut_short(why: str) -> None:
        # A line for each night, also for one that failed.
        if as_json:
            typer.echo(done.model_copy(update={"ended_by": why}).model_dump_json())

    try:
        found = asyncio.run(_identify(settings, family, executor, scheduler, keep))
    except ServiceError as error:
        print_cut_short(" ".join(str(error).split()))
        raise
    if found is None:
        print_cut_short("stopped by a signal")
        sys.stderr.write(
            "bearing-twin: stopped; what was identified is stored, call again for the rest\n"
        )
        raise typer.Exit(0)
    if as_json:
        typer.echo(found.model_dump_json())
    else:
        _print(found)
    if found.failed:
        raise typer.Exit(1)


async def _identify(
    settings: Settings,
    family: str | None,
    executor: ExecutorName,
    scheduler: str | None,
    so_far: "Callable[[FleetIdentification], None]",
) -> "FleetIdentification | None":
    """Identify until the end, or until a signal: None."""
    from service.features.nights.identification import identify_fleet, night_of
    from service.features.nights.night import Night
    from service.signals import stop_on_signals
    from service.store import AuditEntry, Store

    actor = command_line_actor()

    def audit(action: str, target: str, detail: str = "") -> AuditEntry:
        return AuditEntry(wall_us(), actor.who, actor.address, action, target, detail)

    stop = stop_on_signals()
    async with AsyncExitStack() as stack:
        store = stack.enter_context(Store.open(settings.service.database_url, settings.data_dir))
        assets, wrong = _chosen(settings, store, family)
        clock = ProcessClock.resume(settings.clock.rate, settings.data_dir)
        chosen = "all assets" if family is None else f"family {family}"
        night = Night(night_of(datetime.now()), store, clock, actor.who, audit, chosen)
        batches = await _executor(stack, settings, executor, scheduler)
        report = stack.enter_context(progress_bar(f"night {night.name}", _LINE_EVERY_S))
        work = asyncio.create_task(identify_fleet(night, assets, batches, report, wrong, so_far))
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({work, stopped}, return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        if not work.done():
            work.cancel()
            await asyncio.wait({work})
            return None
        return work.result()


def _chosen(
    settings: Settings, store: "Store", family: str | None
) -> "tuple[list[AssetSection], dict[str, str]]":
    """Give the assets of file and store, and what is wrong with those that are not to be used."""
    from service.site.asset_tables import check_assets

    tables = {one.id: one.table or {} for one in store.assets.present()}
    in_file = {one.id for one in settings.assets}
    right, wrong = check_assets(
        settings, {name: table for name, table in tables.items() if name not in in_file}
    )
    assets = [*settings.assets, *(one.section for one in right.values())]
    refused = {name: "; ".join(lines) for name, lines in wrong.items()}
    if family is None:
        return assets, refused
    chosen = [one for one in assets if one.family == family]
    if not chosen and not refused:
        families = sorted({one.family for one in assets} - {""})
        raise BadInputError(
            f"--family {family!r}: no asset has it; expected one of {', '.join(families) or 'none'}"
        )
    # What is wrong with a table may hide its family: rather one too many is named.
    templates = {one.get("name"): one for one in settings.templates}

    def may_be_of_it(table: "TomlTable") -> bool:
        template = templates.get(table.get("template"), {})
        return bool(table.get("family", template.get("family", family)) == family)

    return chosen, {name: why for name, why in refused.items() if may_be_of_it(tables[name])}


async def _executor(
    stack: AsyncExitStack, settings: Settings, name: ExecutorName, scheduler: str | None
) -> "BatchExecutor":
    if name == "process":
        from service.features.nights.batch_executors import ProcessBatches

        processes = ProcessBatches(settings.jobs.workers)
        stack.callback(processes.end)
        return processes
    from service.site.fleet_section import checked_scheduler

    address = checked_scheduler(settings.fleet, settings.base_dir, scheduler)
    try:
        from service.features.nights.dask_executor import dask_batches
    except ModuleNotFoundError as error:
        raise BadInputError(
            f"--executor dask: {error.name} is not installed: pip install 'bearing-twin[fleet]'"
        ) from error
    return await stack.enter_async_context(dask_batches(address))


def _print(found: "FleetIdentification") -> None:
    console = make_console()
    table = Table("asset", "what came of it", "version", "active", "s", "reason")
    for one in found.items:
        table.add_row(
            one.asset,
            one.status + (", warm start" if one.warm_start else ""),
            "" if one.model_version is None else str(one.model_version),
            "yes" if one.active else "",
            "" if one.seconds is None else f"{one.seconds:.2f}",
            one.reason if one.model_version is None else "",
        )
    console.print(table)
    console.print(summary(found), soft_wrap=True)
