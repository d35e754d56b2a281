"""Rows of recorded tables, CSV and Parquet, whatever their columns mean."""

import csv
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from adapters import AdapterError


class TableFileError(AdapterError, ValueError):
    """A file that cannot be read as a table; the text is one line for the user."""


class RowError(AdapterError, ValueError):
    """A row, or a cell of it, that cannot be used; the others can."""


class TableRow(NamedTuple):
    """One row of a table."""

    read: float  # how much of the file has been read, from 0 to 1
    line: int  # where the row stands
    #: By column: text in CSV, numbers in Parquet, where a time stamp is an integer in UTC
    #: microseconds, or text if it has no zone. An error where the row is broken.
    cells: Mapping[str, object] | RowError


@contextmanager
def open_table(path: Path, delimiter: str = ",") -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    """Open a table: Parquet by its suffix, else CSV with a header line.

    Yields the names of the columns, and the rows in order; empty lines are left out. Raises
    `TableFileError` if the file cannot be read, also in the middle of it.
    """
    is_parquet = path.suffix.lower() in (".parquet", ".pq")
    with _parquet(path) if is_parquet else _csv(path, delimiter) as table:
        yield table


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
    columns_max: int | None = None,
    cells_max: int | None = None,
) -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    """Read CSV with a header line, in UTF-8 with or without a byte order mark; as `open_table`."""

    def lines() -> Iterator[str]:
        for raw in binary:
            yield raw.decode("utf-8-sig" if binary.tell() == len(raw) else "utf-8")

    try:
        reader = csv.reader(lines(), delimiter=delimiter)
        header = next((cells for cells in reader if any(cell.strip() for cell in cells)), None)
        if header is None:
            raise TableFileError(f"{name}: line 1: empty file; expected a header line")
        if columns_max is not None and len(header) > columns_max:
            raise TableFileError(
                f"{name}: line {reader.line_num}: {len(header)} columns; expected at most "
                f"{columns_max}: one row for each entry, not one column"
            )
        columns = [cell.strip() for cell in header]

        def rows() -> Iterator[TableRow]:
            read = 0
            for cells in reader:
                read += len(cells)
                if cells_max is not None and read > cells_max:
                    raise TableFileError(
                        f"{name}: line {reader.line_num}: more than {cells_max} cells up to here; "
                        "expected a file in parts"
                    )
                if not any(cell.strip() for cell in cells):
                    continue
                row: Mapping[str, object] | RowError = dict(zip(columns, cells, strict=False))
                if len(cells) != len(columns):
                    row = RowError(f"{len(cells)} cells; expected {len(columns)}")
                yield TableRow(binary.tell() / max(size, 1), reader.line_num, row)

        yield columns, rows()
    except (UnicodeDecodeError, csv.Error) as error:
        raise TableFileError(f"{name}: not CSV in UTF-8 ({error})") from error


@contextmanager
def _parquet(path: Path) -> Iterator[tuple[list[str], Iterator[TableRow]]]:
    pa, parquet = load_pyarrow()
    try:
        file = parquet.ParquetFile(path)
    except OSError as error:
        raise TableFileError(f"{path}: cannot be read ({error.strerror or error})") from error
    except pa.ArrowInvalid as error:
        raise TableFileError(f"{path.name}: not a Parquet file ({error})") from error
    with file:
        total = max(file.metadata.num_rows, 1)

        def rows() -> Iterator[TableRow]:
            line = 1
            for batch in file.iter_batches():
                columns = {
                    name: _plain(pa, column)
                    for name, column in zip(batch.schema.names, batch.columns, strict=True)
                }
                for at in range(batch.num_rows):
                    line += 1
                    cells = {name: column[at] for name, column in columns.items()}
                    yield TableRow(line / total, line, cells)

        yield list(file.schema_arrow.names), rows()


def _plain(pa: Any, column: Any) -> list[object]:
    if pa.types.is_timestamp(column.type):
        if column.type.tz is None:
            # Without a zone no one knows what time it was: such cells are refused row by row.
            return [str(cell) for cell in column.to_pylist()]
        return list(column.cast(pa.timestamp("us", tz="UTC")).cast(pa.int64()).to_pylist())
    return list(column.to_pylist())


def load_pyarrow() -> tuple[Any, Any]:
    """Import pyarrow and its Parquet module. Raises `TableFileError` if it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise TableFileError("Parquet needs pyarrow: pip install 'bearing-twin[parquet]'") from None
    return pyarrow, pyarrow.parquet
