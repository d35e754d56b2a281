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

    Raises
    ------
    SettingsError
        If what the store holds does not fit the configuration.
    """
    from service.site.provisioning import check_asset

    for one in settings.assets:
        if one.id == asset:
            return one
    table = {one.id: one.table for one in _provisioned(settings)}.get(asset)
    return None if table is None else check_asset(settings, asset, table).section


def no_such_asset(settings: Settings, asset: str, others: Collection[str] = ()) -> SettingsError:
    """Make the error of an asset that there is not.

    Parameters
    ----------
    settings
        The configuration.
    asset
        As it was given, with the option.
    others
        Further names that may be given.
    """
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


def _provisioned(settings: Settings) -> "list[ProvisionedAsset]":
    with store_if_there(settings) as store:
        return [] if store is None else store.assets.present()
