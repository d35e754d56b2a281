"""``bearing-twin alarms``: alarm settings and the rationalisation sheet, as files."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.file_names import is_csv
from service.cli.keys import command_line_actor
from service.cli.serve import ConfigFile
from service.clock import wall_us
from service.domain.texts import EXPECTED, is_one_line
from service.features.alarm_settings.health import stored_assets
from service.site.configuration import SettingsError
from service.site.settings import load_settings

# What only some commands need is imported where it is needed: the help must not wait for it.
if TYPE_CHECKING:
    from service.features.alarm_settings.settings_changes import Mistake, WantedRow
    from service.store import AuditEntry

alarms = typer.Typer(
    help="Alarm settings: the rationalisation sheet, out and in.", no_args_is_help=True
)


def register(app: typer.Typer) -> None:
    """Add ``alarms``."""
    app.add_typer(alarms, name="alarms")


AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@alarms.command()
def export(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]", help="Ends in .csv or .json; absent: CSV on standard output."
        ),
    ] = None,
    asset: Annotated[
        str | None, typer.Option("--asset", metavar="ID", help="Only of this asset.")
    ] = None,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Write every alarm that assets can have, with its settings, texts and time to respond."""
    from service.features.alarm_settings.documents import sheet_of
    from service.features.alarm_settings.sheets import as_csv
    from service.features.alarm_settings.sheets import as_json as as_json_text
    from service.files import replacing
    from service.store import Store

    settings = load_settings(config)
    csv_wanted = file is None or is_csv(file)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        assets = stored_assets(settings, store)
        if asset is not None and asset not in assets:
            known = ", ".join(sorted(assets)) or "none"
            raise SettingsError(f"{asset}: no such asset; expected one of {known}")
        overlays = store.alarm_overlays.present()
        rows: list[dict[str, Any]] = []
        for name in sorted(assets) if asset is None else [asset]:
            rows += sheet_of(store, assets[name], overlays.get(name, {}))
    text = as_csv(rows) if csv_wanted else as_json_text(rows)
    if file is None:
        typer.echo(text, nl=False)
        return
    try:
        with replacing(file) as out:
            out.write(text)
    except OSError as error:
        raise SettingsError(f"{file}: cannot be written ({error.strerror})") from error
    said = {"out": str(file), "alarms": len(rows)}
    typer.echo(json.dumps(said) if as_json else f"{file}: {len(rows)} alarms.")


@alarms.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Ends in .csv or .json.")],
    comment: Annotated[str, typer.Option("--comment", help="Why, for the history.")] = "",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would change, write nothing.")
    ] = False,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Change alarm settings from a sheet, whether the service runs or not.

    All rows or none: one mistake refuses the sheet, and the status is 2 then. A running service
    follows within about two seconds.
    """
    from service.features.alarm_settings.documents import silenced
    from service.features.alarm_settings.settings_changes import judge_settings
    from service.store import Store

    settings = load_settings(config)
    rows, mistakes, said = _read(file)
    comment = (comment or said).strip()
    if not comment and not dry_run:
        raise SettingsError("--comment: missing; expected why the settings change")
    if not is_one_line(comment):
        raise SettingsError(f"--comment: {EXPECTED}")
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        revision = store.alarm_overlays.revision()
        overlays = store.alarm_overlays.present()
        judged = judge_settings(stored_assets(settings, store), overlays, rows)
        mistakes = sorted([*mistakes, *judged.mistakes], key=lambda one: one.place)
        silences = silenced(judged.differences, store.alarms.load())
        if judged.changes and not mistakes and not dry_run:
            shown = ", ".join(f"{one.asset} {one.message}" for one in silences[:5])
            ended = [f"silences active alarms: {shown}"] if silences else []
            line = _line("; ".join([comment, judged.summary, *ended]))
            store.alarm_overlays.change(judged.changes, line, comment, revision)
    if as_json:
        document = {
            "dry_run": dry_run,
            "changed": 0 if mistakes else len(judged.changes),
            "differences": [
                {
                    "asset": one.asset,
                    "kind": one.name[0],
                    "tag": one.name[1],
                    "level": one.name[2],
                    "field": one.field,
                    "before": one.before,
                    "after": one.after,
                }
                for one in judged.differences
            ],
            "mistakes": [
                {"row": one.place, "column": one.column, "detail": one.text} for one in mistakes
            ],
            "silences": [one.id for one in silences],
        }
        typer.echo(json.dumps(document))
    else:
        for one in judged.differences if dry_run else ():
            alarm = " ".join(part for part in one.name if part)
            typer.echo(f"{one.asset} {alarm} {one.field}: {one.before} -> {one.after}")
        for alarm_now in silences:
            typer.echo(f"silences: {alarm_now.asset} {alarm_now.message}")
        if not mistakes:
            would = "would change" if dry_run else "changed"
            typer.echo(f"{file.name}: {len(judged.changes)} alarms {would}.")
    if mistakes:
        for mistake in mistakes:
            sys.stderr.write(f"bearing-twin: {file.name}: {mistake}\n")
        sys.stderr.write(f"bearing-twin: {file.name}: nothing is changed\n")
        sys.exit(2)


def _read(file: Path) -> "tuple[list[WantedRow], list[Mistake], str]":
    from service.features.alarm_settings.sheets import AlarmSheetError, read_csv, read_json

    try:
        content = file.read_bytes()
        return (*read_csv(content), "") if is_csv(file) else read_json(content)
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
    except AlarmSheetError as error:
        raise SettingsError(f"{file.name}: {error}") from error


def _line(detail: str) -> "AuditEntry":
    from service.store import AuditEntry

    actor = command_line_actor()
    action = "alarm_settings.import"
    return AuditEntry(wall_us(), actor.who, actor.address, action, "", detail)
