"""Lists of assets, as CSV and as JSON: read, judged row by row, and written."""

import csv
import io
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from adapters.configuration import first_repeated, listed
from adapters.tables import RowError, TableFileError, csv_table
from adapters.words import shown, shown_name
from service.domain.errors import BearingTwinError
from service.domain.json_values import read_json_text
from service.domain.upload_limits import COLUMNS_MAX, too_large
from service.site.asset_tables import check_assets, key_line
from service.site.configuration import SettingsError, TomlTable
from service.site.settings import Settings
from service.site.templates import VALUES
from service.spreadsheets import cell, text_of

_ID: Final = "id"
#: Columns of CSV that are keys of an asset and always texts; every other one is a value.
TEXT_COLUMNS: Final = ("template", "name", "group", "family", "bearing", "model", "network")
# Neither a number of parts such as 007 nor a word such as nan is a number.
_WHOLE = re.compile(r"-?(?:0|[1-9]\d{0,17})")
_DECIMAL = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d{1,2})?")


class AssetListError(BearingTwinError, ValueError):
    """A list that cannot be read as a whole; the text is one line for the user."""


@dataclass(frozen=True, slots=True)
class ListedAsset:
    """An asset of a list.

    - ``entry``: its place among the assets of the list, from 0.
    - ``row``: for people: line of the CSV file, or the place from 1 in JSON.
    - ``id``: None where there is none that could be one.
    """

    entry: int
    row: int
    id: str | None
    table: TomlTable


@dataclass(frozen=True, slots=True)
class WrongRow:
    """An asset of a list that cannot be taken; `lines` say what is wrong, each from its key on."""

    entry: int
    row: int
    id: str | None
    lines: tuple[str, ...]


@dataclass(slots=True)
class AssetRows:
    """What a list holds: assets by id, and the rows that are none."""

    assets: dict[str, ListedAsset] = field(default_factory=dict)
    wrong: list[WrongRow] = field(default_factory=list)

    @classmethod
    def of(cls, rows: Sequence[ListedAsset], wrong: Sequence[WrongRow] = ()) -> "AssetRows":
        """Sort rows by id. Where several have one id none is taken."""
        found = cls(wrong=list(wrong))
        by_id: dict[str, list[ListedAsset]] = {}
        for one in rows:
            if one.id is None:
                line = "id: missing; expected the id of an asset"
                found.wrong.append(WrongRow(one.entry, one.row, None, (line,)))
            else:
                by_id.setdefault(one.id, []).append(one)
        for name, same in by_id.items():
            if len(same) == 1:
                found.assets[name] = same[0]
                continue
            places = ", ".join(str(one.row) for one in same)
            line = f"id = {shown(name)}: rows {places} have it; expected unique"
            found.wrong += [WrongRow(one.entry, one.row, name, (line,)) for one in same]
        return found


@dataclass(frozen=True, slots=True)
class JudgedList:
    """What a list would change."""

    created: dict[str, TomlTable]
    changed: dict[str, TomlTable]
    unchanged: int
    wrong: list[WrongRow]

    @property
    def changes(self) -> dict[str, TomlTable]:
        """Everything that is to be written."""
        return self.created | self.changed

    @property
    def summary(self) -> str:
        """What is changed, in one line for the audit trail."""
        counts = f"created: {len(self.created)}; changed: {len(self.changed)}"
        return f"{counts}; assets: {listed(self.changes)}"


def judge_list(
    settings: Settings,
    rows: AssetRows,
    present: Mapping[str, TomlTable | None],
    seconds: float | None = None,
) -> JudgedList:
    """Check each asset of a list and compare it with those that there are.

    ``seconds``: of processor time that the check may take; None: any. Raises `UploadTooLargeError`
    if it takes longer.
    """
    tables = {name: one.table for name, one in rows.assets.items()}
    right, errors = check_assets(settings, tables, seconds)
    wrong = list(rows.wrong)
    for name, checked in list(right.items()):
        if lines_in_names := checked.section.lines_in_names:
            errors[name] = tuple(lines_in_names)
            del right[name]
    for name, lines in errors.items():
        one = rows.assets[name]
        wrong.append(WrongRow(one.entry, one.row, name, tuple(key_line(name, x) for x in lines)))
    created = {name: tables[name] for name in right if name not in present}
    changed = {
        name: tables[name] for name in right if name in present and tables[name] != present[name]
    }
    unchanged = len(right) - len(created) - len(changed)
    return JudgedList(created, changed, unchanged, sorted(wrong, key=lambda row: row.entry))


def judge_removal(
    settings: Settings, ids: Sequence[str], present: Collection[str]
) -> list[WrongRow]:
    """Say which assets of a list of ids cannot be removed, and why."""
    in_file = {one.id for one in settings.assets}
    return [
        WrongRow(
            entry,
            entry + 1,
            name,
            (
                "stands in the configuration file; expected a change there"
                if name in in_file
                else "no such asset is provisioned",
            ),
        )
        for entry, name in enumerate(ids)
        if name not in present
    ]


