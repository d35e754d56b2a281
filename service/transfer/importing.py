"""Files into the store: CSV, Parquet, MDF 4; every bad row named, sending again does no harm."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from adapters.samples import Quality, Sample
from adapters.tables import RowError, open_table
from service.clock import from_rfc3339
from service.store import Store
from service.transfer import mdf
from service.transfer.errors import TransferError
from service.transfer.mapping import Layout, layout_of, read_mapping, time_reader

BATCH_SAMPLES = 20_000
#: This many bad rows are reported one by one; all are counted.
REJECTED_TOLD = 100

# What no machine shows: sentinels and shifted columns must not pass as measurements.
_RANGES = {"_c": (-100.0, 500.0), "_rpm": (-1e5, 1e5), "_n": (-1e3, 1e7)}

Row = Mapping[str, object]
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Rejected:
    """A row, or a cell of it, that was not taken."""

    line: int
    detail: str


@dataclass(slots=True)
class ImportReport:
    """What became of a file.

    Attributes
    ----------
    rows, samples
        Read from it.
    stored, duplicates
        Of the samples; both stay 0 in a dry run.
    too_old
        Samples from before the time from which the store keeps raw samples; not stored.
    rejected
        How many rows or cells were not taken; `first_rejected` tells of the first of them.
    """

    rows: int = 0
    samples: int = 0
    stored: int = 0
    duplicates: int = 0
    too_old: int = 0
    rejected: int = 0
    first_rejected: list[Rejected] = field(default_factory=list)

    def reject(self, line: int, detail: str) -> None:
        """Count a row or cell that is not taken."""
        self.rejected += 1
        if len(self.first_rejected) < REJECTED_TOLD:
            self.first_rejected.append(Rejected(line, detail))


def import_file(
    path: Path,
    asset: str,
    store: Store | None,
    *,
    mapping: Path | None = None,
    start_us: int | None = None,
    own_channels: Sequence[str] | None = None,
    now_us: int,
    progress: Progress,
) -> ImportReport:
    """Read a file and store its samples.

    Parameters
    ----------
    path
        A CSV file, or a Parquet or MDF 4 file by its suffix.
    asset
        Whose channels they are.
    store
        Where they go; None only reads, as a dry run.
    mapping
        Mapping file, if the columns do not carry the names of channels.
    start_us
        What a column of seconds counts from, UTC microseconds; of an MDF file the time of 0 s.
    own_channels
        Channels of an asset with a network of its own; None for a bearing.
    now_us
        Received time of the samples of which the file does not say it, UTC microseconds.
    progress
        Told how much of the file has been read, from 0 to 1.

    Raises
    ------
    TableFileError, TransferError
        If the file cannot be used as a whole; nothing is stored then.
    StoreUnavailableError
        If the store goes away; what was stored stays, and importing again completes it.
    """
    plan = None if mapping is None else read_mapping(mapping)
    report = ImportReport()
    if path.suffix.lower() == mdf.SUFFIX:
        with mdf.open_mdf(path, plan, own_channels, start_us) as found:
            for one in found:
                _take_channel(one, asset, store, now_us, report)
                progress(one.read)
        if report.rows == 0:
            raise TransferError(f"{path.name}: no samples; expected at least one")
        return report
    delimiter = "," if plan is None else plan.delimiter
    with open_table(path, delimiter) as (columns, rows):
        layout = layout_of(path.name, columns, plan, own_channels)
        if layout.seconds and start_us is None:
            raise TransferError(
                f"{path.name}: {layout.time} counts seconds; expected --start with the time of 0 s"
            )
        batch: list[Sample] = []
        for read, line, row in rows:
            report.rows += 1
            batch += _samples(row, line, layout, asset, start_us, now_us, report)
            if len(batch) >= BATCH_SAMPLES:
                _store(store, batch, report)
                batch = []
                progress(read)
        _store(store, batch, report)
    if report.rows == 0:
        raise TransferError(f"{path.name}: line 2: no rows; expected at least one")
    progress(1.0)
    return report


def _take_channel(
    one: mdf.MdfChannel, asset: str, store: Store | None, now_us: int, report: ImportReport
) -> None:
    """Store a channel of an MDF file; lines are the numbers of its samples."""
    rows = zip(one.time_us.tolist(), one.values.tolist(), one.quality.tolist(), strict=True)
    batch: list[Sample] = []
    for number, (time_us, value, quality) in enumerate(rows, 1):
        report.rows += 1
        try:
            if not 0 <= time_us < 2**62:
                raise RowError(f"{one.channel}: expected a time after 1970")
            if not math.isnan(value):
                _check_range(one.channel, value)
        except RowError as error:
            report.reject(number, str(error))
            continue
        batch.append(Sample(asset, one.channel, time_us, value, quality, now_us))
        if len(batch) >= BATCH_SAMPLES:
            _store(store, batch, report)
            batch = []
    _store(store, batch, report)


def _store(store: Store | None, samples: Sequence[Sample], report: ImportReport) -> None:
    report.samples += len(samples)
    if store is not None:
        counts = store.samples.write(samples)
        report.stored += counts.stored
        report.duplicates += counts.duplicates
        report.too_old += len(samples) - counts.stored - counts.duplicates


def _samples(
    row: Row | RowError,
    line: int,
    layout: Layout,
    asset: str,
    start_us: int | None,
    now_us: int,
    report: ImportReport,
) -> Iterator[Sample]:
    try:
        if isinstance(row, RowError):
            raise row
        time_us = time_reader(layout, start_us)(row[layout.time])
        if not 0 <= time_us < 2**62:
            raise RowError(f"{layout.time}: {row[layout.time]!r}: expected a time after 1970")
        if not layout.channels:
            yield _long(row, asset, time_us, now_us)
            return
    except RowError as error:
        report.reject(line, str(error))
        return
    for channel, source in layout.channels.items():
        try:
            value = _number(source.column, row[source.column])
            if value is None:
                continue
            value = value * source.scale + source.offset
            _check_range(channel, value)
        except RowError as error:
            report.reject(line, str(error))
        else:
            yield Sample(asset, channel, time_us, value, Quality.GOOD, now_us)


def _long(row: Row, asset: str, time_us: int, now_us: int) -> Sample:
    channel = str(row["channel"] or "").strip()
    if not channel:
        raise RowError("channel is empty; expected the name of a channel")
    value = _number("value", row["value"])
    quality = _number("quality", row.get("quality"))
    if quality is None:
        quality = Quality.GOOD if value is not None else Quality.BAD
    if not (0 <= quality <= 255 and quality == int(quality)):
        raise RowError(f"quality = {quality:g}: expected a whole number from 0 to 255")
    if value is None:
        value = math.nan
    else:
        _check_range(channel, value)
    received_us = _received_us(row.get("received"), now_us)
    return Sample(asset, channel, time_us, value, int(quality), received_us)


def _received_us(cell: object, now_us: int) -> int:
    """When a sample was received; where the cell is empty: now."""
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return now_us
    try:
        # A Parquet time stamp is a whole number.
        received_us = cell if isinstance(cell, int) else from_rfc3339(str(cell).strip())
    except ValueError as error:
        raise RowError(f"received: {error}") from None
    if not 0 <= received_us < 2**62:
        raise RowError(f"received: {cell!r}: expected a time after 1970")
    return received_us


def _number(column: str, cell: object) -> float | None:
    """Value of a cell; None where it is empty."""
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return None
    try:
        value = float(str(cell))
    except ValueError:
        value = math.nan
    if isinstance(cell, float) and math.isnan(cell):
        return None  # how data frames write an empty cell
    if not math.isfinite(value):
        raise RowError(f"{column} = {cell!r}: expected a number or an empty cell")
    return value


def _check_range(channel: str, value: float) -> None:
    name = channel.partition(".")[0]
    for suffix, (low, high) in _RANGES.items():
        if name.endswith(suffix) and not low <= value <= high:
            raise RowError(f"{channel} = {value:g}: expected {low:g} to {high:g}")
