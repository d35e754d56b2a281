"""The rationalisation sheet: every alarm that assets can have, as CSV and as JSON."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from adapters.configuration import first_repeated, listed
from adapters.tables import RowError, TableFileError, csv_table, has_decimal_comma
from adapters.words import shown, shown_name
from service.domain.alarm_guidance import AlarmName
from service.domain.errors import BearingTwinError
from service.domain.json_values import read_json_text
from service.domain.texts import EXPECTED, is_one_line
from service.domain.upload_limits import COLUMNS_MAX, too_large
from service.features.alarm_settings.settings_changes import Mistake, WantedRow
from service.site.alarm_overlay import FIELDS, AlarmEntry
from service.spreadsheets import text_cell, text_of

#: What identifies an alarm.
NAMES: Final = ("asset", "tag", "kind", "level")
#: What the twin adds: read-only.
OF_THE_TWIN: Final = ("time_to_respond_p05_s", "time_to_respond_p50_s", "time_basis")
#: In this order in CSV. ISA-18.2 and IEC 62682 say which information is documented, not the names.
COLUMNS: Final = (
    *NAMES,
    "description",
    "alarm_type",
    "setpoint",
    "unit",
    "deadband",
    "on_delay_s",
    "off_delay_s",
    "priority",
    "class",
    "latched",
    "re_alarm_s",
    "enabled",
    "probable_causes",
    "consequence_of_inaction",
    "operator_action",
    "allowable_response_time_s",
    *OF_THE_TWIN,
    "severity_of_consequence",
    "identification_method",
    "suppression",
    "status",
    "rationalised_by",
    "rationalised_at",
    "remarks",
    "changed",
    "origin",
)
_NUMBERS: Final = (
    "setpoint",
    "deadband",
    "on_delay_s",
    "off_delay_s",
    "re_alarm_s",
    "allowable_response_time_s",
)
_ROWS, _COMMENT = "rows", "comment"


class AlarmSheetError(BearingTwinError, ValueError):
    """A sheet that cannot be read as a whole; the text is one line for the user."""


def cells_of(row: AlarmEntry, of_the_twin: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Give the cells of a row by column; None where there is nothing."""
    kind, channel, level = row.name
    return {
        "asset": row.asset,
        "tag": channel,
        "kind": kind,
        "level": level,
        "description": row.description,
        "alarm_type": row.alarm_type,
        "unit": row.unit,
        "suppression": row.suppression,
        "changed": " ".join(row.changed),
        "origin": row.origin,
        **row.values,
        **(of_the_twin or {}),
    }


def as_csv(sheet: Iterable[Mapping[str, Any]]) -> str:
    """Write a sheet as `read_csv` reads it, for spreadsheets: with a byte order mark."""
    out = io.StringIO()
    out.write("\ufeff")
    writer = csv.writer(out)
    writer.writerow(COLUMNS)
    for cells in sheet:
        writer.writerow([_cell(cells.get(column)) for column in COLUMNS])
    return out.getvalue()


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return text_cell(value) if isinstance(value, str) else value


def read_csv(content: bytes, cells_max: int | None = None) -> tuple[list[WantedRow], list[Mistake]]:
    """Read a sheet as CSV, in UTF-8, with commas, or with semicolons and decimal commas.

    An empty cell asks for what the configuration has; a column that is not there changes nothing.
    What is not settable (description, times of the twin …) is not looked at, but for the unit.
    Raises `AlarmSheetError` if it is not CSV, or the header is wrong.
    """
    header = content.lstrip().partition(b"\n")[0]
    delimiter = ";" if header.count(b";") > header.count(b",") else ","
    rows: list[WantedRow] = []
    mistakes: list[Mistake] = []
    try:
        with csv_table(
            io.BytesIO(content), "sheet", len(content), delimiter, COLUMNS_MAX, cells_max
        ) as (columns, table):
            _check_header(columns)
            for _, line, cells in table:
                if isinstance(cells, RowError):
                    mistakes.append(Mistake(line, "row", str(cells)))
                    continue
                texts = {name: text_of(str(cell).strip()) for name, cell in cells.items()}
                if delimiter == ";":
                    texts |= {key: _with_point(texts[key]) for key in _NUMBERS if key in texts}
                rows.append(_wanted(line, texts))
    except TableFileError as error:
        raise AlarmSheetError(str(error)) from error
    return rows, mistakes


def _with_point(text: str) -> str:
    """Read a decimal comma, with which a spreadsheet saves where it saves semicolons too."""
    return text.replace(",", ".") if has_decimal_comma(text) else text


def _check_header(columns: Sequence[str]) -> None:
    for name in columns:
        if name not in COLUMNS:
            raise AlarmSheetError(
                f"line 1: unknown column {shown(name)}; expected some of {', '.join(COLUMNS)}"
            )
    twice = first_repeated(columns)
    if twice is not None:
        raise AlarmSheetError(f"line 1: column {shown(twice)} occurs twice; expected once")
    missing = [name for name in NAMES if name not in columns]
    if missing:
        raise AlarmSheetError(f"line 1: missing column {listed(missing)}; expected it")


def read_json(content: bytes) -> tuple[list[WantedRow], list[Mistake], str]:
    """Read a sheet as JSON: ``{"rows": [{"asset": …, "tag": …, "kind": …, …}], "comment": …}``.

    Returns the rows, what is wrong with others, and the comment; empty where there is none. Raises
    `AlarmSheetError` if it is not such a document.
    """
    try:
        document = read_json_text(content)
    except ValueError as error:
        raise AlarmSheetError(f"not valid JSON: {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get(_ROWS), list):
        raise AlarmSheetError('expected {"rows": [{"asset": …, "tag": …, "kind": …}, …]}')
    others = [shown_name(name) for name in document if name not in (_ROWS, _COMMENT)]
    if others:
        raise AlarmSheetError(f"{others[0]}: unknown key; expected {_ROWS!r} and {_COMMENT!r}")
    comment = document.get(_COMMENT, "")
    if not isinstance(comment, str) or not is_one_line(comment):
        raise AlarmSheetError(f"{_COMMENT}: {EXPECTED}")
    rows: list[WantedRow] = []
    mistakes: list[Mistake] = []
    for place, cells in enumerate(document[_ROWS], 1):
        if not isinstance(cells, dict):
            mistakes.append(Mistake(place, "row", "expected a table with asset, tag and kind"))
            continue
        large = too_large(cells)
        if large is not None:
            mistakes.append(Mistake(place, "row", large))
            continue
        unknown = [shown_name(name) for name in cells if name not in COLUMNS]
        names = {name: cells.get(name, "") for name in NAMES}
        wrong = [name for name, text in names.items() if not isinstance(text, str)]
        mistakes += (Mistake(place, name, "unknown key") for name in unknown)
        mistakes += (Mistake(place, name, "expected a text") for name in wrong)
        if not unknown and not wrong:
            rows.append(_wanted(place, cells | names))
    return rows, mistakes, comment


def _wanted(place: int, cells: Mapping[str, Any]) -> WantedRow:
    name: AlarmName = (str(cells["kind"]), str(cells["tag"]), str(cells["level"]))
    unit = cells.get("unit")
    return WantedRow(
        place,
        str(cells["asset"]),
        name,
        {key: cells[key] for key in FIELDS if key in cells},
        None if unit is None else str(unit),
    )


def as_json(sheet: Iterable[Mapping[str, Any]]) -> str:
    """Write a sheet as `read_json` reads it."""
    return json.dumps({_ROWS: list(sheet)}, indent=1, ensure_ascii=False) + "\n"
