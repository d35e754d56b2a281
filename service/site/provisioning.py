"""Assets that are not in the configuration file, checked as if they stood in it."""

from collections.abc import Mapping
from dataclasses import dataclass

from service.site.configuration import SettingsError, TomlTable
from service.site.settings import AssetSection, Settings
from service.site.wiring import Wiring, wire_assets


@dataclass(frozen=True, slots=True)
class CheckedAsset:
    """An asset whose table is right.

    Attributes
    ----------
    section
        What it is.
    wiring
        Its channels, and of its sources what is read for it alone.
    """

    section: AssetSection
    wiring: Wiring


def check_asset(settings: Settings, asset_id: str, table: TomlTable) -> CheckedAsset:
    """Check the table of an asset, and its channels against the sources of the file.

    Parameters
    ----------
    settings
        The configuration, whose templates, bearings and sources it may name.
    asset_id
        Begins each line of an error.
    table
        As in the file, without its id.

    Raises
    ------
    SettingsError
        One line for each error.
    """
    given = table.get("id", asset_id)
    if given != asset_id:
        raise SettingsError(f"{asset_id}.id = {given!r}: expected {asset_id!r} or none")
    if any(one.id == asset_id for one in settings.assets):
        raise SettingsError(
            f"{asset_id}: stands in the configuration file; expected another id, or a change there"
        )
    section = settings.asset({"id": asset_id} | table, asset_id)
    return CheckedAsset(section, wire_assets(settings, {asset_id: section}))


def check_assets(
    settings: Settings, tables: Mapping[str, TomlTable]
) -> tuple[dict[str, CheckedAsset], dict[str, tuple[str, ...]]]:
    """Check many tables by id; returns those that are right, and what is wrong with the others."""
    right: dict[str, CheckedAsset] = {}
    wrong: dict[str, tuple[str, ...]] = {}
    for asset_id, table in tables.items():
        try:
            right[asset_id] = check_asset(settings, asset_id, table)
        except SettingsError as error:
            wrong[asset_id] = error.lines
    return right, wrong
