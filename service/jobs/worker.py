"""What the background worker computes: fit, gates, scores. Runs in a process of its own."""

import time
from dataclasses import dataclass, field
from typing import Any

from service.jobs.workspace import JobFolder, Progress
from twin_core import identification
from twin_core.bearings import bearing
from twin_core.identification import IdentificationData, Posterior
from twin_core.models import build_model
from twin_core.windows import window_of

PROGRESS_EVERY_WALL_S = 0.25


@dataclass(frozen=True, slots=True)
class JobOrder:
    """All that a worker needs; it never sees the store.

    Attributes
    ----------
    folder : JobFolder
        Where progress goes and the mark to stop appears.
    model_name, bearing : str
        Which model to identify.
    data : IdentificationData
        Low-risk windows.
    active : dict
        Posterior of the active model, against which the gates compare.
    method : str
        noa+refine, refine or noa.
    seed : int
        Of the search.
    budget : int or None
        Most evaluations; None takes the method's own.
    """

    folder: JobFolder
    model_name: str
    bearing: str
    data: IdentificationData
    active: dict[str, Any]
    method: str
    seed: int
    budget: int | None


@dataclass(frozen=True, slots=True)
class JobResult:
    """What a worker found; plain JSON types where they go into a model's document."""

    cancelled: bool = False
    accepted: bool = False
    reason: str = ""
    best_fitness: float | None = None
    evaluations: int = 0
    posterior: dict[str, Any] = field(default_factory=dict)
    windows: list[dict[str, Any]] = field(default_factory=list)
    window_records: list[dict[str, Any]] = field(default_factory=list)
    scores: dict[str, Any] = field(default_factory=dict)
    naive: dict[str, Any] = field(default_factory=dict)
    gates: dict[str, Any] = field(default_factory=dict)


def run_identification(order: JobOrder) -> JobResult:
    """Identify, then let the gates decide whether the result may become active."""
    model = build_model(order.model_name, bearing=bearing(order.bearing))
    told_at = 0.0

    def tell(progress: identification.Progress) -> None:
        nonlocal told_at
        if time.monotonic() - told_at < PROGRESS_EVERY_WALL_S:
            return
        told_at = time.monotonic()
        order.folder.write_progress(
            Progress(
                # The gates' fits take the last part of the bar.
                fraction=0.8 * progress.fraction,
                phase=progress.phase,
                evaluations=progress.evaluations,
                best_fitness=progress.best_fitness,
            )
        )
