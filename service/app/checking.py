"""Everything that is wrong with a configuration, at once, before anything starts."""

import socket
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

    Attributes
    ----------
    settings
        None when a section is wrong.
    wiring
        Of all sources and channels that are right.
    errors
        One line each: the file, the key, its value and what was expected.
    warnings
        One line each: what is missing, and what is assumed in its place.
    """

    settings: Settings | None
    wiring: Wiring
    errors: tuple[str, ...]
    warnings: tuple[str, ...]


def examine(file: Path | None) -> Examination:
    """Check all sections, sources, channels and networks of a configuration; opens no connection.

    Parameters
    ----------
    file
        TOML file; None takes the defaults and the environment.
    """
    errors: list[str] = []
    settings = None
    try:
        settings = load_settings(file)
    except SettingsError as error:
        errors += error.lines
        sources, assets = _tables(file)
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
    if settings is not None:
        # Imported here: it needs the whole configuration, and most have nothing to warn of.
        from service.plant.publishers import warnings as of_publishers

        warnings += [where + line for line in of_publishers(settings)]
    return Examination(settings, wiring, tuple(dict.fromkeys(errors)), tuple(warnings))


def environment_errors(settings: Settings) -> list[str]:
    """Say what the machine lacks that the configuration asks for, one line each."""
    # Imported here: most configurations need it not, and it loads much.
    errors: list[str] = []
    if settings.tls is not None:
        from service.security.tls import tls_context

        tls = settings.tls
        try:
            tls_context(settings.path(tls.certificate), settings.path(tls.key))
        except SettingsError as error:
            errors += error.lines
    from service.notifications.senders import check_senders
    from service.plant.publishers import check_extras

    for check in (check_extras, check_senders):
        try:
            check(settings)
        except SettingsError as error:
            errors += error.lines
    if settings.is_fleet:
        errors += _fleet_errors(settings)
    return errors


def _fleet_errors(settings: Settings) -> list[str]:
    """Say what the cells of a fleet would not find, one line each."""
    from service.bus.fleet_connection import connection_problem
    from service.store import Store, StoreError

    errors = []
    try:
        Store.open(settings.service.database_url, settings.data_dir).close()
    except StoreError as error:
        errors.append(str(error))
    problem = connection_problem(settings)
    return errors if problem is None else [*errors, problem]


def ports_in_use(settings: Settings) -> list[str]:
    """Name the ports of the configuration that another program listens on, one line each."""
    from service.plant.publishers import endpoints

    section = settings.service
    places = {f"service.port = {section.port}": (section.host, section.port)}
    places |= {one.key: (one.host, one.port) for one in endpoints(settings)}
    return [
        f"{key}: cannot listen there ({why}); expected a free port, or this service runs already"
        for key, (host, port) in places.items()
        if (why := _why_not_bound(host, port))
    ]


def _why_not_bound(host: str, port: int) -> str:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.strerror or str(error)
    return ""


def load_site(file: Path | None) -> tuple[Settings, tuple[str, ...]]:
    """Read a configuration with everything that it names; returns it and its warnings.

    Raises
    ------
    SettingsError
        One line for every error there is.
    """
    found = examine(file)
    if found.errors or found.settings is None:
        raise SettingsError(*found.errors)
    return found.settings, found.warnings


def _tables(file: Path | None) -> tuple[dict[int, TomlTable], list[AssetTables]]:
    """Sources and assets of a configuration that has errors elsewhere, as far as there are any."""
    try:
        document = {} if file is None else read_toml(file)
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
