"""Rows of recorded tables, CSV and Parquet, whatever their columns mean."""

import csv
import itertools
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, AnyStr, BinaryIO, Final, NamedTuple

from adapters import AdapterError
from adapters.words import one_line, shown

#: A number as files have it; Python's underscores and other scripts' digits make none.
NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
#: Columns of a table.
COLUMNS_MAX: Final = 10_000
#: Bytes of a line of CSV, or characters.
LINE_MAX: Final = 4 * 1024**2
NOT_CLOSED: Final = "a quotation mark that is not closed in its line; expected it closed"
_DECIMAL_COMMA: Final = re.compile(
    r"[+-]?(?:\d{1,3}(?:\.\d{3})+|\d*),\d+(?:[eE][+-]?\d+)?", re.ASCII
)

#: Cells of a Parquet file that are in memory at once, as Python has them.
_CELLS_OF_BATCH: Final = 1_000_000
_ROWS_OF_BATCH: Final = 65_536
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
#: Microseconds of a unit of Parquet's time stamps, and units in one.
_OF_UNIT = {"s": (1_000_000, 1), "ms": (1000, 1), "us": (1, 1), "ns": (1, 1000)}


class TableFileError(AdapterError, ValueError):
    """A file that cannot be read as a table; the text is one line for the user."""


class RowError(AdapterError, ValueError):
    """A row, or a cell of it, that cannot be used; the others can."""


class TimeStamp(int):
    """UTC microseconds of a cell whose column says that it holds times, and of which zone."""


class TableRow(NamedTuple):
    """One row of a table."""

    read: float  # how much of the file has been read, from 0 to 1
    line: int  # where the row stands
    #: By column: text in CSV; numbers in Parquet, `TimeStamp` where the column has times with a
    #: zone, text where it has times without one. An error where the row is broken.
    cells: Mapping[str, object] | RowError


def number_of(text: str, decimal: str = ".") -> float:
    """Read a number of a file; ``decimal`` stands before its fraction.

    Raises `ValueError` where it is none.
    """
    text = text.strip()
    if decimal != ".":
        # A point in such a file separates thousands.
        text = "" if "." in text else text.replace(decimal, ".")
    if NUMBER.fullmatch(text) is None:
        raise ValueError("expected a number")
    return float(text)


def has_decimal_comma(text: str) -> bool:
    """Whether a text is a number with a comma before its fraction."""
    return "," in text and _DECIMAL_COMMA.fullmatch(text.strip()) is not None


@contextmanager
def open_table(path: Path, delimiter: str = ",") -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    """Open a table: Parquet by its suffix, else CSV with a header line.

    Yields the names of the columns, and the rows in order; empty lines are left out. Raises
    `TableFileError` if the file cannot be read, also in the middle of it.
    """
    with _parquet(path) if _is_parquet(path) else _csv(path, delimiter) as table:
        yield table


def units_stated(path: Path) -> dict[str, str]:
    """Units of the columns of a Parquet file, from their metadata; of CSV none.

    Raises `TableFileError` if the file cannot be read.
    """
    if not _is_parquet(path):
        return {}
    with _parquet_file(path) as (_, file):
        return {
            field.name: text.decode("utf-8", "replace")
            for field in file.schema_arrow
            for key, text in (field.metadata or {}).items()
            if key.lower() in (b"unit", b"units")
        }


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in (".parquet", ".pq")


@contextmanager
def _csv(path: Path, delimiter: str) -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    try:
        size = path.stat().st_size
        with path.open("rb") as binary, csv_table(binary, path.name, size, delimiter) as table:
            yield table
    except OSError as error:
        raise TableFileError(f"{path}: cannot be read ({error.strerror})") from error


@contextmanager
def csv_table(
    binary: BinaryIO,
    name: str,
    size: int,
    delimiter: str,
    columns_max: int = COLUMNS_MAX,
    cells_max: int | None = None,
) -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    """Read CSV with a header line, in UTF-8 with or without a byte order mark; as `open_table`.

    Each row stands in one line: a quotation mark that is not closed costs its own line, and not
    all those up to the next one.
    """
    lines = enumerate(bounded_lines(binary, name), 1)
    line, header = next(
        (
            (line, cells)
            for line, raw in lines
            if (cells := _split(name, line, raw, delimiter)) and not _is_empty(cells)
        ),
        (1, None),
    )
    if header is None:
        raise TableFileError(f"{name}: line 1: empty file; expected a header line")
    if isinstance(header, RowError):
        raise TableFileError(f"{name}: line {line}: no header line: {header}")
    if len(header) > columns_max:
        raise TableFileError(
            f"{name}: line {line}: {len(header)} columns; expected at most "
            f"{columns_max}: one row for each entry, not one column"
        )
    columns = [cell.strip() for cell in header]
    broken = next((one for one in columns if "\n" in one or "\r" in one), None)
    if broken is not None:  # a quoted carriage return is no end of a line of the file
        raise TableFileError(
            f"{name}: line {line}: column {shown(broken)}: a line end in its name; "
            "expected a name in one line"
        )

    def rows() -> Iterator[TableRow]:
        read = 0
        for line, raw in lines:
            cells = _split(name, line, raw, delimiter)
            read += 1 if isinstance(cells, RowError) else len(cells)
            if cells_max is not None and read > cells_max:
                raise TableFileError(
                    f"{name}: line {line}: more than {cells_max} cells up to here; "
                    "expected a file in parts"
                )
            if _is_empty(cells):
                continue
            row: Mapping[str, object] | RowError
            if isinstance(cells, RowError):
                row = cells
            elif len(cells) != len(columns):
                row = RowError(f"{len(cells)} cells; expected {len(columns)}")
            else:
                row = dict(zip(columns, cells, strict=True))
            yield TableRow(binary.tell() / max(size, 1), line, row)

    yield columns, rows()


