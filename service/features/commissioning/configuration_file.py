"""The configuration file that the page changes: what a change makes of it, and why it cannot."""

import tomllib
from pathlib import Path
from typing import Any, Final

from service.features.commissioning.documents import Takes
from service.features.commissioning.edited_file import with_tables
from service.features.commissioning.file_versions import read_file, revision_of
from service.features.commissioning.requests import ConfigurationChange, SourceTable
from service.files import why_not_written
from service.site.configuration import SettingsError, TomlTable
from service.site.page_sources import outside_folder, source_from_page
from service.web.api.context import ServiceContext
from service.web.api.problems import Problem, line_error, pointer_problem

_BY_HAND: Final = "and changes are made in the file by hand (docs/start/commissioning.md)"


def changed_text(context: ServiceContext, body: ConfigurationChange) -> tuple[Path, str]:
    """Give the file, and the text that it would hold."""
    file = file_of(context)
    text = read_file(file)
    if revision_of(text) != body.revision:
        raise Problem(409, "the configuration file has been changed meanwhile; read it again")
    in_file, assets = lists_of(text)
    lines: list[str] = []
    for number, one in enumerate(body.sources):
        try:
            source_from_page(one.root, file.parent, f"sources[{number}]", in_file)
        except SettingsError as error:
            lines += error.lines
    networks = {one.get("id"): one.get("network") for one in assets}
    for number, asset in enumerate(body.assets):
        given = asset.root.get("network")
        why = outside_folder(given)
        if why is not None and given != networks.get(asset.root.get("id")):
            lines.append(f"assets[{number}].network = {given!r}: {why}")
    if lines:
        raise Problem(422, lines[0], errors=[line_error(one) for one in lines])
    sources = [one.root for one in body.sources]
    try:
        return file, with_tables(text, sources, [one.root for one in body.assets])
    except SettingsError as error:
        raise Problem(422, error.lines[0]) from error


def source_of(context: ServiceContext, table: SourceTable, *drivers: str) -> Any:
    """Configuration of a source as the page gives it; it has one of these drivers."""
    file = file_of(context)
    in_file, _ = lists_of(read_file(file))
    try:
        config = source_from_page(table.root, file.parent, in_file=in_file)
    except SettingsError as error:
        lines = error.lines
        raise Problem(422, lines[0], errors=[line_error(one) for one in lines]) from error
    if config.driver not in drivers:
        raise pointer_problem(
            "/source/driver", f"{config.driver!r}: expected {' or '.join(drivers)}"
        )
    return config


def refuse_provisioned(context: ServiceContext, text: str) -> None:
    """Refuse an asset that the store has too: it is ambiguous which of them holds."""
    _, assets = lists_of(text)
    stored = {one.id for one in context.store.assets.present()}
    both = [str(one.get("id")) for one in assets if one.get("id") in stored]
    if both:
        raise Problem(
            409, f"asset {both[0]!r} is provisioned already; remove it on the page Assets first"
        )


def stored_tables(context: ServiceContext) -> dict[str, TomlTable]:
    """Tables of the assets that the store has, by id."""
    return {one.id: one.table or {} for one in context.store.assets.present()}


def lists_of(text: str) -> tuple[list[TomlTable], list[TomlTable]]:
    """Sources and assets as the file writes them; none of a file that somebody is just editing."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return [], []
    sources, assets = document.get("sources", []), document.get("assets", [])
    return (
        [one for one in sources if isinstance(one, dict)],
        [one for one in assets if isinstance(one, dict)],
    )


def file_of(context: ServiceContext) -> Path:
    """The file that the page shows; a problem where it can change none."""
    reason, file = why_not(context), context.settings.file
    if reason is not None or file is None:
        raise Problem(409, reason or "there is no configuration file")
    return file


def why_not(context: ServiceContext) -> str | None:
    """Why the page cannot change a file; None where it can."""
    if context.settings.file is None:
        return "the service was started without a configuration file; start it with -c FILE"
    if context.settings.is_fleet:
        return "several cells share the machines: change the configuration file on each of them"
    return None


def file_to_save(context: ServiceContext) -> Path:
    """The file that can be written where it is; a problem where it cannot."""
    file, reason = file_of(context), why_not_saved(context)
    if reason is not None:
        raise Problem(409, reason)
    return file


def why_not_saved(context: ServiceContext) -> str | None:
    """Say why the file cannot be written where it lies: a unit, a mount, a ConfigMap forbid it."""
    file = context.settings.file
    reason = None if file is None else why_not_written(file)
    return None if reason is None else f"{reason}; devices can be looked at, {_BY_HAND}"


def takes_effect(context: ServiceContext) -> Takes:
    """When a saved change takes effect."""
    return "after a restart" if context.apply_file is None else "at once"
