"""Samples of recorded tables."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from adapters.configuration import ConfigurationError
from adapters.samples import Quality
from adapters.tables import (
    RowError,
    TableFileError,
    TableRow,
    TimeStamp,
    number_of,
    open_table,
)
from adapters.words import shown

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_EXPECTED = {"time": "a time with an offset", "time_s": "seconds"}

Cells = Mapping[str, tuple[float, int]]
"""Value and quality by column; empty cells are not there."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A recorded table.

    - ``columns``: those with values; None for a table with one sample per row, which names them
      itself.
    - ``is_dated``: whether its times count from the epoch; else, those of ``time_s``, from zero.
    - ``rows``: time in microseconds and cells; an error, with its line, where a row is broken.
    """

    columns: list[str] | None
    is_dated: bool
    rows: Iterator[tuple[int, Cells] | RowError]


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a recorded table.

    Raises `ConfigurationError` if the file cannot be read, also in the middle of it, or has no
    column of times.
    """
    try:
        with open_table(path) as (names, rows):
            yield _timed(path, names, rows)
    except TableFileError as error:
        raise ConfigurationError(f"file {str(path)!r}: {error}") from None


def _timed(path: Path, names: list[str], rows: Iterator[TableRow]) -> Recording:
    clocks = [name for name in ("time", "time_s") if name in names]
    if len(clocks) != 1:
        raise ConfigurationError(
            f"file {str(path)!r}: expected one column time or time_s, found "
            f"{', '.join(names) or 'none'}"
        )
    clock = clocks[0]
    is_long = "channel" in names and "value" in names
    read = _sample if is_long else _cells

    def whole() -> Iterator[TableRow]:
        try:
            yield from rows
        except TableFileError as error:
            raise ConfigurationError(f"file {str(path)!r}: {error}") from None

    def timed() -> Iterator[tuple[int, Cells] | RowError]:
        for row in whole():
            if isinstance(row.cells, RowError):
                yield RowError(f"line {row.line}: {row.cells}")
                continue
            try:
                time_us = _time_us(row.cells[clock], clock)
            except (ValueError, OverflowError):
                cell = shown(row.cells[clock])
                yield RowError(f"line {row.line}: {clock} = {cell}: expected {_EXPECTED[clock]}")
                continue
            yield time_us, read(row.cells, clock)

    columns = None if is_long else [name for name in names if name != clock]
    return Recording(columns, clock == "time", timed())


def _time_us(cell: Any, clock: str) -> int:
    if clock == "time_s":
        return round(number_of(str(cell)) * 1e6)
    if isinstance(cell, TimeStamp):
        return int(cell)
    if not isinstance(cell, str):
        raise ValueError("no time")
    moment = datetime.fromisoformat(cell.strip())
    if moment.tzinfo is None:
        raise ValueError("a time without an offset")
    return (moment - _EPOCH) // timedelta(microseconds=1)


def _cells(row: Mapping[str, Any], clock: str) -> Cells:
    found = {}
    for name, cell in row.items():
        if name == clock or cell is None or (isinstance(cell, str) and not cell.strip()):
            continue
        value = _number(cell)
        good = math.isfinite(value)
        found[name] = (value, int(Quality.GOOD if good else Quality.SENSOR_FAILURE))
    return found


def _sample(row: Mapping[str, Any], _clock: str) -> Cells:
    value = _number(row["value"])
    quality = _number(row.get("quality"))
    if not (0 <= quality <= 255):
        quality = Quality.GOOD if math.isfinite(value) else Quality.BAD
    if not math.isfinite(value) and quality >= Quality.UNCERTAIN:
        quality = Quality.BAD
    return {str(row["channel"]).strip(): (value, int(quality))}


def _number(cell: Any) -> float:
    if isinstance(cell, bool):
        return float(cell)
    try:
        value = math.nan if isinstance(cell, TimeStamp) else number_of(str(cell))
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
