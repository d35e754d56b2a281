"""Files into the store: CSV, Parquet, MDF; every bad row named, sending again does no harm."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adapters.samples import Quality, Sample
from adapters.tables import (
    RowError,
    TableRow,
    TimeStamp,
    has_decimal_comma,
    number_of,
    open_table,
    units_stated,
)
from adapters.times import POSSIBLE, is_possible
from adapters.words import shown
from service.clock import rfc3339_exact
from service.store import Store
from service.transfer import mdf
from service.transfer.errors import TransferError
from service.transfer.mapping import Layout, layout_of, moment_us, read_mapping, time_reader

BATCH_SAMPLES = 20_000
#: This many bad rows are reported one by one; all are counted.
REJECTED_LISTED = 100

# What no machine shows: sentinels and shifted columns must not pass as measurements.
_RANGES = {"_c": (-100.0, 500.0), "_rpm": (-1e5, 1e5), "_n": (-1e3, 1e7)}

Row = Mapping[str, object]
Progress = Callable[[float], None]
_Numbered = tuple[int, Sample]
"""Line or number in the file, and sample."""


@dataclass(frozen=True, slots=True)
class RejectedRow:
    """A row, or a cell of it, that was not taken."""

    line: int
    detail: str


@dataclass(slots=True)
class ImportReport:
    """What became of a file.

    - ``stored``, ``duplicates``: of the samples; both stay 0 in a dry run.
    - ``too_old``: samples from before the time from which the store keeps raw samples; not stored.
    - ``rejected``: how many rows or cells were not taken; `first_rejected` names the first of
      them.
    - ``conversions``: what was done to the values of channels, one line for each.
    """

    rows: int = 0
    samples: int = 0
    stored: int = 0
    duplicates: int = 0
    too_old: int = 0
    rejected: int = 0
    first_rejected: list[RejectedRow] = field(default_factory=list)
    conversions: list[str] = field(default_factory=list)

    def reject(self, line: int, detail: str) -> None:
        """Count a row or cell that is not taken."""
        self.rejected += 1
        if len(self.first_rejected) < REJECTED_LISTED:
            self.first_rejected.append(RejectedRow(line, detail))


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

    Raises `TableFileError` or `TransferError` if the file cannot be used as a whole; nothing is
    stored then. Raises `StoreUnavailableError` if the store goes away; what was stored stays, and
    importing again completes it.

    - ``path``: a CSV file, a Parquet file by its suffix, or an MDF file by its first bytes.
    - ``store``: where they go; None only reads, as a dry run.
    - ``start_us``: what a column of seconds counts from, UTC microseconds; of an MDF file the time
      of 0 s.
    - ``now_us``: process time in UTC microseconds: received time of the samples of which the file
      does not say it, and no sample can be from the day after tomorrow.
    """
    plan = None if mapping is None else read_mapping(mapping)
    report = ImportReport()
    if mdf.is_mdf(path):
        if store is not None:
            with mdf.open_mdf(path, plan, own_channels, start_us) as found:
                deque(found, maxlen=0)  # a channel that stops the import stops it before the first
        with mdf.open_mdf(path, plan, own_channels, start_us) as found:
            for one in found:
                _take_channel(one, asset, store, now_us, report)
                progress(one.read)
        if report.rows == 0:
            raise TransferError(f"{path.name}: no samples; expected at least one")
        return report
    delimiter = "," if plan is None else plan.delimiter
    with open_table(path, delimiter) as (columns, rows):
        layout = layout_of(path.name, columns, plan, own_channels, units_stated(path))
        time_us_of = time_reader(path.name, layout, start_us)
        _check_whole(path.name, layout, rows)
    report.conversions += layout.conversions
    with open_table(path, delimiter) as (_, rows):
        batch: list[_Numbered] = []
        for read, line, row in rows:
            report.rows += 1
            for sample in _samples(row, line, layout, asset, time_us_of, now_us, report):
                batch.append((line, sample))
            if len(batch) >= BATCH_SAMPLES:
                _store(store, batch, report)
                batch = []
                progress(read)
        _store(store, batch, report)
    if report.rows == 0:
        raise TransferError(f"{path.name}: line 2: no rows; expected at least one")
    progress(1.0)
    return report


def _check_whole(name: str, layout: Layout, rows: Iterator[TableRow]) -> None:
    """Read a file to its end before anything of it is stored: it may be damaged further on.

    Raises `TableFileError` then, and `TransferError` where its numbers have a decimal comma and no
    mapping says so: their columns would be missing beside those of whole numbers, and of counted
    times those with a fraction.
    """
    columns = [source.column for source in layout.channels.values()] or ["value"]
    if layout.unit is not None:
        columns.append(layout.time)
    # One sample in a row: no mapping describes such a file.
    wanted = 'a mapping with decimal = ","' if layout.channels else "a decimal point"
    for _, line, row in rows:
        if layout.decimal == "," or isinstance(row, RowError):
            continue
        for column in columns:
            cell = row[column]
            if isinstance(cell, str) and has_decimal_comma(cell):
                raise TransferError(
                    f"{name}: line {line}: {column} = {shown(cell)}: a decimal comma; "
                    f"expected {wanted}"
                )


