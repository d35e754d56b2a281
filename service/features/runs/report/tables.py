"""The tables of a report, for paper and for spreadsheets."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final
from zoneinfo import ZoneInfo

from service.clock import MICROSECONDS, rfc3339
from service.domain.channels import LOAD, SPEED, label, unit_of
from service.features.runs.report.contents import Report
from service.spreadsheets import cell as safe_cell

_DAY_S: Final = 86_400
#: Title of a column whose negative numbers stand out.
MARGIN: Final = "Margin"


@dataclass(frozen=True, slots=True)
class Moment:
    """A process time as a cell, on paper with the local time of a place too."""

    time_us: int
    time_zone: str = "UTC"


Cell = str | float | int | Moment | None


@dataclass(frozen=True, slots=True)
class Column:
    """A column: what stands over it, its share of the width, and the decimals of its numbers."""

    title: str
    width: float
    digits: int = 0


@dataclass(frozen=True, slots=True)
class Table:
    """A part of a report; ``nothing`` is what is said where there are no rows."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    nothing: str
    note: str = ""


def tables(report: Report) -> list[Table]:
    """Make the tables of a report."""
    return [
        _channels(report), _alarms(report), _annotations(report), _forecasts(report),
        _models(report),
    ]  # fmt: skip


def heading(report: Report) -> list[tuple[str, Cell]]:
    """Say what was run."""
    asset, run = report.asset, report.run
    ended = {
        "": "goes on; up to the last data",
        "standstill": "standstill",
        "no data": "the data ended while the machine turned",
    }[run.ended]
    bearing = asset.bearing.name if asset.bearing is not None else f"network {asset.network_name}"
    return [
        ("Asset", asset.id if asset.name in ("", asset.id) else f"{asset.name} ({asset.id})"),
        ("Bearing", bearing),
        ("Run", run.id),
        ("Name", f"{run.name} (by {run.named_by})" if run.name else None),
        ("Start", Moment(run.start_us, report.time_zone)),
        ("End", Moment(report.end_us, report.time_zone)),
        ("Duration", duration(report.length_s)),
        ("Ended by", ended),
    ]


def duration(seconds: float) -> str:
    """Write a span of time: 35 min, 11 h 05 min, 3 d 02 h."""
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    if seconds < 2 * _DAY_S:
        return f"{minutes // 60} h {minutes % 60:02d} min" if minutes % 60 else f"{minutes // 60} h"
    return f"{minutes // 1440} d {minutes % 1440 // 60:02d} h"


def moment(time_us: int, time_zone: str = "UTC") -> str:
    """Write a process time for paper: UTC, and the local time of another zone after it."""
    utc = datetime.fromtimestamp(time_us // MICROSECONDS, UTC)
    if time_zone == "UTC":
        return f"{utc:%Y-%m-%d %H:%M}"
    return f"{utc:%Y-%m-%d %H:%M} ({utc.astimezone(ZoneInfo(time_zone)):%H:%M})"


def _clock(report: Report) -> str:
    """In which time the moments of a column are."""
    return "(UTC)" if report.time_zone == "UTC" else "UTC (local)"


def csv_bytes(report: Report) -> bytes:
    """Make the report's CSV: each row begins with its part; the first row of a part has names."""
    report = replace(report, time_zone="UTC")  # a program reads it
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["Run", "item", "value"])
    for name, value in heading(report):
        writer.writerow([safe_cell(one) for one in ("Run", name, _plain(value))])
    for table in tables(report):
        writer.writerow([table.title, *(column.title for column in table.columns)])
        for row in table.rows:
            writer.writerow([safe_cell(one) for one in (table.title, *map(_plain, row))])
    # Spreadsheets take a file for UTF-8 by this mark alone.
    return b"\xef\xbb\xbf" + text.getvalue().encode()


def _plain(value: Cell) -> object:
    if isinstance(value, Moment):
        return rfc3339(value.time_us)
    if isinstance(value, float):
        return "" if value != value else round(value, 3)
    return "" if value is None else value


