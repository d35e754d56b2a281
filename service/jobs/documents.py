"""What workers last reported of their jobs, and jobs shown with it."""

from dataclasses import dataclass, replace

from cachetools import FIFOCache

from service.documents.identification import JobDocument, job_document
from service.jobs.workspace import Progress
from service.store.records import Job

# Before this part of the way no one can say how long the rest takes.
_LEAST_FRACTION = 0.02
_MOST_KEPT = 50


@dataclass(frozen=True, slots=True)
class ReportedProgress:
    """What a worker reported last of its job, and when and how far it was at its first report.

    A worker that goes on from a checkpoint begins far along: only what it did itself shows its
    speed.
    """

    progress: Progress
    now_s: float
    first_fraction: float
    first_s: float

    def seconds_left(self) -> float | None:
        """Wall seconds until the end; None where the pace is not known."""
        done = self.progress.fraction - self.first_fraction
        if done < _LEAST_FRACTION or self.progress.phase == "gates":
            return None
        return (1.0 - self.progress.fraction) / done * (self.now_s - self.first_s)


class ProgressCache:
    """What the workers reported last, of the latest jobs."""

    def __init__(self) -> None:
        self._reported: FIFOCache[str, ReportedProgress] = FIFOCache(_MOST_KEPT)

    def get(self, job_id: str) -> ReportedProgress | None:
        """Return the last report on a job; None where there was none."""
        return self._reported.get(job_id)

    def remember(self, job_id: str, progress: Progress, now_s: float) -> None:
        """Keep what a worker reports at a wall time in s, and forget what is long past."""
        before = self._reported.pop(job_id, None)
        if before is None or progress.fraction < before.progress.fraction:
            self._reported[job_id] = ReportedProgress(progress, now_s, progress.fraction, now_s)
        else:
            self._reported[job_id] = replace(before, progress=progress, now_s=now_s)


def shown(
    job: Job, reported: ReportedProgress | None = None, convergence: bool = False
) -> JobDocument:
    """Show a job with what its worker last reported.

    Parameters
    ----------
    job
        From the store.
    reported
        What the worker reported last, where it did.
    convergence
        Whether to show how the best fitness fell.
    """
    course = reported.progress.convergence if reported is not None else []
    running = reported if job.status == "running" else None
    return job_document(
        job,
        phase=None if running is None else running.progress.phase,
        seconds_left=None if running is None else running.seconds_left(),
        active_fitness=None if reported is None else reported.progress.active_fitness,
        convergence=course if convergence else None,
    )
