"""Assets that are not in the configuration file, checked as if they stood in it."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from adapters.configuration import listed
from adapters.words import shown
from service.domain.upload_limits import in_time
from service.site.asset_section import AssetSection
from service.site.configuration import SettingsError, TomlTable
from service.site.page_sources import outside_folder
from service.site.settings import Settings
from service.site.templates import TEMPLATE, from_template
from service.site.wiring import PUSH, Wiring, wire_assets

_NETWORK: Final = "network"
#: Assets that a line names.
_NAMED: Final = 5


@dataclass(frozen=True, slots=True)
class CheckedAsset:
    """An asset whose table is right.

    ``wiring``: its channels, and of its sources what is read for it alone.
    """

    section: AssetSection
    wiring: Wiring


class AssetInFileError(SettingsError):
    """An asset that stands in the configuration file: only a change there changes it."""


def check_asset(settings: Settings, asset_id: str, table: TomlTable) -> CheckedAsset:
    """Check the table of an asset, and its channels against the sources of the file.

    ``asset_id`` begins each line of an error. Raises `AssetInFileError` if the configuration file
    has an asset of this id; `SettingsError`: one line for each error.
    """
    return _check(settings, asset_id, table, {one.id for one in settings.assets})


def check_assets(
    settings: Settings, tables: Mapping[str, TomlTable], seconds: float | None = None
) -> tuple[dict[str, CheckedAsset], dict[str, tuple[str, ...]]]:
    """Check many tables by id; returns those that are right, and what is wrong with the others.

    Raises `UploadTooLargeError` if it takes more than so many seconds of processor time; None: any.
    """
    in_file = {one.id for one in settings.assets}
    right: dict[str, CheckedAsset] = {}
    wrong: dict[str, tuple[str, ...]] = {}
    for asset_id, table in in_time(tables.items(), seconds):
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
        raise SettingsError(f"{asset_id}.id = {shown(given)}: expected {asset_id!r} or none")
    section = settings.asset({"id": asset_id} | table, asset_id)
    _check_json(section, table)
    return of_section(settings, section)


def misfits(
    settings: Settings, tables: Mapping[str, TomlTable], seconds: float | None = None
) -> list[str]:
    """Say which assets do not fit the configuration: one line for each problem, with its assets.

    Raises `UploadTooLargeError` if it takes more than so many seconds of processor time; None: any.
    """
    _, wrong = check_assets(settings, tables, seconds)
    by_line: dict[str, list[str]] = {}
    for name, lines in wrong.items():
        for line in lines:
            by_line.setdefault(key_line(name, line), []).append(name)
    return [
        f"assets in the store: {line} ({len(names)} of {len(tables)}: {listed(names, _NAMED)})"
        for line, names in by_line.items()
    ]


def key_line(asset_id: str, line: str) -> str:
    """Give a line of an error from the key on, without the asset that it begins with."""
    for begin in (f"{asset_id}.", f"{asset_id}: "):
        if line.startswith(begin):
            return line.removeprefix(begin)
    return line


def outside_network(settings: Settings, table: TomlTable) -> str | None:
    """Give the file of an asset's network where it lies outside the folder of the configuration.

    Who has an administrator's key names no files of the machine; a template of the file may.
    """
    name = table.get(TEMPLATE)
    template = next((one for one in settings.templates if one.get("name") == name), {})
    try:
        whole = from_template(table, {str(name): template}, "")
    except SettingsError:  # the check of the asset says what is wrong
        whole = table
    network = whole.get(_NETWORK)
    is_of_file = _NETWORK not in table and network == template.get(_NETWORK)
    return None if is_of_file or outside_folder(network) is None else str(network)


def of_section(settings: Settings, section: AssetSection) -> CheckedAsset:
    """Wire a single asset, of the file or of the store."""
    wiring = wire_assets(_with_its_sources(settings, section), {section.id: section})
    return CheckedAsset(section, wiring)


def wire_sources(asset: AssetSection) -> set[str]:
    """Names of the sources that an asset is read from; none where all is pushed."""
    tables = (*asset.channels.values(), *(one for _, one in asset.controller if one is not None))
    return {str(table.get("source")) for table in tables} - {PUSH}


def _check_json(section: AssetSection, table: TomlTable) -> None:
    """Refuse what JSON, or a text of PostgreSQL, cannot hold."""
    wrong = ""
    try:
        text = json.dumps(table, ensure_ascii=False, allow_nan=False).encode()
    except ValueError as error:
        wrong = f"{error}; expected finite numbers and texts of Unicode characters"
    else:
        if rb"\u0000" in text:
            wrong = "expected texts without the character NUL"
    if wrong:
        names = [f"{section.id}.{line}" for line in section.lines_in_names]
        raise SettingsError(*(names or [f"{section.id}: {wrong}"]))


def _with_its_sources(settings: Settings, asset: AssetSection) -> Settings:
    """Give the configuration with the sources alone that an asset names: there may be hundreds."""
    named = wire_sources(asset)
    sources = tuple(one for one in settings.sources if one.get("name") in named)
    if len(sources) < len(named):
        return settings  # a name is wrong: the error lists those that there are
    return settings.model_copy(update={"sources": sources})
