"""``bearing-twin runs`` and ``report``: what a machine ran, and a run on paper."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from zoneinfo import available_timezones

import typer

from service.cli.known_assets import find_asset, no_such_asset
from service.cli.serve import ConfigFile
from service.clock import ProcessClock
from service.domain.texts import visible
from service.files import replacing
from service.site.configuration import SettingsError
from service.site.settings import Settings, load_settings

if TYPE_CHECKING:
    from service.store import Store

_MOST = 1000
LAST = "last"
AssetId = Annotated[str, typer.Argument(metavar="ASSET", help="Whose runs.")]


def register(app: typer.Typer) -> None:
    """Add ``runs`` and ``report``."""
    app.command()(runs)
    app.command()(report)


def runs(
    asset: AssetId,
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """List the runs of an asset, from start to standstill, the latest first (at most 1000).

    They are found in the stored speed; the service may run or not.
    """
    from service.features.runs.documents import run_document
    from service.features.runs.runs import Runs

    with _opened(config, asset) as (_, store, _):
        page = store.part(Runs).page(asset, _MOST)
    documents = [run_document(run) for run in page.items]
    if as_json:
        typer.echo(json.dumps({"items": [one.model_dump() for one in documents]}))
        return
    for one in documents:
        length = "goes on" if one.duration_s is None else f"{one.duration_s / 3600:.1f} h"
        name = visible(one.name or "")
        typer.echo(f"{one.id:<20}{one.start[:16]}Z  {length:>9}  {one.ended or '':<10}  {name}")
    if not documents:
        typer.echo(f"{asset}: no run is stored.")


def report(
    asset: AssetId,
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Ends in .pdf, .png or .csv.", dir_okay=False),
    ],
    run: Annotated[str, typer.Option(help='Id of the run as "runs" lists it, or "last".')] = LAST,
    time_zone: Annotated[
        str, typer.Option(metavar="ZONE", help="Of the local times next to UTC: Europe/Berlin.")
    ] = "UTC",
    config: ConfigFile = None,
) -> None:
    """Write the report of a run: what was run, limits, alarms, forecasts, models, quality of data.

    The same file for the same data. PDF and PNG need the extra "report". The service may run or
    not.
    """
    from service.features.runs.report.files import FORMATS, report_file
    from service.features.runs.report.run_limits import asset_of_run
    from service.features.runs.runs import Runs

    format = next((one for one in FORMATS if out.suffix.lower() == f".{one}"), None)
    if format is None:
        raise SettingsError(f"--out {out}: expected a name that ends in .pdf, .png or .csv")
    if time_zone not in available_timezones():
        raise SettingsError(f"--time-zone {time_zone}: expected a name such as Europe/Berlin")
    with _opened(config, asset) as (settings, store, now_us):
        latest = store.part(Runs).page(asset, 1).items
        found = next(iter(latest), None) if run == LAST else store.part(Runs).get(asset, run)
        if found is None:
            known = ", ".join([LAST, *(one.id for one in store.part(Runs).page(asset, 5).items)])
            raise SettingsError(
                f"--run {run}: no such run of asset {asset}; expected one of {known}"
                if latest
                else f"{asset}: no run is stored; expected speed_rpm in its history"
            )
        section = asset_of_run(settings, store, found)
        if section is None:
            raise no_such_asset(settings, asset)
        data = report_file(store, section, found, format, now_us, time_zone)
    with replacing(out, binary=True) as file:
        file.write(data)
    typer.echo(f"{out}: run {found.id} of {asset}, {len(data) / 1e3:.0f} kB.")


@contextmanager
def _opened(config: Path | None, asset: str) -> "Iterator[tuple[Settings, Store, int]]":
    """The configuration, the store with the runs of an asset as they are now, the process time."""
    from service.features.runs.runs import Runs
    from service.store import Store

    settings = load_settings(config)
    if find_asset(settings, asset) is None:
        raise no_such_asset(settings, asset)
    now_us = ProcessClock.resume(settings.clock.rate, settings.data_dir).now_us()
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        store.part(Runs).refresh(asset, now_us)
        yield settings, store, now_us
