"""The files of a report."""

from importlib.util import find_spec
from typing import Final, Literal

from service.domain.errors import BearingTwinError
from service.features.runs.report.contents import contents
from service.features.runs.runs import Run
from service.site.asset_section import AssetSection
from service.store import Store

ReportFormat = Literal["pdf", "png", "csv"]
FORMATS: Final[tuple[ReportFormat, ...]] = ("pdf", "png", "csv")
#: Makes PDF and PNG possible in every installation.
INSTALL: Final = 'pip install "matplotlib>=3.10"'


class ReportError(BearingTwinError, ValueError):
    """A report that cannot be made; the text is one line for the user."""


def available_formats() -> list[ReportFormat]:
    """Formats that can be made here: some need a library, which is not loaded for the answer."""
    return [one for one in FORMATS if one == "csv" or find_spec("matplotlib") is not None]


def require(format: ReportFormat) -> None:
    """Raise a `ReportError` for a format whose libraries are not installed; loads none."""
    if format not in available_formats():
        raise ReportError(f"{format} needs matplotlib, which is not installed: {INSTALL}")


def report_file(
    store: Store,
    asset: AssetSection,
    run: Run,
    format: ReportFormat,
    now_us: int,
    time_zone: str = "UTC",
) -> bytes:
    """Make the report of a run.

    Raises `ReportError` if the format's libraries are not installed.
    """
    require(format)
    report = contents(store, asset, run, now_us, time_zone)
    if format == "csv":
        from service.features.runs.report.tables import csv_bytes

        return csv_bytes(report)
    from service.features.runs.report import drawing

    return drawing.pdf_bytes(report) if format == "pdf" else drawing.png_bytes(report)
