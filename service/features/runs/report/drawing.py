"""A report on paper: pages of A4 with curves and tables, as PDF or as one PNG. Needs matplotlib."""

import io
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from service.domain.channels import AMBIENT, LOAD, SPEED, label
from service.features.runs.report.contents import Report
from service.features.runs.report.tables import (
    MARGIN,
    Column,
    Table,
    duration,
    heading,
    moment,
    printed,
    tables,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_MM, _HEIGHT_MM = 210.0, 297.0
_LEFT_MM, _RIGHT_MM, _TOP_MM, _BOTTOM_MM = 20.0, 195.0, 280.0, 20.0
_MM: Final = 1 / 25.4
_ROW_MM: Final = 4.6
_TEXT_PT: Final = 8.0
#: Characters of this size in a millimetre of a column, on average.
_CHARACTERS_PER_MM: Final = 0.58
_MOST_ROWS: Final = 60
_DPI: Final = 110
_INK, _QUIET, _LINE = "#14171a", "#5a636c", "#c9ced3"
#: As on the page: red is an alarm, blue is the model; what was measured is black, and its lines
#: differ in their dashes.
_ALARM, _MODEL = "#c8140b", "#1c5a97"
_DASHES: Final[tuple[Any, ...]] = (
    "-", (0, (6, 2.5)), (0, (6, 2, 1.5, 2)), (0, (3, 1.5)), (0, (8, 2, 2, 2, 2, 2)), (0, (2, 3)),
)  # fmt: skip
_SETTINGS: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": _TEXT_PT,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _LINE,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e9ec",
    "xtick.color": _QUIET,
    "ytick.color": _QUIET,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    # Names and notes are people's: a dollar sign in them begins no formula.
    "text.parse_math": False,
    "text.usetex": False,
    "pdf.fonttype": 42,
    "pdf.compression": 9,
    "path.simplify": True,
}


def pdf_bytes(report: Report) -> bytes:
    """Draw the report as a PDF; the same bytes for the same report."""
    from matplotlib.backends.backend_pdf import PdfPages

    file = io.BytesIO()
    about = {"Title": _title(report), "Creator": "Bearing Twin", "Producer": "Bearing Twin"}
    with _settings(), PdfPages(file, metadata=about | {"CreationDate": None}) as pdf:
        for page in _pages(report):
            pdf.savefig(page)
    return file.getvalue()


