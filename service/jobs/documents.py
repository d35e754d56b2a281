"""Jobs as the REST interface shows them."""

from dataclasses import dataclass, replace
from typing import Any

from service.clock import rfc3339
from service.jobs.workspace import Progress
from service.store.records import Job

# Before this part of the way nobody can say how long the rest takes.
_LEAST_FRACTION = 0.02
_MOST_TOLD = 50


@dataclass(frozen=True, slots=True)
class Told:
    """The latest word of a worker on its job, and when and how far it was when it first spoke.

    A worker that goes on from a checkpoint begins far along: only what it did itself tells its
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


class LastWords:
    """What the workers said last, of the latest jobs."""

    def __init__(self) -> None:
        self._told: dict[str, Told] = {}

    def get(self, job_id: str) -> Told | None:
        """Return the last word on a job; None where there was none."""
        return self._told.get(job_id)

    def remember(self, job_id: str, progress: Progress, now_s: float) -> None:
        """Keep what a worker says at a wall time in s, and forget what is long past."""
        before = self._told.pop(job_id, None)
        if before is None or progress.fraction < before.progress.fraction:
            self._told[job_id] = Told(progress, now_s, progress.fraction, now_s)
        else:
            self._told[job_id] = replace(before, progress=progress, now_s=now_s)
        while len(self._told) > _MOST_TOLD:
            del self._told[next(iter(self._told))]


def job_json(job: Job, told: Told | None = None, convergence: bool = False) -> dict[str, Any]:
    """A job in the shape of the REST contract.

    Parameters
    ----------
    job
        From the store.
    told
        The latest word of the worker, where there was one.
    convergence
        Whether to show how the best fitness fell.
    """
    running = told is not None and job.status == "running"
    seconds_left = told.seconds_left() if told is not None and running else None
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
        "phase": told.progress.phase if told is not None and running else None,
        "seconds_left": round(seconds_left, 1) if seconds_left is not None else None,
        "active_fitness": told.progress.active_fitness if told is not None else None,
    }
    if convergence:
        shown["convergence"] = told.progress.convergence if told is not None else []
    return shown
