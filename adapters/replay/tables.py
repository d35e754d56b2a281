"""Rows of recorded tables."""

import csv
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from adapters.configuration import ConfigurationError
from adapters.samples import Quality

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Cells = Mapping[str, tuple[float, int]]
"""Value and quality by column; empty cells are not there."""


@contextmanager
def open_table(path: Path) -> Iterator[tuple[list[str] | None, Iterator[tuple[int, Cells]]]]:
    """Open a table.

    Yields
    ------
    columns : list of str or None
        Columns with values; None for a table with one sample per row, which names them itself.
    rows : iterator
        Time in microseconds (of the epoch, or from zero for ``time_s``) and cells. A row whose
        time cannot be read is left out.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or has no column of times.
    """
    with (_csv if path.suffix.lower() == ".csv" else _parquet)(path) as (names, rows):
        clocks = [name for name in ("time", "time_s") if name in names]
        if len(clocks) != 1:
            raise ConfigurationError(
                f"file {str(path)!r}: expected one column time or time_s, found "
                f"{', '.join(names) or 'none'}"
            )
        clock = clocks[0]
        if "channel" in names and "value" in names:
            yield None, _timed(rows, clock, _sample)
        else:
            yield [name for name in names if name != clock], _timed(rows, clock, _cells)


def _timed(
    rows: Iterator[Mapping[str, Any]], clock: str, cells: Any
) -> Iterator[tuple[int, Cells]]:
    for row in rows:
        try:
            time_us = _time_us(row[clock], clock)
        except (ValueError, OverflowError, TypeError):
            continue
        yield time_us, cells(row, clock)


def _time_us(cell: Any, clock: str) -> int:
    if clock == "time_s":
        return round(float(cell) * 1e6)
    moment = cell if isinstance(cell, datetime) else datetime.fromisoformat(str(cell).strip())
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


@contextmanager
def _csv(path: Path) -> Iterator[tuple[list[str], Iterator[Mapping[str, Any]]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            names = [name.strip() for name in next(reader, [])]
            yield names, (dict(zip(names, cells, strict=False)) for cells in reader if any(cells))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(f"file {str(path)!r} cannot be read: {reason}") from None


@contextmanager
def _parquet(path: Path) -> Iterator[tuple[list[str], Iterator[Mapping[str, Any]]]]:
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        raise ConfigurationError(
            f"file {str(path)!r}: Parquet needs pyarrow: pip install 'bearing-twin[parquet]'"
        ) from None
    try:
        file = parquet.ParquetFile(path)
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise ConfigurationError(f"file {str(path)!r} cannot be read: {error}") from None
    with file:
        yield (
            list(file.schema_arrow.names),
            (row for batch in file.iter_batches() for row in batch.to_pylist()),
        )
