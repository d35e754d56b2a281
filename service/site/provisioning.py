"""Assets that are not in the configuration file, checked as if they stood in it."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from service.site.asset_section import AssetSection
from service.site.configuration import SettingsError, TomlTable
from service.site.settings import Settings
from service.site.wiring import PUSH, Wiring, wire_assets


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


class AssetInFileError(SettingsError):
    """An asset that stands in the configuration file: only a change there changes it."""


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
    AssetInFileError
        If the configuration file has an asset of this id.
    SettingsError
        One line for each error.
    """
    return _check(settings, asset_id, table, {one.id for one in settings.assets})


def check_assets(
    settings: Settings, tables: Mapping[str, TomlTable]
) -> tuple[dict[str, CheckedAsset], dict[str, tuple[str, ...]]]:
    """Check many tables by id; returns those that are right, and what is wrong with the others."""
    in_file = {one.id for one in settings.assets}
    right: dict[str, CheckedAsset] = {}
    wrong: dict[str, tuple[str, ...]] = {}
    for asset_id, table in tables.items():
        try:
            right[asset_id] = _check(settings, asset_id, table, in_file)
        except SettingsError as error:
            wrong[asset_id] = error.lines
    return right, wrong


def _check(
    settings: Settings, asset_id: str, table: TomlTable, in_file: Collection[str]
) -> CheckedAsset:
    if asset_id in in_file:
        raise AssetInFileError(
            f"{asset_id}: stands in the configuration file; expected another id, or a change there"
        )
    given = table.get("id", asset_id)
    if given != asset_id:
        raise SettingsError(f"{asset_id}.id = {given!r}: expected {asset_id!r} or none")
    _check_json(asset_id, table)
    return of_section(settings, settings.asset({"id": asset_id} | table, asset_id))


def of_section(settings: Settings, section: AssetSection) -> CheckedAsset:
    """Wire one asset by itself, of the file or of the store."""
    wiring = wire_assets(_with_its_sources(settings, section), {section.id: section})
    return CheckedAsset(section, wiring)


def wire_sources(asset: AssetSection) -> set[str]:
    """Names of the sources that an asset is read from; none where all is pushed."""
    tables = (*asset.channels.values(), *(one for _, one in asset.controller if one is not None))
    return {str(table.get("source")) for table in tables} - {PUSH}


def _check_json(asset_id: str, table: TomlTable) -> None:
    """Refuse what JSON, or a text of PostgreSQL, cannot hold."""
    try:
        text = json.dumps(table, ensure_ascii=False, allow_nan=False).encode()
    except ValueError as error:
        raise SettingsError(
            f"{asset_id}: {error}; expected finite numbers and texts of Unicode characters"
        ) from error
    if rb"\u0000" in text:
        raise SettingsError(f"{asset_id}: expected texts without the character NUL")


def _with_its_sources(settings: Settings, asset: AssetSection) -> Settings:
    """Give the configuration with the sources alone that an asset names: there may be hundreds."""
    named = wire_sources(asset)
    sources = tuple(one for one in settings.sources if one.get("name") in named)
    if len(sources) < len(named):
        return settings  # a name is wrong: the error lists those that there are
    return settings.model_copy(update={"sources": sources})
