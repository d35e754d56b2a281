"""The store into files: one sample per row with its quality, or one column per channel."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Self

from adapters.tables import load_pyarrow
from service.clock import MINUTE_US, rfc3339
from service.domain.channels import OPERATING_CHANNELS, RING_SENSORS, is_temperature, unit_of
from service.files import replacing
from service.spreadsheets import text_cell
from service.store import Rollup, Store, StoredSample
from service.transfer import mdf
from service.transfer.errors import TransferError
from service.transfer.mdf_writing import write_mdf
from service.transfer.pages import RAW, ExportPosition, as_csv, csv_header, read_pages

PAGE_ROWS = 20_000


def write_csv(file: BinaryIO, store: Store, asset: str, place: ExportPosition) -> int:
    """Write the rows of a query as CSV; returns how many."""
    rows = 0
    file.write(csv_header(place).encode())
    for page in read_pages(store, asset, place, PAGE_ROWS):
        file.write(as_csv(page, place).encode())
        rows += len(page)
    return rows


def write_parquet(file: Any, store: Store, asset: str, place: ExportPosition) -> int:
    """Write the rows of a query as Parquet, with units in the metadata of the schema.

    ``file``: a binary file to write to; it need not be seekable. Returns how many rows. Raises
    `TableFileError` if pyarrow is not installed.
    """
    writer = ParquetPages(file, asset, place, place.channels or store.samples.channels(asset))
    with writer:
        return sum(map(writer.write, read_pages(store, asset, place, PAGE_ROWS)))


class ParquetPages:
    """A Parquet file that is written page by page, with units in the metadata of the schema.

    ``file``: a binary file to write to; it need not be seekable. Raises `TableFileError` if pyarrow
    is not installed.
    """

    def __init__(
        self, file: Any, asset: str, place: ExportPosition, channels: Sequence[str]
    ) -> None:
        self._pa, parquet = load_pyarrow()
        pa = self._pa
        units = {f"unit:{name}": unit_of(name) or "1" for name in channels}
        values = ["value"] if place.resolution == RAW else ["mean", "min", "max"]
        fields = [
            pa.field("time", pa.timestamp("us", tz="UTC"), nullable=False),
            pa.field("channel", pa.string(), nullable=False),
            *(pa.field(name, pa.float64()) for name in values),
            *([] if place.resolution == RAW else [pa.field("count", pa.int64(), nullable=False)]),
            pa.field("quality", pa.uint8(), nullable=False),
            *([pa.field("received", pa.timestamp("us", tz="UTC"))] if place.shows_received else []),
        ]
        facts = {"asset": asset, "resolution": place.resolution, **units}
        self._schema = pa.schema(fields, metadata=facts)
        self._writer = parquet.ParquetWriter(file, self._schema, compression="zstd")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, rows: Sequence[StoredSample | Rollup]) -> int:
        """Write a page; returns how many rows."""
        pa, schema = self._pa, self._schema
        attributes = {"time": "time_us", "received": "received_us", "count": "good"}
        names = [attributes.get(name, name) for name in schema.names]
        columns = [[getattr(row, name) for row in rows] for name in names]
        arrays = [pa.array(column, one.type) for column, one in zip(columns, schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
        return len(rows)

    def close(self) -> None:
        """Write the end of the file."""
        self._writer.close()


def export_file(path: Path, store: Store, asset: str, place: ExportPosition) -> int:
    """Write a query to a file: CSV, Parquet or MDF 4 by its suffix; complete, or not at all.

    Returns how many rows. Raises `TransferError` or `FileError` if the suffix is another or the
    file cannot be written.
    """
    writers = {
        ".csv": write_csv,
        ".parquet": write_parquet,
        ".pq": write_parquet,
        mdf.SUFFIX: write_mdf,
    }
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise TransferError(f"{path}: expected a name that ends in .csv, .parquet or .mf4")
    with replacing(path, binary=True) as file:
        return writer(file, store, asset, place)


def export_minutes(
    path: Path, store: Store, asset: str, channels: Sequence[str], start_us: int, end_us: int
) -> int:
    """Write minute averages with a column per channel, as `identify` and `import` read them.

    Speed, load and ambient are averages over the minute that begins at a row's time, temperatures
    of rings and nodes over the minute around it: a row's operating point holds from its time on,
    its temperatures are those at its time. Only good samples count; a cell without any is empty.
    Returns how many rows. Raises `TransferError` or `FileError` if the name is that of another kind
    of file, or the file cannot be written.
    """
    if path.suffix.lower() == mdf.SUFFIX:
        raise TransferError(
            f"{path}: minutes are written as CSV; expected a name that ends in .csv"
        )
    measured = [name for name in channels if name in OPERATING_CHANNELS or is_temperature(name)]
    inputs = [name for name in measured if name in OPERATING_CHANNELS]
    temperatures = [name for name in measured if name not in OPERATING_CHANNELS]
    over = store.history.minute_averages(asset, inputs, start_us, end_us)
    around = store.history.minute_averages(asset, temperatures, start_us, end_us, -MINUTE_US // 2)
    cells: dict[int, dict[str, float]] = {}
    for table, names, shift_us in ((over, inputs, 0), (around, temperatures, MINUTE_US // 2)):
        for at, minute_us in enumerate(table.minute_us.tolist()):
            row = cells.setdefault(minute_us + shift_us, {})
            for name in names:
                value = float(table.mean[name][at])
                if math.isfinite(value):
                    row[name] = value
    header = [name for name in OPERATING_CHANNELS + RING_SENSORS if name in measured]
    header += sorted(set(measured) - set(header))
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", *(text_cell(name) for name in header)])
        for time_us in sorted(cells):
            values = (cells[time_us].get(name) for name in header)
            writer.writerow(
                [rfc3339(time_us), *("" if value is None else f"{value:.6g}" for value in values)]
            )
    return len(cells)
