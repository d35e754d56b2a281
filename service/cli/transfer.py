"""``bearing-twin import`` and ``export``: history as files."""

import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from adapters.times import EARLIEST_US, latest_us
from service.cli.known_assets import find_asset, no_such_asset
from service.cli.progress import progress_bar
from service.cli.serve import ConfigFile
from service.clock import from_rfc3339, rfc3339
from service.site.configuration import SettingsError
from service.site.settings import Settings, load_settings

_SHOWN_REJECTED = 20
#: Wall seconds between two lines of progress where there is no terminal.
_PROGRESS_S = 5.0
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]
AssetId = Annotated[str, typer.Option(help="Asset that the data belong to.")]


def import_(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="CSV, Parquet (.parquet), MDF 4 or MDF 3.")
    ],
    asset: AssetId,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="RFC3339",
            help="Time of 0 s, for a file with a column time_s or one of no time zone.",
        ),
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Which column is which channel (TOML).")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the file, store nothing.")] = (
        False
    ),
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Bring recorded data into the store.

    Columns are named as channels, or a mapping says which is which. Rows that cannot be used are
    named with their lines and left out; the status is 2 then. Importing a file again changes
    nothing.
    """
    from service.clock import ProcessClock
    from service.store import Store
    from service.transfer.importing import import_file

    settings = load_settings(config)
    channels = _channels(settings, asset)
    start_us = None if start is None else _time_us("--start", start)
    with ExitStack() as stack:
        store = None
        if not dry_run:
            store = stack.enter_context(
                Store.open(settings.service.database_url, settings.data_dir)
            )
        show = stack.enter_context(progress_bar(f"import {file.name}", _PROGRESS_S))
        report = import_file(
            file,
            asset,
            store,
            mapping=mapping,
            start_us=start_us,
            own_channels=channels,
            now_us=ProcessClock.of(settings.data_dir).now_us(),
            progress=lambda share: show(share, ""),
        )
    if as_json:
        document = {
            "rows": report.rows,
            "samples": report.samples,
            "stored": report.stored,
            "duplicates": report.duplicates,
            "too_old": report.too_old,
            "rejected": report.rejected,
            "errors": [{"line": one.line, "detail": one.detail} for one in report.first_rejected],
            "conversions": report.conversions,
            "dry_run": dry_run,
        }
        typer.echo(json.dumps(document))
    else:
        done = "would be stored" if dry_run else f"{report.stored} stored"
        known = "" if dry_run else f", {report.duplicates} already stored"
        typer.echo(f"{file.name}: {report.rows} rows, {report.samples} samples: {done}{known}.")
        for conversion in report.conversions:
            typer.echo(f"{file.name}: {conversion}")
    if report.too_old and store is not None:
        typer.echo(
            f"{file.name}: {report.too_old} samples are older than "
            f"{rfc3339(store.samples.kept_from_us)}, before which history has been removed, "
            "and were not stored; "
            "'bearing-twin db horizon' shows and lowers this time",
            err=True,
        )
    if report.rejected:
        for one in report.first_rejected[:_SHOWN_REJECTED]:
            typer.echo(f"{file.name}: line {one.line}: {one.detail}", err=True)
        typer.echo(f"{file.name}: {report.rejected} rows or cells were not taken", err=True)
    if report.rejected or report.too_old:
        sys.exit(2)


def export(
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Ends in .csv, .parquet or .mf4.", dir_okay=False)
    ],
    asset: AssetId,
    channel: Annotated[
        list[str] | None, typer.Option(help="Repeatable; all channels if absent.")
    ] = None,
    start: Annotated[
        str | None, typer.Option(metavar="RFC3339", help="From this time on; else from the first.")
    ] = None,
    end: Annotated[
        str | None, typer.Option(metavar="RFC3339", help="Before this time; else to the last.")
    ] = None,
    resolution: Annotated[str, typer.Option(help="raw, 1s, 1min, 1h, or minutes.")] = "raw",
    received: Annotated[
        bool, typer.Option("--received", help="Also when each raw sample was received.")
    ] = False,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Write history into a file.

    One row per sample or bucket with its quality; "import" reads raw samples back. With the
    resolution "minutes" one row per minute and a column per channel, as "identify" reads it.
    """
    from service.clock import ProcessClock
    from service.store import Store
    from service.transfer.exporting import export_file, export_minutes
    from service.transfer.pages import RAW, ExportPosition, is_resolution

    settings = load_settings(config)
    now_us = ProcessClock.of(settings.data_dir).now_us()
    start_us = EARLIEST_US if start is None else _time_us("--start", start)
    end_us = latest_us(now_us) + 1 if end is None else _time_us("--end", end)
    if end_us <= start_us:
        raise SettingsError(
            f"--start {start or 'not given'}, --end {end or 'not given'}: expected an end after "
            "the start; without them it is from 1990 to tomorrow"
        )
    minutes = resolution == "minutes"
    if not minutes and not is_resolution(resolution):
        raise SettingsError(f"--resolution {resolution}: expected raw, 1s, 1min, 1h or minutes")
    if received and resolution != RAW:
        raise SettingsError(f"--received: expected --resolution raw, not {resolution}")
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        known = store.samples.channels(asset)
        if not known:  # what the configuration names no more can still be exported
            stored = sorted({one for one, _ in store.samples.counts(0)})
            is_strange = bool(settings.assets or stored) and asset not in stored
            if is_strange and find_asset(settings, asset) is None:
                raise no_such_asset(settings, f"--asset {asset}", stored)
        for name in channel or ():
            if name not in known:
                raise SettingsError(
                    f"--channel {name}: asset {asset!r} has no such history; "
                    f"expected one of {', '.join(known) or 'none, there is no history'}"
                )
        if minutes:
            rows = export_minutes(out, store, asset, channel or known, start_us, end_us)
        else:
            place = ExportPosition(
                resolution=resolution,
                start_us=start_us,
                end_us=end_us,
                channels=channel,
                received=received,
            )
            rows = export_file(out, store, asset, place)
        left_out = 0
        if start is None or end is None:
            strange = store.impossible_times.find(now_us, [asset])
            left_out = sum(
                one.samples for one in strange if channel is None or one.channel in channel
            )
    if left_out:
        typer.echo(
            f"{out}: {left_out} samples of times before 1990 or after tomorrow are not exported; "
            "'bearing-twin db times' lists and removes them",
            err=True,
        )
    if as_json:
        typer.echo(json.dumps({"out": str(out), "rows": rows}))
    else:
        typer.echo(f"{out}: {rows} rows.")


def _channels(settings: Settings, asset: str) -> list[str] | None:
    """Channels of an asset with a network of its own; None for others.

    Without any asset in the configuration every name is taken.
    """
    found = find_asset(settings, asset)
    if found is not None:
        return None if found.network is None else list(found.channels)
    if settings.assets:
        raise no_such_asset(settings, f"--asset {asset}")
    return None


def _time_us(option: str, text: str) -> int:
    try:
        return from_rfc3339(text)
    except ValueError as error:
        raise SettingsError(f"{option}: {error}") from None