def png_bytes(report: Report) -> bytes:
    """Draw the report's pages one below the other as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    def pixels(page: "Figure") -> NDArray[np.uint8]:
        canvas: Any = FigureCanvasAgg(page)
        page.set_dpi(_DPI)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    file = io.BytesIO()
    with _settings():
        image = np.concatenate([pixels(page) for page in _pages(report)])
        imsave(file, image, format="png", metadata={"Software": "Bearing Twin"})
    return file.getvalue()


@contextmanager
def _settings() -> Iterator[None]:
    import matplotlib

    # A character that the font does not have is drawn as a box: warnings are not read.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    logging.getLogger("fontTools").setLevel(logging.ERROR)
    with matplotlib.rc_context(_SETTINGS), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _title(report: Report) -> str:
    return f"Run {report.run.id} of {report.asset.id}"


class _Paper:
    """Pages that are filled from top to bottom; all lengths in millimetres."""

    def __init__(self, foot: str) -> None:
        self._foot = foot
        self.pages: list[Figure] = []
        self.new_page()

    def new_page(self) -> None:
        from matplotlib.figure import Figure

        self.pages.append(Figure(figsize=(_WIDTH_MM * _MM, _HEIGHT_MM * _MM), facecolor="white"))
        self.at_mm = _TOP_MM

    def need(self, height_mm: float) -> bool:
        """Begin a new page where so much does not fit; returns whether it did."""
        if self.at_mm - height_mm >= _BOTTOM_MM:
            return False
        self.new_page()
        return True

    def write(self, x_mm: float, text: str, **look: Any) -> None:
        y = (self.at_mm - 3) / _HEIGHT_MM
        self.pages[-1].text(x_mm / _WIDTH_MM, y, text, va="baseline", **look)

    def rule(self, above_mm: float, colour: str = _LINE, width: float = 0.5) -> None:
        from matplotlib.lines import Line2D

        y = (self.at_mm + above_mm) / _HEIGHT_MM
        ends = [_LEFT_MM / _WIDTH_MM, _RIGHT_MM / _WIDTH_MM]
        page = self.pages[-1]
        page.add_artist(Line2D(ends, [y, y], color=colour, linewidth=width))

    def axes(self, height_mm: float, above_mm: float = 1.0) -> "Axes":
        """A plot of the full width with room above it; what is below it has none yet."""
        self.at_mm -= height_mm
        left, width = (_LEFT_MM + 10) / _WIDTH_MM, (_RIGHT_MM - _LEFT_MM - 10) / _WIDTH_MM
        box = (left, self.at_mm / _HEIGHT_MM, width, (height_mm - above_mm) / _HEIGHT_MM)
        axes = self.pages[-1].add_axes(box)
        axes.tick_params(length=0)
        return axes

    def number(self) -> None:
        """Write the foot of all pages."""
        for number, page in enumerate(self.pages, 1):
            y = 10 / _HEIGHT_MM
            page.text(_LEFT_MM / _WIDTH_MM, y, self._foot, color=_QUIET, fontsize=7)
            text = f"page {number} of {len(self.pages)}"
            page.text(_RIGHT_MM / _WIDTH_MM, y, text, color=_QUIET, fontsize=7, ha="right")


def _pages(report: Report) -> "list[Figure]":
    zone = "" if report.time_zone == "UTC" else f", local times {report.time_zone}"
    paper = _Paper(f"Bearing Twin · {_title(report)} · all times UTC{zone}")
    _draw_heading(paper, report)
    _draw_temperatures(paper, report)
    _draw_operation(paper, report)
    for table in tables(report):
        _draw_table(paper, table)
    paper.number()
    return paper.pages


def _draw_heading(paper: _Paper, report: Report) -> None:
    paper.at_mm -= 2
    paper.write(_LEFT_MM, "Report of a run", fontsize=16, fontweight="bold")
    paper.at_mm -= 6
    paper.rule(0, _INK, 1.0)
    paper.at_mm -= 3
    facts = [(name, value) for name, value in heading(report) if value is not None]
    half = -(-len(facts) // 2)
    middle_mm = (_LEFT_MM + _RIGHT_MM) / 2
    begin_mm = lowest_mm = paper.at_mm
    for x_mm, part in ((_LEFT_MM, facts[:half]), (middle_mm, facts[half:])):
        paper.at_mm = begin_mm
        for name, value in part:
            paper.write(x_mm, name, color=_QUIET)
            lines = list(wrapped(printed(value, 0), 40)) or [""]
            for line in lines[:3]:
                paper.write(x_mm + 22, line)
                paper.at_mm -= _ROW_MM
        lowest_mm = min(lowest_mm, paper.at_mm)
    paper.at_mm = lowest_mm - 3


def _draw_temperatures(paper: _Paper, report: Report) -> None:
    _write_title(paper, "Temperatures, °C")
    axes = paper.axes(86, above_mm=6)
    shown = [name for name in report.temperatures if name in report.asset.limits]
    sensors = [name for name in report.asset.sensor_names if name in report.curves]
    shown = (shown or sensors or report.temperatures)[: len(_DASHES)]
    others = [name for name in report.temperatures if name not in (*shown, AMBIENT)]
    for number, name in enumerate(others):
        curve = report.curves[name]
        text = "other temperatures" if number == 0 else None
        axes.plot(curve.time_s / 3600, curve.mean, color="#b4bac0", linewidth=0.7, label=text)
    if AMBIENT in report.curves:
        curve = report.curves[AMBIENT]
        axes.plot(curve.time_s / 3600, curve.mean, ":", color=_QUIET, linewidth=1, label="Ambient")
    highest = max((report.curves[name].peak or 0.0 for name in shown), default=0.0)
    for name, dashes in zip(shown, _DASHES, strict=False):
        curve = report.curves[name]
        hours = curve.time_s / 3600
        axes.fill_between(hours, curve.low, curve.high, color=_INK, alpha=0.15, linewidth=0)
        axes.plot(hours, curve.mean, color=_INK, linewidth=1.3, linestyle=dashes, label=label(name))
        _draw_band(axes, report, name)
        limits = report.asset.limits.get(name)
        for level, value in (
            () if limits is None else (("warning", limits.warning), ("alarm", limits.alarm))
        ):
            # A limit far above all readings would only press them together.
            if value < highest + 30:
                exceeded = curve.peak is not None and curve.peak > value
                colour = _ALARM if exceeded else _QUIET
                axes.axhline(value, color=colour, linewidth=0.7, linestyle=dashes, alpha=0.7)
                axes.annotate(
                    f"{label(name).lower()} {level} {value:g}", (0, value),
                    xycoords=("axes fraction", "data"), ha="left", va="bottom",
                    xytext=(3, 1), textcoords="offset points", fontsize=6.5, color=colour,
                )  # fmt: skip
    _mark_notes(axes, report, True)
    _time_axis(axes, report)
    axes.legend(loc="upper left", bbox_to_anchor=(0, 1.075), ncols=5, borderaxespad=0)
    paper.at_mm -= 6
    if report.ahead is not None:
        ahead = duration(report.ahead.lead_time_s)
        text = f"Bars: what was forecast {ahead} before, 95 % band and median."
        paper.write(_LEFT_MM + 10, text, color=_QUIET, fontsize=7)
        paper.at_mm -= 5


def _draw_band(axes: "Axes", report: Report, name: str) -> None:
    """What was forecast for each moment: the 95 % band as a bar, the median as a dot."""
    if report.ahead is None or name not in report.ahead.quantiles_c:
        return
    hours = report.ahead.time_s / 3600
    low, _, median, _, high = report.ahead.quantiles_c[name].T
    axes.vlines(hours, low, high, color=_MODEL, alpha=0.35, linewidth=2.2)
    axes.plot(hours, median, ".", color=_MODEL, markersize=3, alpha=0.8)


def _draw_operation(paper: _Paper, report: Report) -> None:
    parts = ((SPEED, "Speed, rpm"), (LOAD, "Load, N"))
    known = [(name, title) for name, title in parts if name in report.curves]
    for number, (name, title) in enumerate(known):
        paper.need(38)
        _write_title(paper, title)
        axes = paper.axes(26)
        curve = report.curves[name]
        axes.fill_between(
            curve.time_s / 3600, curve.low, curve.high, color=_INK, alpha=0.15, linewidth=0
        )
        axes.plot(curve.time_s / 3600, curve.mean, color=_INK, linewidth=1)
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), 1.12 * max(curve.peak or 0.0, 1.0))
        _mark_notes(axes, report, False)
        _time_axis(axes, report)
        if number == len(known) - 1:
            axes.set_xlabel(
                f"hours since the start at {moment(report.run.start_us)} UTC", fontsize=7
            )
            paper.at_mm -= 4
        paper.at_mm -= 7


def _time_axis(axes: "Axes", report: Report) -> None:
    axes.set_xlim(0, max(report.length_s / 3600, 1 / 60))


def _mark_notes(axes: "Axes", report: Report, numbered: bool) -> None:
    """A line at every annotation, with its number in the table."""
    for number, note in enumerate(report.annotations[:_MOST_ROWS], 1):
        hours = (note.time_us - report.run.start_us) / 3.6e9
        axes.axvline(hours, color=_QUIET, linewidth=0.6, linestyle=(0, (1, 2)))
        if numbered:
            axes.annotate(
                str(number), (hours, 0), xycoords=("data", "axes fraction"), fontsize=6.5,
                color=_QUIET, ha="left", va="bottom", xytext=(2, 2), textcoords="offset points",
            )  # fmt: skip


def _write_title(paper: _Paper, title: str) -> None:
    paper.write(_LEFT_MM, title, fontsize=9.5, fontweight="bold")
    paper.at_mm -= 5.5


def _draw_table(paper: _Paper, table: Table) -> None:
    paper.need(8 + 4 * _ROW_MM)
    _write_title(paper, table.title)
    if not table.rows:
        paper.write(_LEFT_MM, table.nothing, color=_QUIET)
        paper.at_mm -= _ROW_MM + 5
        return
    _draw_head(paper, table.columns)
    width_mm = _RIGHT_MM - _LEFT_MM
    for row in table.rows[:_MOST_ROWS]:
        cells = [
            list(
                wrapped(
                    printed(value, column.digits), int(column.width * width_mm * _CHARACTERS_PER_MM)
                )
            )
            or [""]
            for value, column in zip(row, table.columns, strict=True)
        ]
        lines = max(len(cell) for cell in cells)
        if paper.need(lines * _ROW_MM):
            _draw_head(paper, table.columns)
        for number in range(lines):
            x_mm = _LEFT_MM
            for column, value, cell in zip(table.columns, row, cells, strict=True):
                if number < len(cell):
                    _draw_cell(paper, x_mm, column, value, cell[number])
                x_mm += column.width * width_mm
            paper.at_mm -= _ROW_MM
        paper.rule(1.0, "#e6e9ec", 0.4)
    more = len(table.rows) - _MOST_ROWS
    note = f"{more} more are in the CSV. {table.note}" if more > 0 else table.note
    for line in wrapped(note, 125):
        paper.need(_ROW_MM)
        paper.write(_LEFT_MM, line, color=_QUIET, fontsize=7)
        paper.at_mm -= 3.6
    paper.at_mm -= 5


def _draw_head(paper: _Paper, columns: Sequence[Column]) -> None:
    x_mm = _LEFT_MM
    for column in columns:
        paper.write(x_mm, column.title, color=_QUIET, fontsize=7)
        x_mm += column.width * (_RIGHT_MM - _LEFT_MM)
    paper.at_mm -= _ROW_MM
    paper.rule(0.8)


def _draw_cell(paper: _Paper, x_mm: float, column: Column, value: object, text: str) -> None:
    over = column.title == MARGIN and isinstance(value, float) and value < 0
    look = {"color": _ALARM, "fontweight": "bold"} if over else {}
    paper.write(x_mm, text, **look)