def _take_channel(
    one: mdf.MdfChannel, asset: str, store: Store | None, now_us: int, report: ImportReport
) -> None:
    """Store a block of an MDF file; lines are the numbers of the samples of its channel."""
    rows = zip(one.time_us.tolist(), one.values.tolist(), one.quality.tolist(), strict=True)
    batch: list[_Numbered] = []
    conversion = f"{one.channel}: {one.conversion}"
    if one.conversion and conversion not in report.conversions:
        report.conversions.append(conversion)
    for number, (time_us, value, quality) in enumerate(rows, one.first):
        report.rows += 1
        try:
            if not is_possible(time_us, now_us):
                raise _impossible(one.channel, time_us)
            if not math.isnan(value):
                _check_range(one.channel, value)
        except RowError as error:
            report.reject(number, str(error))
            continue
        batch.append((number, Sample(asset, one.channel, time_us, value, quality, now_us)))
        if len(batch) >= BATCH_SAMPLES:
            _store(store, batch, report)
            batch = []
    _store(store, batch, report)


def _store(store: Store | None, batch: Sequence[_Numbered], report: ImportReport) -> None:
    report.samples += len(batch)
    if store is None:
        _compare_batch(batch, report)
        return
    counts = store.samples.write([sample for _, sample in batch])
    others = _compare(store, batch, report) if counts.duplicates else 0
    report.stored += counts.stored
    report.duplicates += counts.duplicates - others
    report.too_old += len(batch) - counts.stored - counts.duplicates


def _compare(store: Store, batch: Sequence[_Numbered], report: ImportReport) -> int:
    """Reject what the store has with another value; returns how many those are."""
    by_channel: dict[tuple[str, str], list[_Numbered]] = {}
    for line, sample in batch:
        if not math.isnan(sample.value):
            by_channel.setdefault((sample.asset, sample.channel), []).append((line, sample))
    found: list[tuple[int, str]] = []
    for (asset, channel), numbered in by_channel.items():
        times_us = np.array([sample.time_us for _, sample in numbered], np.int64)
        values = np.array([sample.value for _, sample in numbered])
        others = store.channel_history.differing(asset, channel, times_us, values)
        for place, stored in others.items():
            line, sample = numbered[place]
            found.append((line, _not_taken(sample, stored)))
    for line, detail in sorted(found):
        report.reject(line, detail)
    return len(found)


def _compare_batch(batch: Sequence[_Numbered], report: ImportReport) -> None:
    """Reject what the batch itself has with another value: a dry run has no store."""
    first: dict[tuple[str, int], float] = {}
    for line, sample in batch:
        if not math.isnan(sample.value):
            known = first.setdefault((sample.channel, sample.time_us), sample.value)
            if known != sample.value:
                report.reject(line, _not_taken(sample, known))


def _not_taken(sample: Sample, other: float) -> str:
    return (
        f"{sample.channel} = {sample.value:g} at {rfc3339_exact(sample.time_us)}: same time, "
        f"another value: not taken; {other:g} is stored"
    )


def _samples(
    row: Row | RowError,
    line: int,
    layout: Layout,
    asset: str,
    time_us_of: Callable[[object], int],
    now_us: int,
    report: ImportReport,
) -> Iterator[Sample]:
    try:
        if isinstance(row, RowError):
            raise row
        time_us = time_us_of(row[layout.time])
        if not is_possible(time_us, now_us):
            raise _impossible(layout.time, time_us)
        if not layout.channels:
            yield _long(row, asset, time_us, now_us)
            return
    except RowError as error:
        report.reject(line, str(error))
        return
    for channel, source in layout.channels.items():
        try:
            value = _number(source.column, row[source.column], layout.decimal)
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
    received_us = moment_us("received", cell)
    if not is_possible(received_us, now_us):
        raise _impossible("received", received_us)
    return received_us


def _impossible(name: str, time_us: int) -> RowError:
    """Make the error of a time that no sample can have."""
    return RowError(f"{name}: {rfc3339_exact(time_us)}: expected {POSSIBLE}")


def _number(column: str, cell: object, decimal: str = ".") -> float | None:
    """Value of a cell; None where it is empty."""
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return None
    if isinstance(cell, float) and math.isnan(cell):
        return None  # how data frames write an empty cell
    try:
        if isinstance(cell, TimeStamp):
            raise ValueError("a time is no value")
        value = number_of(str(cell), decimal if isinstance(cell, str) else ".")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RowError(f"{column} = {shown(cell)}: expected a number or an empty cell")
    return value


def _check_range(channel: str, value: float) -> None:
    name = channel.partition(".")[0]
    for suffix, (low, high) in _RANGES.items():
        if name.endswith(suffix) and not low <= value <= high:
            raise RowError(f"{channel} = {value:g}: expected {low:g} to {high:g}")