def _channels(report: Report) -> Table:
    columns = (
        Column("Channel", 0.17), Column("Maximum", 0.08, 1), Column("Unit", 0.05),
        Column(f"At {_clock(report)}", 0.24), Column("Warning", 0.08, 0), Column("Alarm", 0.07, 0),
        Column(MARGIN, 0.09, 1), Column("Good", 0.09), Column("Longest gap", 0.13),
    )  # fmt: skip
    rows: list[list[Cell]] = []
    operation = [name for name in (SPEED, LOAD) if name in report.curves]
    for name in (*report.temperatures, *operation):
        curve = report.curves[name]
        limits = report.asset.limits.get(name)
        peak: Cell = curve.peak
        if curve.peak is not None and name in operation:
            peak = round(curve.peak)
        margin = None
        if limits is not None and curve.peak is not None:
            margin = float(limits.alarm) - curve.peak
        rows.append(
            [
                label(name),
                peak,
                unit_of(name),
                None if curve.peak_us is None else Moment(curve.peak_us, report.time_zone),
                None if limits is None else float(limits.warning),
                None if limits is None else float(limits.alarm),
                margin,
                f"{100 * curve.good_share:.1f} %",
                duration(curve.longest_gap_s) if curve.longest_gap_s else "none",
            ]
        )
    return Table(
        "Maxima, limits and quality of the data", columns, rows, "There are no data.",
        "A negative margin to the alarm limit means that the value was over it. The limits are "
        "those at the end of the run. Good: share of the run's spans of "
        f"{duration(report.bucket_s)} with a good value.",
    )  # fmt: skip


def _alarms(report: Report) -> Table:
    columns = (
        Column("Alarm", 0.35), Column("Priority", 0.08), Column(f"Raised {_clock(report)}", 0.19),
        Column("Acknowledged", 0.19), Column("Returned", 0.19),
    )  # fmt: skip

    def at(time_us: int | None) -> Moment | None:
        return None if time_us is None else Moment(time_us, report.time_zone)

    rows: list[list[Cell]] = [
        [one.message, one.priority, at(one.raised_us), at(one.acknowledged_us), at(one.returned_us)]
        for one in report.alarms
    ]
    return Table("Alarms", columns, rows, "Nothing happened to any alarm in this run.")


def _forecasts(report: Report) -> Table:
    columns = (
        Column("Channel", 0.26), Column("Ahead", 0.14), Column("Compared", 0.12),
        Column("Mean error, K", 0.16, 2), Column("Bias, K", 0.12, 2),
        Column("In 95 % band", 0.2, 0),
    )  # fmt: skip
    rows: list[list[Cell]] = []
    for line in report.forecasts:
        scores = line.scores
        known = scores.n > 0
        rows.append(
            [
                label(line.channel),
                duration(line.lead_time_s),
                f"{scores.n} of {scores.n + line.set_aside}",
                float(scores.mae_k) if known else None,
                float(scores.bias_k) if known else None,
                f"{100 * scores.coverage_95:.0f} %" if known else None,
            ]
        )
    return Table(
        "Forecasts against what came", columns, rows, "No forecast was kept for this run.",
        f"{report.forecasts_made} forecasts. Those whose plan the machine did not follow, or whose "
        "data are missing, are not compared. Bias is forecast minus measured.",
    )  # fmt: skip


def _models(report: Report) -> Table:
    columns = (
        Column("Version", 0.12), Column(f"Active from {_clock(report)}", 0.24),
        Column("By", 0.22), Column("Comment", 0.42),
    )  # fmt: skip
    rows: list[list[Cell]] = [
        [one.version, Moment(one.at_us, report.time_zone), one.who, one.comment]
        for one in report.models
    ]
    return Table("Model versions", columns, rows, "No model was active.")


def _annotations(report: Report) -> Table:
    columns = (
        Column("Mark", 0.07),
        Column(f"Time {_clock(report)}", 0.24),
        Column("Note", 0.47),
        Column("By", 0.22),
    )
    rows: list[list[Cell]] = [
        [number, Moment(one.time_us, report.time_zone), one.text, one.who]
        for number, one in enumerate(report.annotations, 1)
    ]
    return Table("Annotations", columns, rows, "There are none.")


def printed(value: Cell, digits: int) -> str:
    """Write a cell for paper: control characters are blanks, and no value is a dash."""
    if value is None:
        return "–"
    if isinstance(value, Moment):
        return moment(value.time_us, value.time_zone)
    if isinstance(value, float):
        return "–" if value != value else f"{value:.{digits}f}".replace("-", "−")
    return "".join(one if one.isprintable() else " " for one in str(value))


def wrapped(text: str, width: int) -> Iterator[str]:
    """Cut a text into lines of so many width at most, at blanks where there are some."""
    line = ""
    for word in text.split(" "):
        while len(word) > width:
            if line:
                yield line
                line = ""
            yield word[:width]
            word = word[width:]
        if line and len(line) + 1 + len(word) > width:
            yield line
            line = word
        else:
            line = f"{line} {word}" if line else word
    if line:
        yield line