def bounded_lines(file: IO[AnyStr], name: str) -> Iterator[AnyStr]:
    """Read lines, each with its end. Raises `TableFileError` at one that is too long."""
    for number in itertools.count(1):
        line = file.readline(LINE_MAX + 1)
        if not line:
            return
        if len(line) > LINE_MAX:
            raise TableFileError(
                f"{name}: line {number}: more than {LINE_MAX // 1024**2} MiB; expected at most so "
                "many"
            )
        yield line


def why_not_csv(error: csv.Error) -> str:
    """Say why a line cannot be split into cells."""
    if "field limit" in str(error):
        most = csv.field_size_limit()
        return f"a cell of more than {most} characters; expected at most so many"
    return f"not CSV ({error})"


def _split(name: str, line: int, raw: bytes, delimiter: str) -> list[str] | RowError:
    """Split a line into its cells. Raises `TableFileError` where it is not UTF-8."""
    if line == 1 and raw.startswith(_UTF_16):
        raise TableFileError(f"{name}: in UTF-16; expected CSV in UTF-8")
    try:
        text = raw.decode("utf-8-sig" if line == 1 else "utf-8").rstrip("\r\n")
    except UnicodeDecodeError as error:
        byte = raw[error.start]
        raise TableFileError(
            f"{name}: line {line}: not CSV in UTF-8 (byte 0x{byte:02x} at {error.start + 1})"
        ) from error
    try:
        return next(csv.reader((text,), delimiter=delimiter, strict=True), [])
    except csv.Error as error:
        if "unexpected end of data" in str(error):
            return RowError(NOT_CLOSED)
        return RowError(why_not_csv(error))


def _is_empty(cells: list[str] | RowError) -> bool:
    return not isinstance(cells, RowError) and not any(cell.strip() for cell in cells)


@contextmanager
def _parquet_file(path: Path) -> Iterator[tuple[Any, Any]]:
    pa, parquet = load_pyarrow()
    try:
        file = parquet.ParquetFile(path)
    except OSError as error:
        raise TableFileError(
            f"{path}: cannot be read ({error.strerror or one_line(error)})"
        ) from error
    except pa.ArrowException as error:
        raise TableFileError(f"{path.name}: not a Parquet file ({one_line(error)})") from error
    except UnicodeDecodeError as error:
        raise TableFileError(
            f"{path.name}: damaged Parquet file (the name of a column is not UTF-8)"
        ) from error
    with file:
        yield pa, file


@contextmanager
def _parquet(path: Path) -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    with _parquet_file(path) as (pa, file):
        total = max(file.metadata.num_rows, 1)
        names = list(file.schema_arrow.names)
        if len(names) > COLUMNS_MAX:
            raise TableFileError(
                f"{path.name}: {len(names)} columns; expected at most {COLUMNS_MAX}"
            )

        def rows() -> Iterator[TableRow]:
            line = 1
            rows_at_once = max(1, min(_ROWS_OF_BATCH, _CELLS_OF_BATCH // max(len(names), 1)))
            batches = file.iter_batches(rows_at_once)
            while True:
                try:
                    batch = next(batches, None)
                    if batch is None:
                        return
                    columns = {
                        name: _plain(pa, column)
                        for name, column in zip(batch.schema.names, batch.columns, strict=True)
                    }
                except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
                    raise TableFileError(
                        f"{path.name}: damaged Parquet file, after row {line} ({one_line(error)})"
                    ) from error
                for at in range(batch.num_rows):
                    line += 1
                    cells = {name: column[at] for name, column in columns.items()}
                    yield TableRow(line / total, line, cells)

        yield names, rows()


def _plain(pa: Any, column: Any) -> list[object]:
    if pa.types.is_timestamp(column.type):
        if column.type.tz is None:
            # Without a zone no one knows what time it was: such cells are refused row by row.
            return list(column.cast(pa.string()).to_pylist())
        per_unit, per_us = _OF_UNIT[column.type.unit]
        return [
            None if count is None else TimeStamp(count * per_unit // per_us)
            for count in column.cast(pa.int64()).to_pylist()
        ]
    try:
        return list(column.to_pylist())
    except (ValueError, OverflowError):
        if not pa.types.is_temporal(column.type):
            raise
        return list(column.cast(pa.string()).to_pylist())  # a date or a time that cannot be


def load_pyarrow() -> tuple[Any, Any]:
    """Import pyarrow and its Parquet module. Raises `TableFileError` if it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise TableFileError("Parquet needs pyarrow: pip install 'bearing-twin[parquet]'") from None
    return pyarrow, pyarrow.parquet
