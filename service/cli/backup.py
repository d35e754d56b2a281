"""``bearing-twin backup`` and ``restore``: the whole store as one file."""

import json
from pathlib import Path
from typing import Annotated

import typer

from service.cli.serve import ConfigFile
from service.site.settings import load_settings

AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


def backup(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; a new name.")],
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Write a checked copy of the store, whether the service runs or not.

    An SQLite store becomes an SQLite file, a PostgreSQL database a dump (this needs pg_dump of
    the server's version). What waits in spool and outbox is not in it.
    """
    from service.store.backup import back_up
    from service.store.opening import database_address

    settings = load_settings(config)
    url = database_address(settings.service.database_url, settings.data_dir)
    rows = back_up(url, out)
    if as_json:
        typer.echo(json.dumps({"out": str(out), "bytes": out.stat().st_size, "rows": rows}))
    else:
        typer.echo(f"{out}: {out.stat().st_size} bytes, {_listed(rows)}; checked.")


def restore(
    file: Annotated[Path, typer.Argument(metavar="IN", help="From 'bearing-twin backup'.")],
    force: Annotated[
        bool, typer.Option("--force", help="Also when the store holds something.")
    ] = False,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Put a backup in the place of the store; the service must not run.

    What waits in the data directory of this configuration is stored in it at the next start; cells
    with another data directory store nothing until 'bearing-twin db confirm'.

    All browser sessions end. Keys that were revoked after the backup was made are valid again: run
    'bearing-twin keys revoke --all' unless you know that there are none.
    """
    from service.store import lock_data_directory, lock_database
    from service.store.backup import restore as restore_store
    from service.store.identity import forget
    from service.store.opening import database_address

    settings = load_settings(config)
    url = settings.service.database_url
    with (
        lock_data_directory(settings.data_dir),
        lock_database(url, settings.data_dir, lambda: None),
    ):
        rows = restore_store(database_address(url, settings.data_dir), file, force=force)
        forget(settings.data_dir)
    if as_json:
        typer.echo(json.dumps({"in": str(file), "rows": rows}))
    else:
        typer.echo(f"{file}: {_listed(rows)} restored and checked.")
        typer.echo(
            "Keys that were revoked after the backup are valid again; "
            "'bearing-twin keys revoke --all' revokes all keys."
        )


def _listed(rows: dict[str, int]) -> str:
    names = {
        "samples": "samples",
        "packed_hours": "packed hours of channels",
        "model_versions": "models",
        "api_keys": "keys",
    }
    return ", ".join(f"{rows.get(name, 0)} {label}" for name, label in names.items())
