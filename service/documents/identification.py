"""Low-risk windows, and the jobs that identify from them."""

from typing import Annotated, Literal

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import (
    Document,
    Number,
    Page,
    StoredDocument,
    Time,
    is_none,
    time_or_none,
)
from service.documents.profiles import StepLevel
from service.store.records import Job

ConvergencePoint = Annotated[
    list[float],
    Field(
        min_length=2,
        max_length=2,
        description="Evaluations so far, and the best fitness then.",
        examples=[[28, 150.6]],
    ),
]


class WindowDocument(Document):
    """A low-risk window with its operating points and score."""

    start: Time
    end: Time
    speed_rpm_max: float = Field(description="Highest speed, rpm.", examples=[2400])
    load_n_max: float = Field(description="Highest radial load, N.", examples=[2650])
    operating_points: list[StepLevel] = Field(description="Spans at constant speed and load.")
    score: float = Field(
        description="How much the window varies speed and load, 0 to 1.", examples=[0.26]
    )


class WindowList(Page):
    """Low-risk windows found in the store."""

    items: list[WindowDocument]


class JobWindow(StoredDocument):
    """A span of process time that a job identifies from, start inclusive and end exclusive."""

    start: Time
    end: Time


class JobDocument(Document):
    """One identification job."""

    id: str = Field(examples=["3f2b8c0e9d5a4a7f8e1c2b3d4e5f6a7b"])
    status: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float = Field(ge=0, le=1)
    best_fitness: Number = Field(description="Smallest sum of squared residuals so far.")
    evaluations: int = Field(description="Simulations of the data so far.")
    created_at: Time
    started_at: Time | None
    ended_at: Time | None
    error: str | None = Field(description="Why it failed or was cancelled.")
    model_version: int | None = Field(description="That came of it.")
    windows: list[JobWindow]
    method: Literal["noa+refine", "refine", "noa"]
    seed: int = Field(description="Of the search.")
    budget: int | None = Field(description="Most evaluations; null: the method's own.")
    requested_by: str = Field(
        description="Role, prefix and label of the key, or `automatic`.",
        examples=["engineer bt_1a2b3c4d"],
    )
    attempts: int = Field(description="How often a worker began it.")
    phase: str | None = Field(
        description="Of a running job: search, refinement, sampling or gates."
    )
    seconds_left: Number = Field(
        description="Wall seconds that a running job still takes; null while not known."
    )
    active_fitness: Number = Field(
        description="Best fitness to beat: of the active version on the same data."
    )
    convergence: list[ConvergencePoint] | None = Field(
        None,
        exclude_if=is_none,
        description="How the best fitness fell; of a single job only.",
    )


class JobList(Page):
    """Identification jobs, newest first."""

    items: list[JobDocument]


def job_document(
    job: Job,
    *,
    phase: str | None = None,
    seconds_left: float | None = None,
    active_fitness: float | None = None,
    convergence: list[list[float]] | None = None,
) -> JobDocument:
    """Show one job.

    Phase, seconds left, fitness and convergence are what its worker last reported; ``convergence``
    is left out where it is None.
    """
    request = job.request
    return JobDocument(
        id=job.id,
        status=job.status,
        progress=job.progress,
        best_fitness=job.best_fitness,
        evaluations=job.evaluations,
        created_at=rfc3339(job.created_at_us),
        started_at=time_or_none(job.started_at_us),
        ended_at=time_or_none(job.ended_at_us),
        error=job.error,
        model_version=job.model_version,
        windows=[JobWindow.model_validate(window) for window in request["windows"]],
        method=request["method"],
        seed=request["seed"],
        budget=request.get("budget"),
        requested_by=request["who"],
        attempts=job.attempts,
        phase=phase,
        seconds_left=None if seconds_left is None else round(seconds_left, 1),
        active_fitness=active_fitness,
        convergence=convergence,
    )
