"""Sources and assets put into the text of a configuration file; all else stays as it was written.

The file that the page saves is the file that a person would write: TOML, with the comments that
are there, one inline table for each channel.
"""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, Final

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Item, Table

from service.site.configuration import SettingsError, TomlTable

#: Keys that name the tables of each list.
_NAMED_BY: Final = {"sources": "name", "assets": "id"}
#: Tables of an asset with a line for each of their parts.
_LONG: Final = ("channels", "controller", "limits")
_DEEPEST: Final = 8


def with_tables(text: str, sources: Sequence[TomlTable], assets: Sequence[TomlTable]) -> str:
    """Give a configuration's text with some sources and assets made or changed.

    ``sources``, ``assets``: whole tables. One of a known name or id takes the place of the one that
    is there. Raises `SettingsError` if the text is no TOML, or its sources or assets are written as
    something else than ``[[sources]]`` and ``[[assets]]``.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as error:
        raise SettingsError(f"configuration file: not valid TOML ({error})") from error
    for key, tables in (("sources", sources), ("assets", assets)):
        if not tables:
            continue
        known = document.get(key)
        if known is None:
            known = tomlkit.aot()
            document.append(key, known)
            known = document[key]
        if not isinstance(known, AoT):
            raise SettingsError(f"{key}: expected [[{key}]] in the configuration file")
        for table in tables:
            _put(known, _NAMED_BY[key], table)
    written = tomlkit.dumps(document)
    _prove(written, sources, assets)
    return written


def _put(known: AoT, name: str, table: TomlTable) -> None:
    for one in known:
        if one.get(name) == table.get(name):
            _change(one, table)
            return
    known.append(_table(table))


def _change(present: Table | InlineTable, wanted: Mapping[str, Any]) -> None:
    """Make a table another, and leave the lines that stay the same."""
    for key in [key for key in present if key not in wanted]:
        present.remove(key)
    for key, value in wanted.items():
        there = present.get(key)
        if isinstance(there, Table | InlineTable) and isinstance(value, Mapping):
            _change(there, value)
        elif there is None or _plain(there) != value:
            present[key] = _line(value)


def _plain(item: Any) -> Any:
    return item.unwrap() if isinstance(item, Item) else item


def _table(table: TomlTable) -> Table:
    """Write a table of a list: its own keys first, then the tables with many lines."""
    made = tomlkit.table()
    for key, value in table.items():
        if not (key in _LONG and isinstance(value, Mapping)):
            made.append(key, _line(value))
    made.add(tomlkit.nl())
    for key, value in table.items():
        if key in _LONG and isinstance(value, Mapping):
            part = tomlkit.table()
            for name, one in value.items():
                part.append(name, _line(one))
            part.add(tomlkit.nl())
            made.append(key, part)
    return made


def _line(value: Any, depth: int = 0) -> Item:
    """Write a value on one line."""
    if depth > _DEEPEST or value is None:
        raise SettingsError(f"{value!r}: TOML has no such value")
    if isinstance(value, Mapping):
        inline = tomlkit.inline_table()
        for key, one in value.items():
            inline.append(key, _line(one, depth + 1))
        return inline
    if isinstance(value, list | tuple):
        array = tomlkit.array()
        for one in value:
            array.append(_line(one, depth + 1))
        return array
    made: Item = tomlkit.item(value)
    return made


def _prove(text: str, sources: Sequence[TomlTable], assets: Sequence[TomlTable]) -> None:
    """Read the text with another parser: it must say what was meant."""
    read = tomllib.loads(text)
    for key, tables in (("sources", sources), ("assets", assets)):
        for table in tables:
            if table not in read.get(key, ()):
                name = table.get(_NAMED_BY[key])
                raise SettingsError(
                    f"{key}: {name!r} could not be written; change the file by hand"
                )
