"""What a worker computes: the file of a report."""

from service.bus.questions import Question
from service.domain.errors import NotReadyError
from service.features.runs.report.files import ReportFormat
from service.features.runs.runs import Run
from service.web.worker import Asked, settings, store


@Question(of_store=True)
def report(asked: Asked, run: Run, format: ReportFormat, now_us: int, time_zone: str) -> bytes:
    """Make the report of a run, as it is at a process time."""
    # Only the worker loads what draws.
    from service.features.runs.report.files import report_file
    from service.features.runs.report.run_limits import asset_of_run

    section = asset_of_run(settings(), store(), run)
    if section is None:
        raise NotReadyError(f"asset {asked.asset!r} was removed, or does not fit the configuration")
    return report_file(store(), section, run, format, now_us, time_zone)
