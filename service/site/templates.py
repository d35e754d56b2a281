"""What many assets have in common, written once; each gives only what is its own.

A template is the table of an asset with holes: ``"{unit}"`` stands for a value that each asset
gives. A text that is nothing but a hole becomes the value as it is, a number for a number.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

from adapters.configuration import suggestion
from adapters.words import shown
from service.site.configuration import SettingsError, TomlTable

#: Key of an asset that names its template, and of both that gives values.
TEMPLATE: Final = "template"
VALUES: Final = "values"
#: The one value that is never given.
_ID: Final = "id"
#: Keys of a template that are no keys of an asset.
_OWN: Final = ("name", VALUES)
_HOLE = re.compile(r"\{([a-z][a-z0-9_]*)\}")


def templates_by_name(given: object) -> dict[str, TomlTable]:
    """Sort the templates of a configuration by name.

    Raises `SettingsError` if one has no name, or two have the same.
    """
    found: dict[str, TomlTable] = {}
    for number, table in enumerate(given if isinstance(given, list | tuple) else ()):
        key = f"templates[{number}]"
        name = table.get("name") if isinstance(table, dict) else None
        if not isinstance(name, str) or not name:
            raise SettingsError(f"{key}.name = {shown(name)}: expected a name")
        if name in found:
            raise SettingsError(f"{key}.name = {shown(name)}: used twice; expected unique")
        if _ID in table:
            raise SettingsError(f"{key}.id: unknown key; each asset has an id of its own")
        if not isinstance(table.get(VALUES, {}), dict):
            raise SettingsError(f"{key}.values: expected a table of values by name")
        found[name] = table
    return found


def from_template(asset: TomlTable, templates: Mapping[str, TomlTable], key: str) -> TomlTable:
    """Make the whole table of an asset from its template and what it gives itself.

    What the asset gives wins over the template; tables are merged key by key. Raises
    `SettingsError` if there is no such template, a value is missing, or one that no hole asks for
    is given.
    """
    name = asset.get(TEMPLATE)
    if not name:
        if VALUES in asset:
            raise SettingsError(f"{key}.values: expected a template too, whose holes they fill")
        return asset
    if not isinstance(name, str) or name not in templates:
        known = suggestion(str(name), templates) if templates else "there are no templates"
        raise SettingsError(f"{key}.template = {shown(name)}: {known}")
    given = asset.get(VALUES, {})
    if not isinstance(given, dict):
        raise SettingsError(f"{key}.values: expected a table of values by name")
    template = templates[name]
    values = template.get(VALUES, {}) | given | {_ID: asset.get(_ID, "")}
    asked: set[str] = set()
    body = {part: one for part, one in template.items() if part not in _OWN}
    filled = _filled(body, values, asked)
    missing = sorted(asked - values.keys())
    unasked = sorted(given.keys() - asked)
    if missing or unasked:
        raise SettingsError(
            *(f"{key}.values.{one}: missing; template {name!r} asks for it" for one in missing),
            *(f"{key}.values.{one}: template {name!r} does not ask for it" for one in unasked),
        )
    own = {part: one for part, one in asset.items() if part != VALUES}
    return _merged(filled, own)


def holes_of(template: TomlTable) -> list[str]:
    """Names of the values that a template asks for, those that it gives itself too."""
    asked: set[str] = set()
    _filled({part: one for part, one in template.items() if part not in _OWN}, {}, asked)
    return sorted(asked - {_ID})


def _filled(part: Any, values: Mapping[str, Any], asked: set[str]) -> Any:
    """Give a part of a template with its holes filled; notes what it asks for."""
    if isinstance(part, dict):
        return {name: _filled(one, values, asked) for name, one in part.items()}
    if isinstance(part, list | tuple):
        return [_filled(one, values, asked) for one in part]
    if not isinstance(part, str):
        return part
    asked.update(_HOLE.findall(part))
    whole = _HOLE.fullmatch(part)
    if whole:
        return values.get(whole[1])
    return _HOLE.sub(lambda hole: str(values.get(hole[1], "")), part)


def _merged(below: TomlTable, above: TomlTable) -> TomlTable:
    """Lay a table over another, key by key."""

    def both(name: str) -> Any:
        under, over = below.get(name), above[name]
        return _merged(under, over) if isinstance(under, dict) and isinstance(over, dict) else over

    return below | {name: both(name) for name in above}
