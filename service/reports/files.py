"""The files of a report."""

from importlib.util import find_spec
from typing import Final, Literal

from service.reports.contents import contents
from service.site.asset_section import AssetSection
from service.store import Run, Store

ReportFormat = Literal["pdf", "png", "csv"]
FORMATS: Final[tuple[ReportFormat, ...]] = ("pdf", "png", "csv")


class ReportError(ValueError):
    """A report that cannot be made; the text is one line for the user."""


def require(format: ReportFormat) -> None:
    """Refuse a format whose libraries are not installed; they are not loaded for it.

    Raises
    ------
    ReportError
        If so.
    """
    if format != "csv" and find_spec("matplotlib") is None:
        raise ReportError(f"format {format}: matplotlib is not installed (extra report)")


def report_file(
    store: Store, asset: AssetSection, run: Run, format: ReportFormat, now_us: int
) -> bytes:
    """Make the report of a run.

    Parameters
    ----------
    store
        Where the data are.
    asset, run
        Of what.
    format
        PDF, PNG, or the tables alone as CSV.
    now_us
        Process time.

    Raises
    ------
    ReportError
        If the format's libraries are not installed.
    """
    require(format)
    report = contents(store, asset, run, now_us)
    if format == "csv":
        from service.reports.tables import csv_bytes

        return csv_bytes(report)
    from service.reports import drawing

    return drawing.pdf_bytes(report) if format == "pdf" else drawing.png_bytes(report)
