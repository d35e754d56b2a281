"""``bearing-twin grease-renewed``: the revolutions of a machine count from zero again."""

import json
from typing import Annotated

import typer

from service.cli.keys import command_line_actor
from service.cli.known_assets import find_asset, no_such_asset
from service.cli.serve import ConfigFile
from service.domain.texts import EXPECTED, is_one_line
from service.site.configuration import SettingsError
from service.site.settings import load_settings


def grease_renewed(
    asset: Annotated[str, typer.Argument(metavar="ID", help="Asset whose grease was renewed.")],
    comment: Annotated[str, typer.Option(help="For the audit trail.")] = "",
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Count the revolutions of a machine from zero again, while the service is stopped.

    A running service takes POST /api/v1/assets/ID/grease-renewed (role engineer) instead.
    """
    from service.clock import wall_us
    from service.store import AuditEntry, DataDirectoryInUseError, Store, lock_data_directory

    if not is_one_line(comment):
        raise SettingsError(f"--comment: {EXPECTED}")
    settings = load_settings(config)
    if find_asset(settings, asset) is None:
        raise no_such_asset(settings, asset)
    try:
        lock = lock_data_directory(settings.data_dir)
    except DataDirectoryInUseError:
        raise SettingsError(
            f"{asset}: the service is running; "
            f"use POST /api/v1/assets/{asset}/grease-renewed, or stop it first"
        ) from None
    with lock, Store.open(settings.service.database_url, settings.data_dir) as store:
        kept = dict(store.states.load(asset) or {})
        observer = kept.get("observer")
        if not isinstance(observer, dict):
            raise SettingsError(f"{asset}: the store has no estimate of it; nothing is counted yet")
        before = float(observer.get("revolutions") or 0.0)
        kept["observer"] = observer | {"revolutions": 0.0}
        if isinstance(kept.get("watch"), dict):
            kept["watch"] = kept["watch"] | {"reference": None}
        actor = command_line_actor()
        line = AuditEntry(
            wall_us(),
            actor.who,
            actor.address,
            "asset.grease-renewed",
            f"asset {asset}",
            f"comment: {comment}" if comment else "",
        )
        store.states.save(asset, kept, [line])
    if as_json:
        typer.echo(json.dumps({"revolutions_before": round(before), "revolutions": 0}))
    else:
        typer.echo(f"{asset}: grease renewed after {before:.0f} revolutions")
