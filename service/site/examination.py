"""Everything that is wrong with a configuration, at once, before anything starts."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_settings import EnvSettingsSource

from service.domain.channels import missing_channels
from service.site.configuration import SettingsError, TomlTable, read_toml
from service.site.settings import Settings, load_settings
from service.site.wiring import AssetTables, Wiring, wire_what_can_be


@dataclass(frozen=True, slots=True)
class Examination:
    """What was found in a configuration.

    - ``settings``: None when a section is wrong.
    - ``wiring``: of all sources and channels that are right.
    - ``errors``: one line each: the file, the key, its value and what was expected.
    - ``warnings``: one line each: what is missing, and what is assumed in its place.
    """

    settings: Settings | None
    wiring: Wiring
    errors: tuple[str, ...]
    warnings: tuple[str, ...]


def examine(file: Path | None, text: str | None = None) -> Examination:
    """Check all sections, sources, channels and networks of a configuration; opens no connection.

    ``text``: what the file would hold, when that is not what it holds now.
    """
    errors: list[str] = []
    settings = None
    try:
        settings = load_settings(file, text)
    except SettingsError as error:
        errors += error.lines
        sources, assets = _tables(file, text)
    else:
        sources = dict(enumerate(settings.sources))
        assets = [
            AssetTables.of(f"assets[{number}]", asset)
            for number, asset in enumerate(settings.assets)
        ]
    wiring, wrong = wire_what_can_be(sources, assets, Path() if file is None else file.parent)
    where = "" if file is None else f"{file}: "
    errors += [where + line for line in wrong]
    warnings = [
        f"{where}{asset.key}.channels ({asset.id}): {one.need} channel {one.channel} is missing: "
        f"{one.without}"
        for asset in assets
        for one in missing_channels(asset.channels)
    ]
    return Examination(settings, wiring, tuple(dict.fromkeys(errors)), tuple(warnings))


def load_site(file: Path | None) -> tuple[Settings, tuple[str, ...]]:
    """Read a configuration with everything that it names; returns it and its warnings.

    Raises `SettingsError`: one line for every error there is.
    """
    found = examine(file)
    if found.errors or found.settings is None:
        raise SettingsError(*found.errors)
    return found.settings, found.warnings


def _tables(file: Path | None, text: str | None) -> tuple[dict[int, TomlTable], list[AssetTables]]:
    """Sources and assets of a configuration that has errors elsewhere, as far as there are any."""
    try:
        document = {} if file is None else read_toml(file, text)
        document |= EnvSettingsSource(Settings)()
    except ValueError:  # said already
        return {}, []
    sources = dict(_numbered(document.get("sources")))
    return sources, [_asset(number, table) for number, table in _numbered(document.get("assets"))]


def _asset(number: int, table: TomlTable) -> AssetTables:
    key = f"assets[{number}]"
    channels, controller = table.get("channels"), table.get("controller")
    return AssetTables(
        key,
        str(table.get("id", key)),
        _tables_in(channels),
        _tables_in(controller),
    )


def _tables_in(section: Any) -> dict[str, TomlTable]:
    if not isinstance(section, dict):
        return {}
    return {name: table for name, table in section.items() if isinstance(table, dict)}


def _numbered(tables: Any) -> list[tuple[int, TomlTable]]:
    if not isinstance(tables, list | tuple):
        return []
    return [(number, table) for number, table in enumerate(tables) if isinstance(table, dict)]
