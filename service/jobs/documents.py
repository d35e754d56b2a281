"""Jobs and model versions as the REST interface shows them."""

from dataclasses import dataclass, replace
from typing import Any

from cachetools import FIFOCache

from service.clock import rfc3339
from service.jobs.workspace import Progress
from service.store.records import Job, ModelVersion

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


def job_json(
    job: Job, reported: ReportedProgress | None = None, convergence: bool = False
) -> dict[str, Any]:
    """A job in the shape of the REST contract.

    Parameters
    ----------
    job
        From the store.
    reported
        What the worker reported last, where it did.
    convergence
        Whether to show how the best fitness fell.
    """
    running = reported is not None and job.status == "running"
    seconds_left = reported.seconds_left() if reported is not None and running else None
    shown: dict[str, Any] = {
        "id": job.id,
        "status": job.status,
        "progress": job.progress,
        "best_fitness": job.best_fitness,
        "evaluations": job.evaluations,
        "created_at": rfc3339(job.created_at_us),
        "started_at": rfc3339(job.started_at_us) if job.started_at_us is not None else None,
        "ended_at": rfc3339(job.ended_at_us) if job.ended_at_us is not None else None,
        "error": job.error,
        "model_version": job.model_version,
        "windows": job.request["windows"],
        "method": job.request["method"],
        "seed": job.request["seed"],
        "budget": job.request.get("budget"),
        "requested_by": job.request["who"],
        "attempts": job.attempts,
        "phase": reported.progress.phase if reported is not None and running else None,
        "seconds_left": round(seconds_left, 1) if seconds_left is not None else None,
        "active_fitness": reported.progress.active_fitness if reported is not None else None,
    }
    if convergence:
        shown["convergence"] = reported.progress.convergence if reported is not None else []
    return shown


def model_json(version: ModelVersion, combinations: bool = True) -> dict[str, Any]:
    """A model version as the REST interface shows it.

    Parameters
    ----------
    version
        From the store.
    combinations
        Whether to spell out which combinations of parameters are informed, besides how many.
    """
    shown = {
        name: version.document[name]
        for name in ("model", "parameters", "windows", "scores", "naive", "gates", "job")
    }
    # Versions of older releases carry none of these.
    shown["identifiability"] = version.document.get("identifiability")
    shown["paper_view"] = version.document.get("paper_view")
    shown["drift"] = version.document.get("drift")
    shown["method"] = version.document.get("method")
    shown["seed"] = version.document.get("seed")
    if not combinations and shown["identifiability"] is not None:
        shown["identifiability"] = {
            name: value
            for name, value in shown["identifiability"].items()
            if name != "combinations"
        }
    return {
        "version": version.version,
        "status": version.status,
        "reason": version.reason,
        "created_at": rfc3339(version.created_at_us),
    } | shown
