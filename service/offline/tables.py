"""The CSV files of the command line: recorded data and planned profiles in, forecasts out.

Every complaint names the file, the line, the column, the value and what was expected.
"""

import csv
import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from adapters.configuration import first_repeated
from adapters.tables import (
    COLUMNS_MAX,
    NOT_CLOSED,
    TableFileError,
    bounded_lines,
    number_of,
    why_not_csv,
)
from adapters.words import shown
from service.clock import from_rfc3339
from service.domain.channels import NODES, OPERATING_CHANNELS, RING_SENSORS
from service.domain.errors import BearingTwinError
from service.files import replacing
from service.site.machines.networks import NetworkSection
from service.spreadsheets import text_cell

FloatArray = NDArray[np.float64]

_RING_HEADER = f"{', '.join(OPERATING_CHANNELS + RING_SENSORS)} and {NODES[0]} to {NODES[-1]}"

# What no machine shows: sentinels and shifted columns must not pass as measurements.
_TEMPERATURE_RANGE = (-60.0, 400.0)
_RANGES = {"speed_rpm": (-1e5, 1e5), "load_n": (-1e3, 1e6)}
_ANY_RANGE = (-1e9, 1e9)


class TableError(BearingTwinError, ValueError):
    """A CSV file that cannot be used; its text is one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Measured rows of a file.

    - ``start_us``: UTC microseconds that ``time_s`` counts from; None where the file has only
      ``time_s``.
    - ``time_s``: (n,) ascending.
    - ``speed_rpm``, ``load_n``, ``ambient_c``: (n,) the operating point from each row's time on;
      NaN where the cell is empty.
    - ``temperatures_c``: (n,) at each row's time, per sensor; NaN where the cell is empty.
    - ``inputs``: (n,) per input of a network of one's own, in its order; as the operating point.
    - ``mean_square``: inputs whose square is heat: currents.
    """

    name: str
    start_us: int | None
    time_s: FloatArray
    speed_rpm: FloatArray
    load_n: FloatArray
    ambient_c: FloatArray
    temperatures_c: dict[str, FloatArray]
    inputs: dict[str, FloatArray] = field(default_factory=dict)
    mean_square: Collection[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRows:
    """Rows of a profile file, (n,) each, all finite; ``time_s`` counts from now, ascending.

    ``inputs`` (n, k) are those of a network of one's own, in its order.
    """

    time_s: FloatArray
    speed_rpm: FloatArray
    load_n: FloatArray
    ambient_c: FloatArray
    inputs: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


def read_recording(path: Path, network: NetworkSection | None = None) -> Recording:
    """Read recorded data: ``time`` (RFC 3339) or ``time_s``, operating point, temperatures.

    Raises `TableError` if the file cannot be read or used.

    - ``network``: a network of the user's own: its inputs, which there must be, and its
      temperatures, at least one of them. By default both rings, which there must be, and the nodes
      of the 14-node network.
    """
    temperatures = None if network is None else network.temperature_names
    needed = _operating_columns(network)
    known = (*OPERATING_CHANNELS, *(() if network is None else network.inputs))
    expected = _RING_HEADER
    if temperatures is not None:
        expected = f"{', '.join(needed)} and some of {', '.join(temperatures)}"
    with _opened(path) as file:
        table = _Table(path.name, file)
        clocks = [name for name in ("time", "time_s") if name in table.names]
        if len(clocks) != 1:
            found = "both time and time_s" if clocks else "missing column time or time_s"
            raise table.error(1, f"{found}; expected one of the two, then {expected}")
        for name in table.names:
            if name not in (clocks[0], *known) and not _is_known(name, temperatures):
                raise table.error(
                    1, f"unknown column {shown(name)}; expected {clocks[0]}, {expected}"
                )
        required = RING_SENSORS if temperatures is None else ()
        table.require((*needed, *required), f"{clocks[0]}, {expected}")
        if temperatures is not None and not set(temperatures) & set(table.names):
            raise table.error(1, f"no column with a temperature; expected {clocks[0]}, {expected}")
        columns = table.read(clocks[0], may_be_empty=True, numbers=_drives(network))
    start_us = None
    time_s = columns.pop(clocks[0])
    if clocks[0] == "time":
        start_us, time_s = table.start_us, time_s - time_s[0]
    speed_rpm, load_n, ambient_c = _operating_point(columns, time_s.size)
    inputs = {name: columns.pop(name) for name in (() if network is None else network.inputs)}
    squared = () if network is None else network.mean_square_inputs
    return Recording(
        path.name, start_us, time_s, speed_rpm, load_n, ambient_c, columns, inputs, squared
    )


def _operating_columns(network: NetworkSection | None) -> tuple[str, ...]:
    """Columns that there must be: a network need not have a speed or a load."""
    if network is None:
        return OPERATING_CHANNELS
    used = (name for name in OPERATING_CHANNELS if name not in network.unused_channels)
    return (*used, *network.inputs)


def _operating_point(columns: dict[str, FloatArray], size: int) -> list[FloatArray]:
    """Take speed, load and ambient out of the columns; what no law asks for may be missing."""
    return [columns.pop(name, np.zeros(size)) for name in OPERATING_CHANNELS]


def _drives(network: NetworkSection | None) -> Collection[str]:
    """Columns that may hold any number: currents and powers."""
    if network is None:
        return ()
    return set(network.inputs) - set(network.boundaries)


def _is_known(name: str, temperatures: Sequence[str] | None) -> bool:
    """Whether a temperature may have this name."""
    if temperatures is not None:
        return name in temperatures
    return name in RING_SENSORS + NODES


def read_profile(path: Path, network: NetworkSection | None = None) -> PlannedRows:
    """Read a profile: ``time_s,speed_rpm,load_n,ambient_c``, no cell empty.

    ``network``: one of the user's own, whose inputs there must be as well. Raises `TableError` if
    the file cannot be read or used.
    """
    expected = ("time_s", *_operating_columns(network))
    with _opened(path) as file:
        table = _Table(path.name, file)
        table.require(expected, ", ".join(expected))
        for name in table.names:
            if name not in (*expected, *OPERATING_CHANNELS):
                raise table.error(
                    1, f"unknown column {shown(name)}; expected {', '.join(expected)}"
                )
        columns = table.read("time_s", may_be_empty=False, numbers=_drives(network))
    if columns["time_s"][0] < 0.0:
        raise table.error(
            table.lines[0],
            f"time_s = {columns['time_s'][0]:g}: expected 0 or more, seconds from the end of the "
            "history",
        )
    time_s = columns.pop("time_s")
    speed_rpm, load_n, ambient_c = _operating_point(columns, time_s.size)
    names = () if network is None else network.inputs
    inputs = np.array([columns[name] for name in names]).reshape(-1, time_s.size).T
    return PlannedRows(time_s, speed_rpm, load_n, ambient_c, inputs)


def write_forecast(
    path: Path,
    time_s: FloatArray,
    names: Sequence[str],
    quantiles: FloatArray,
    whole_run_c: Mapping[str, FloatArray],
) -> None:
    """Write a forecast, one row per time.

    ``time_s``, ``names``, ``quantiles``: (n,) times, and the quantiles (5, n, names);
    ``whole_run_c``: by sensor, the edges (2, n) of the band of the whole run. Raises `FileError` if
    the file cannot be written.
    """
    levels = ("q025", "q25", "q50", "q75", "q975")
    header = ["time_s", *(f"{name}_{level}" for name in names for level in levels)]
    header += [f"{name}_whole_{edge}" for name in whole_run_c for edge in ("low", "high")]
    # (n, names, 5): the five columns of a name stand side by side
    cells = np.column_stack(
        (
            quantiles.transpose(1, 2, 0).reshape(time_s.size, -1),
            *(e.T for e in whole_run_c.values()),
        )
    )
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([text_cell(name) for name in header])
        for time, row in zip(time_s, cells, strict=True):
            writer.writerow([f"{time:.10g}", *(f"{value:.4f}" for value in row)])


def write_simulation(
    path: Path, time_s: FloatArray, names: Sequence[str], temperatures_c: FloatArray
) -> None:
    """Write simulated temperatures (n, names), one row per time.

    Raises `FileError` if the file cannot be written.
    """
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time_s", *(text_cell(name) for name in names)])
        for time, row in zip(time_s, temperatures_c, strict=True):
            writer.writerow([f"{time:.10g}", *(f"{value:.9f}" for value in row)])


def check_writable(path: Path) -> None:
    """Complain before a long computation, not after it, about a place that takes no file.

    Raises `TableError` if no file can be written there.
    """
    folder = path.parent
    if path.is_dir() or not folder.is_dir():
        raise TableError(f"{path}: cannot be written; expected a file in an existing folder")
    if not os.access(folder, os.W_OK):
        raise TableError(f"{path}: cannot be written; expected a folder that may be written to")


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield file
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise TableError(f"{path}: not UTF-8 text; expected a CSV file") from error


def _lines(file: TextIO, name: str) -> Iterator[str]:
    try:
        yield from bounded_lines(file, name)
    except TableFileError as error:
        raise TableError(str(error)) from error


class _Table:
    """A CSV file with a header, read column by column with the line of every row."""

    def __init__(self, name: str, file: TextIO) -> None:
        self.name = name
        self.lines: list[int] = []
        self.start_us = 0
        self._reader = csv.reader(_lines(file, name), strict=True)
        header = self._next()
        while header is not None and not any(cell.strip() for cell in header):
            header = self._next()
        if header is None:
            raise self.error(1, "empty file; expected a header line with the names of the columns")
        if len(header) > COLUMNS_MAX:
            raise self.error(1, f"{len(header)} columns; expected at most {COLUMNS_MAX}")
        self.names = [cell.strip() for cell in header]
        twice = first_repeated(self.names)
        if twice is not None:
            raise self.error(1, f"column {shown(twice)} occurs twice; expected once")

    def error(self, line: int, text: str) -> TableError:
        return TableError(f"{self.name}: line {line}: {text}")

    def require(self, names: Sequence[str], header: str) -> None:
        """Complain about the first of the columns that is not there."""
        for name in names:
            if name not in self.names:
                raise self.error(1, f"missing column {name!r}; expected {header}")

    def read(
        self, clock: str, may_be_empty: bool, numbers: Collection[str] = ()
    ) -> dict[str, FloatArray]:
        """Read all rows; the clock's column in seconds, since the epoch if it is ``time``.

        Columns called numbers may hold any; else temperatures are checked for what can be.
        """
        rows: list[list[float]] = []
        at = self.names.index(clock)
        while (cells := self._next()) is not None:
            if not any(cell.strip() for cell in cells):
                continue
            line = self._reader.line_num
            if len(cells) != len(self.names):
                raise self.error(line, f"{len(cells)} cells; expected {len(self.names)}")
            moment = cells[at]
            if clock == "time":
                cells[at] = self._since_start(line, moment, first=not rows)
            row = self._numbers(line, cells, clock, may_be_empty)
            if rows and row[at] <= rows[-1][at]:
                raise self.error(
                    line,
                    f"{clock} = {moment.strip()}: expected a time after that of line "
                    f"{self.lines[-1]}",
                )
            rows.append(row)
            self.lines.append(line)
        if not rows:
            raise self.error(self._reader.line_num + 1, "no rows; expected at least one")
        table = np.array(rows)
        columns = {name: table[:, k].copy() for k, name in enumerate(self.names)}
        for name, values in columns.items():
            if name != clock:
                self._check_range(name, values, name in numbers)
        return columns

    def _since_start(self, line: int, text: str, first: bool) -> str:
        """Seconds since the first row; `start_us` keeps what they count from."""
        try:
            time_us = from_rfc3339(text.strip())
        except ValueError as error:
            raise self.error(line, str(error)) from None
        if first:
            self.start_us = time_us
        return repr((time_us - self.start_us) / 1e6)

    def _numbers(
        self, line: int, cells: Sequence[str], clock: str, may_be_empty: bool
    ) -> list[float]:
        numbers = []
        for name, cell in zip(self.names, cells, strict=True):
            text = cell.strip()
            if not text and may_be_empty and name != clock:
                numbers.append(math.nan)
                continue
            try:
                value = number_of(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                optional = may_be_empty and name != clock
                expected = "a number or an empty cell" if optional else "a number"
                raise self.error(line, f"{name} = {shown(text)}: expected {expected}")
            numbers.append(value)
        return numbers

    def _check_range(self, name: str, values: FloatArray, is_number: bool) -> None:
        low, high = _ANY_RANGE if is_number else _RANGES.get(name, _TEMPERATURE_RANGE)
        with np.errstate(invalid="ignore"):
            outside = np.flatnonzero((values < low) | (values > high))
        if outside.size:
            row = int(outside[0])
            raise self.error(
                self.lines[row],
                f"{name} = {values[row]:g}: expected {low:g} to {high:g}, or an empty cell where "
                "there is no measurement",
            )

    def _next(self) -> list[str] | None:
        line = self._reader.line_num + 1
        wrong = ""
        try:
            cells = next(self._reader, None)
        except csv.Error as error:
            cells, wrong = None, why_not_csv(error)
        if self._reader.line_num > line:  # or only the end of the file closed it
            wrong = NOT_CLOSED
        if wrong:
            raise self.error(line, wrong)
        return cells
