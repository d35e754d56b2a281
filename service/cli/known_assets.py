"""Assets that commands may name: those of the configuration file, and the provisioned ones."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.configuration import listed
from service.site.asset_section import AssetSection
from service.site.configuration import SettingsError
from service.site.settings import Settings

if TYPE_CHECKING:
    from service.store import ProvisionedAsset, Store


def find_asset(settings: Settings, asset: str) -> AssetSection | None:
    """Give an asset of the file or of the store; None where there is none of this id.

    Raises `SettingsError` if what the store holds does not fit the configuration.
    """
    from service.site.asset_tables import check_asset

    for one in settings.assets:
        if one.id == asset:
            return one
    table = {one.id: one.table for one in _provisioned(settings)}.get(asset)
    return None if table is None else check_asset(settings, asset, table).section


def no_such_asset(settings: Settings, asset: str, others: Collection[str] = ()) -> SettingsError:
    """Make the error of an asset that there is not."""
    return SettingsError(f"{asset}: no such asset; expected one of {asset_names(settings, others)}")


def asset_names(settings: Settings, others: Collection[str] = ()) -> str:
    """List the assets that there are, and others, for a message."""
    names = [one.id for one in settings.assets] + [one.id for one in _provisioned(settings)]
    return listed(dict.fromkeys([*names, *others])) or "none"


@contextmanager
def store_if_there(settings: Settings) -> "Iterator[Store | None]":
    """Open the store; None where there is none yet: it is not made for it."""
    from service.store import Store
    from service.store.opening import database_address

    url = database_address(settings.service.database_url, settings.data_dir)
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():
        yield None
        return
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        yield store


def store_problems(settings: Settings) -> tuple[list[str], list[str]]:
    """Say what of the store does not fit the configuration: assets, and keys that are missing.

    Returns the problems, one line for each with its assets, and why the store was not looked into.
    """
    from service.security.keys import check_key
    from service.site.asset_tables import misfits
    from service.store import StoreError

    try:
        with store_if_there(settings) as store:
            present = [] if store is None else store.assets.present()
            problems = misfits(settings, {one.id: one.table or {} for one in present})
            try:
                check_key(store, settings.service.host)
            except SettingsError as error:
                problems += error.lines
    except (OSError, StoreError) as error:
        return [], [f"the assets in the store were not checked: {error}"]
    return problems, []


def _provisioned(settings: Settings) -> "list[ProvisionedAsset]":
    with store_if_there(settings) as store:
        return [] if store is None else store.assets.present()
