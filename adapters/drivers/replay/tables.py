"""Samples of recorded tables."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from adapters.configuration import ConfigurationError
from adapters.samples import Quality
from adapters.tables import RowError, TableFileError, TableRow, open_table

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Cells = Mapping[str, tuple[float, int]]
"""Value and quality by column; empty cells are not there."""


@contextmanager
def open_recording(path: Path) -> Iterator[tuple[list[str] | None, Iterator[tuple[int, Cells]]]]:
    """Open a recorded table.

    Yields the columns with values (None for a table with one sample per row, which names them
    itself), and the rows: time in microseconds (of the epoch, or from zero for ``time_s``) and
    cells. A row whose time cannot be read, or which is broken, is left out. Raises
    `ConfigurationError` if the file cannot be read or has no column of times.
    """
    try:
        with open_table(path) as (names, rows):
            yield _timed(path, names, rows)
    except TableFileError as error:
        raise ConfigurationError(f"file {str(path)!r}: {error}") from None


def _timed(
    path: Path, names: list[str], rows: Iterator[TableRow]
) -> tuple[list[str] | None, Iterator[tuple[int, Cells]]]:
    clocks = [name for name in ("time", "time_s") if name in names]
    if len(clocks) != 1:
        raise ConfigurationError(
            f"file {str(path)!r}: expected one column time or time_s, found "
            f"{', '.join(names) or 'none'}"
        )
    clock = clocks[0]
    is_long = "channel" in names and "value" in names
    read = _sample if is_long else _cells

    def timed() -> Iterator[tuple[int, Cells]]:
        for row in rows:
            if isinstance(row.cells, RowError):
                continue
            try:
                time_us = _time_us(row.cells[clock], clock)
            except (ValueError, OverflowError, TypeError):
                continue
            yield time_us, read(row.cells, clock)

    return None if is_long else [name for name in names if name != clock], timed()


def _time_us(cell: Any, clock: str) -> int:
    if clock == "time_s":
        return round(float(cell) * 1e6)
    if isinstance(cell, int):  # a time stamp of Parquet
        return cell
    moment = datetime.fromisoformat(str(cell).strip())
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
    try:
        value = float(cell)
    except (TypeError, ValueError):
        return math.nan
    return value if math.isfinite(value) else math.nan
