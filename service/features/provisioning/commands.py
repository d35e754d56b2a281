"""``bearing-twin assets``: assets that are not in the configuration file, as lists."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.file_names import is_csv
from service.cli.keys import command_line_actor
from service.cli.serve import ConfigFile
from service.clock import rfc3339, wall_us
from service.site.configuration import SettingsError
from service.site.settings import Settings, load_settings

# What only some commands need is imported where it is needed: the help must not wait for it.
if TYPE_CHECKING:
    from service.features.provisioning.lists import AssetRows, WrongRow
    from service.store import AuditEntry, Store

assets = typer.Typer(help="Assets that are not in the configuration file.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add ``assets``."""
    app.add_typer(assets, name="assets")


AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@contextmanager
def _store(settings: Settings) -> Iterator["Store"]:
    from service.store import Store

    with Store.open(settings.service.database_url, settings.data_dir) as store:
        yield store


@assets.command("list")
def list_(config: ConfigFile = None, as_json: AsJson = False) -> None:
    """List all assets, those of the configuration file too."""
    from rich.table import Table

    from service.cli.consoles import make_console

    settings = load_settings(config)
    with _store(settings) as store:
        present = store.assets.present()
    found = [
        {
            "id": one.id,
            "origin": "file",
            "template": one.template or None,
            "name": one.name or None,
            "group": one.group or None,
            "family": one.family or None,
            "changed_at": None,
        }
        for one in settings.assets
    ]
    for one in present:
        table = one.table or {}
        found.append(
            {
                "id": one.id,
                "origin": "provisioned",
                "template": table.get("template") or None,
                "name": table.get("name") or None,
                "group": table.get("group") or None,
                "family": table.get("family") or None,
                "changed_at": rfc3339(one.changed_us),
            }
        )
    if as_json:
        typer.echo(json.dumps({"assets": found}))
        return
    columns = ("id", "origin", "template", "name", "group", "family", "changed_at")
    shown = Table(box=None, pad_edge=False)
    for name in columns:
        shown.add_column(name.replace("_", " "), overflow="fold")
    for facts in found:
        shown.add_row(*(facts[name] or "" for name in columns))
    make_console().print(shown)


@assets.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Ends in .csv or .json.")],
    partial: Annotated[
        bool, typer.Option("--partial", help="Take the good rows where others are wrong.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the list, write nothing.")] = (
        False
    ),
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Create and update assets from a list, whether the service runs or not.

    Columns of CSV: id, template, name, group, family, bearing, model, network; every other
    column is a value for the holes of the template. A running service follows the assets within
    about two seconds. One wrong row refuses the whole list, without --partial; the status is 2
    then.
    """
    from service.features.provisioning.lists import judge_list

    settings = load_settings(config)
    rows = _read(file)
    with _store(settings) as store:
        judged = judge_list(settings, rows, {one.id: one.table for one in store.assets.present()})
        if judged.wrong and not partial:
            _report(file, judged.wrong)
            sys.stderr.write(f"bearing-twin: {file.name}: nothing is changed\n")
            sys.exit(2)
        if judged.changes and not dry_run:
            line = _line("assets.import", "", judged.summary)
            store.assets.change(judged.changes, line.time_us, line)
    if as_json:
        document = {
            "created": len(judged.created),
            "changed": len(judged.changed),
            "unchanged": judged.unchanged,
            "rejected": [
                {"row": row.row, "id": row.id, "detail": "; ".join(row.lines)}
                for row in judged.wrong
            ],
            "dry_run": dry_run,
        }
        typer.echo(json.dumps(document))
    else:
        would = "would be " if dry_run else ""
        typer.echo(
            f"{file.name}: {len(judged.created)} {would}created, {len(judged.changed)} {would}"
            f"changed, {judged.unchanged} unchanged."
        )
    if judged.wrong:
        _report(file, judged.wrong)
        sys.exit(2)


@assets.command()
def export(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]", help="Ends in .csv or .json; absent: JSON on standard output."
        ),
    ] = None,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Write the provisioned assets as "assets import" reads them."""
    from service.features.provisioning.lists import as_csv
    from service.features.provisioning.lists import as_json as as_json_text
    from service.files import replacing

    with _store(load_settings(config)) as store:
        tables = {one.id: one.table or {} for one in store.assets.present()}
    if file is None:
        typer.echo(as_json_text(tables), nl=False)
        return
    text = as_csv(tables) if is_csv(file) else as_json_text(tables)
    try:
        with replacing(file) as out:
            out.write(text)
    except OSError as error:
        raise SettingsError(f"{file}: cannot be written ({error.strerror})") from error
    if as_json:
        typer.echo(json.dumps({"out": str(file), "assets": len(tables)}))
    else:
        typer.echo(f"{file}: {len(tables)} assets.")


@assets.command()
def remove(
    ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Ids of the assets.")],
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Remove assets; their history stays."""
    from service.features.provisioning.lists import judge_removal

    settings = load_settings(config)
    with _store(settings) as store:
        wrong = judge_removal(settings, ids, {one.id for one in store.assets.present()})
        if wrong:
            hint = "'bearing-twin assets list' shows them"
            raise SettingsError(*(f"{row.id}: {row.lines[0]}; {hint}" for row in wrong))
        names = list(dict.fromkeys(ids))
        line = _line("assets.remove", ", ".join(f"asset {name}" for name in names), "")
        store.assets.change(dict.fromkeys(names), line.time_us, line)
    typer.echo(
        json.dumps({"removed": names})
        if as_json
        else f"{', '.join(names)}: removed; the history stays"
    )


def _read(file: Path) -> "AssetRows":
    from service.features.provisioning.lists import AssetListError, read_csv, read_json

    read = read_csv if is_csv(file) else read_json
    try:
        return read(file.read_bytes())
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
    except AssetListError as error:
        raise SettingsError(f"{file.name}: {error}") from error


def _report(file: Path, wrong: "list[WrongRow]") -> None:
    for row in wrong:
        named = "" if row.id is None else f" ({row.id})"
        lines = " ".join("; ".join(row.lines).split())
        sys.stderr.write(f"bearing-twin: {file.name}: row {row.row}{named}: {lines}\n")


def _line(action: str, target: str, detail: str) -> "AuditEntry":
    from service.store import AuditEntry

    actor = command_line_actor()
    return AuditEntry(wall_us(), actor.who, actor.address, action, target, detail)