def read_csv(content: bytes, cells_max: int | None = None) -> AssetRows:
    """Read a list of assets as CSV.

    ``content``: UTF-8, with commas or semicolons. The header has ``id`` and what else is given;
    empty cells are left out, and what is no key of an asset is a value of its template. Raises
    `AssetListError` if it is not CSV, or the header is wrong.
    """
    header = content.lstrip().partition(b"\n")[0]
    delimiter = ";" if b";" in header else ","
    rows: list[ListedAsset] = []
    wrong: list[WrongRow] = []
    try:
        with csv_table(
            io.BytesIO(content), "assets", len(content), delimiter, COLUMNS_MAX, cells_max
        ) as (columns, table):
            _check_header(columns)
            for entry, (_, line, cells) in enumerate(table):
                if isinstance(cells, RowError):
                    wrong.append(WrongRow(entry, line, None, (str(cells),)))
                else:
                    rows.append(_from_cells(entry, line, cells))
    except TableFileError as error:
        raise AssetListError(str(error)) from error
    return AssetRows.of(rows, wrong)


def _check_header(columns: Sequence[str]) -> None:
    if not all(columns):
        raise AssetListError("line 1: a column without a name; expected a name for each")
    twice = first_repeated(columns)
    if twice is not None:
        raise AssetListError(f"line 1: column {shown(twice)} occurs twice; expected once")
    if _ID not in columns:
        raise AssetListError(
            f"line 1: missing column {_ID!r}; expected it, then any of {', '.join(TEXT_COLUMNS)} "
            "and the values of the templates"
        )


def _from_cells(entry: int, line: int, cells: Mapping[str, object]) -> ListedAsset:
    given = {name: text_of(str(text).strip()) for name, text in cells.items() if str(text).strip()}
    table: TomlTable = {name: given[name] for name in TEXT_COLUMNS if name in given}
    others = given.keys() - {_ID, *TEXT_COLUMNS}
    values = {name: _value(given[name]) for name in cells if name in others}
    return ListedAsset(entry, line, given.get(_ID), table | ({VALUES: values} if values else {}))


def _value(text: str) -> int | float | str:
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if _DECIMAL.fullmatch(text) else text


def read_json(content: bytes) -> AssetRows:
    """Read a list of assets as JSON: ``{"assets": [{"id": "axle-1", ...}]}``.

    Raises `AssetListError` if it is not such a document.
    """
    try:
        document = read_json_text(content)
    except ValueError as error:
        raise AssetListError(f"not valid JSON: {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get("assets"), list):
        raise AssetListError('expected {"assets": [{"id": …, …}, …]}')
    unknown = sorted(document.keys() - {"assets"})
    if unknown:
        raise AssetListError(f"{shown_name(unknown[0])}: unknown key; expected 'assets' alone")
    rows: list[ListedAsset] = []
    wrong: list[WrongRow] = []
    for entry, one in enumerate(document["assets"]):
        if isinstance(one, dict) and isinstance(one.get(_ID, ""), str):
            table = {name: part for name, part in one.items() if name != _ID}
            large = too_large(table)
            if large is not None:
                wrong.append(WrongRow(entry, entry + 1, one.get(_ID) or None, (large,)))
                continue
            rows.append(ListedAsset(entry, entry + 1, one.get(_ID) or None, table))
        elif isinstance(one, dict):
            line = f"id = {shown(one[_ID])}: expected a text"
            wrong.append(WrongRow(entry, entry + 1, None, (line,)))
        else:
            wrong.append(WrongRow(entry, entry + 1, None, ("expected a table with an id",)))
    return AssetRows.of(rows, wrong)


def as_json(assets: Mapping[str, TomlTable]) -> str:
    """Write assets as `read_json` reads them."""
    entries = [{_ID: name} | table for name, table in assets.items()]
    return json.dumps({"assets": entries}, indent=1, ensure_ascii=False) + "\n"


def as_csv(assets: Mapping[str, TomlTable]) -> str:
    """Write assets as `read_csv` reads them.

    Raises `SettingsError` if an asset has more than CSV can say, such as channels of its own.
    """
    named = {name for table in assets.values() for name in table.get(VALUES, {})}
    columns = (
        _ID,
        *(name for name in TEXT_COLUMNS if any(name in table for table in assets.values())),
        *sorted(named),
    )
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(columns)
    for name, table in assets.items():
        given: dict[str, Any] = {_ID: name} | table | table.get(VALUES, {})
        writer.writerow([cell(given.get(column, "")) for column in columns])
    text = out.getvalue()
    again = read_csv(text.encode()).assets if assets else {}
    lost = list(_lost(assets, again))
    if lost:
        raise SettingsError(*lost)
    return text


def _lost(assets: Mapping[str, TomlTable], again: Mapping[str, ListedAsset]) -> Iterator[str]:
    for name, table in assets.items():
        back = again[name].table if name in again else {}
        for key in table:
            if back.get(key) != table[key]:
                yield f"{name}.{key}: CSV cannot hold it; expected a file that ends in .json"
