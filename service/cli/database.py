"""``bearing-twin db``: the store's schema, and from when on it keeps raw samples."""

import json
from pathlib import Path
from typing import Annotated

import typer

from adapters.times import POSSIBLE
from service.cli.serve import ConfigFile
from service.clock import ProcessClock, from_rfc3339, rfc3339
from service.site.configuration import SettingsError
from service.site.settings import load_settings

db = typer.Typer(help="The store: schema, retention, refused changes.", no_args_is_help=True)


@db.callback()
def _group() -> None: ...


@db.command()
def upgrade(config: ConfigFile = None) -> None:
    """Bring the store up to the schema of this version."""
    from service.store import Store

    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir, migrate=True):
        typer.echo("The store is up to date.")


@db.command()
def confirm(config: ConfigFile = None) -> None:
    """Confirm a store that was replaced or is an older copy, so that the service writes to it.

    A cell that finds that its store was replaced, restored from a backup or lacks what it
    confirmed (a failover to a standby that lagged) keeps samples on its disk until this command.
    What the store lacks is not in its history; what waits on the disks of the cells is stored.
    """
    from service.cli.keys import command_line_actor
    from service.clock import wall_us
    from service.store import AuditEntry, Store

    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        who = command_line_actor().who
        store.identity.confirm(AuditEntry(wall_us(), who, "", "store.confirm", "store"))
    typer.echo("The store is confirmed: what waits on the disks of the cells is stored in it.")


@db.command()
def horizon(
    lower: Annotated[
        str | None,
        typer.Option(metavar="RFC3339", help="Accept raw samples from this time on again."),
    ] = None,
    confirm_clock: Annotated[
        bool,
        typer.Option(
            "--confirm-clock", help="Confirm the clock: retention continues from its time."
        ),
    ] = False,
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Show the time before which raw samples have been removed, and lower it.

    Samples from before that time are not stored. When a clock that was wrong moved it too far,
    lower it. Samples that come for an hour whose averages are kept replace these averages.
    """
    from service.clock import wall_us
    from service.store import Store

    settings = load_settings(config)
    lower_us = None
    if lower is not None:
        try:
            lower_us = from_rfc3339(lower)
        except ValueError as error:
            raise SettingsError(f"--lower: {error}") from None
        if lower_us < 0:
            raise SettingsError(f"--lower {lower}: expected a time after 1970")
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        if lower_us is not None:
            store.rollups.lower_raw_horizon(lower_us)
        if confirm_clock:
            now_us = ProcessClock.resume(settings.clock.rate, settings.data_dir).now_us()
            store.rollups.confirm_clock(now_us, wall_us())
        kept_from_us = store.samples.raw_kept_from_us()
    shown = rfc3339(kept_from_us) if kept_from_us else None
    if as_json:
        typer.echo(json.dumps({"raw_kept_from": shown}))
    else:
        typer.echo(
            f"Raw samples are kept from {shown} on." if shown else "All raw samples are kept."
        )


@db.command()
def times(
    remove: Annotated[bool, typer.Option("--remove", help="Remove these samples.")] = False,
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """List the samples whose time no sample can have, and remove them.

    Earlier versions took any number in a file for a time. Such samples are from before 1990 or
    from after tomorrow, to four hours: no import, push or source brings them any more.
    """
    from service.cli.keys import command_line_actor
    from service.clock import wall_us
    from service.store import AuditEntry, Store

    def line(count: int) -> AuditEntry:
        who = command_line_actor().who
        detail = f"{count} samples of impossible times"
        return AuditEntry(wall_us(), who, "", "samples.remove", "store", detail)

    settings = load_settings(config)
    now_us = ProcessClock.of(settings.data_dir).now_us()
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        found = store.impossible_times.find(now_us)
        removed = store.impossible_times.remove(now_us, line) if remove else 0
    if as_json:
        items = [
            {"asset": one.asset, "channel": one.channel, "samples": one.samples}
            | {"first": rfc3339(one.first_us), "last": rfc3339(one.last_us)}
            for one in found
        ]
        typer.echo(json.dumps({"items": items, "removed": removed}))
        return
    for one in found:
        typer.echo(
            f"{one.asset}/{one.channel}: {one.samples} samples from {rfc3339(one.first_us)} to "
            f"{rfc3339(one.last_us)}"
        )
    if remove:
        typer.echo(f"{removed} samples removed.")
    elif not found:
        typer.echo(f"All samples are of {POSSIBLE}.")


@db.command()
def refused(
    repeat: Annotated[
        int | None,
        typer.Option(metavar="ID", help="Write the records of this change, and remove it."),
    ] = None,
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """List changes that the store did not take, and repeat one.

    Records are lines of journal and audit trail, and forecasts. A state of an alarm comes from
    the owner of the asset alone, and is not repeated.
    """
    from service.store import Store

    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        written = None if repeat is None else store.refused.repeat(repeat, "command line")
        changes = store.refused.list()
    if as_json:
        items = [
            {"id": one.id, "time": rfc3339(one.time_us), "sender": one.sender}
            | {"assets": one.assets, "summary": one.summary, "reason": one.reason}
            | {"document": one.document}
            for one in changes
        ]
        typer.echo(json.dumps({"repeated": written, "items": items}))
        return
    if written is not None:
        typer.echo(f"Change {repeat}: written, {written}.")
    for one in changes:
        assets = f" of {one.assets}" if one.assets else ""
        typer.echo(f"{one.id}  {rfc3339(one.time_us)}  {one.summary}{assets}: {one.reason}")
    if not changes:
        typer.echo("No change waits that the store did not take.")


@db.command()
def salvage(
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Put what can be read of a damaged SQLite store into a new file; the damaged one is kept.

    Stop the service first.
    """
    from service.store import StoreError, lock_data_directory, lock_database
    from service.store.identity import forget
    from service.store.opening import database_address
    from service.store.salvage import damage_of, salvage_store

    settings = load_settings(config)
    url = database_address(settings.service.database_url, settings.data_dir)
    if url.get_backend_name() != "sqlite":
        raise StoreError("db salvage: expected an SQLite store; a PostgreSQL server has amcheck")
    path = Path(url.database or "")
    with (
        lock_data_directory(settings.data_dir),
        lock_database(settings.service.database_url, settings.data_dir, lambda: None),
    ):
        problem = damage_of(path)
        done = None if problem is None else salvage_store(path, problem)
        if done is not None:
            forget(settings.data_dir)
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "problem": problem,
                    "kept_as": None if done is None else str(done.kept_as),
                    "rows": {} if done is None else done.rows,
                    "unnamed_channels": 0 if done is None else done.unnamed_channels,
                }
            )
        )
    elif done is None:
        typer.echo(f"{path} is whole: nothing to do.")
    else:
        typer.echo(f"{path}: {done.problem}.")
        typer.echo(f"The damaged file is kept as {done.kept_as}. The new one holds")
        for table, count in done.rows.items():
            typer.echo(f"  {count:>10} {table}")
        if done.unnamed_channels:
            typer.echo(
                f"{done.unnamed_channels} channels have lost their names: see asset 'salvaged'."
            )
