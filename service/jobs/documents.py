"""Jobs as the REST interface shows them."""

from typing import Any

from service.clock import rfc3339
from service.store.records import Job


def job_json(job: Job) -> dict[str, Any]:
    """A job in the shape of the REST contract."""
    return {
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
        "requested_by": job.request["who"],
        "attempts": job.attempts,
    }
