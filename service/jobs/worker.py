"""What the background worker computes: fit, gates, scores. Runs in a process of its own."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.documents.drift import DriftDocument
from service.jobs.drift import EarlierVersion, drift_document, earlier_versions
from service.jobs.workspace import Convergence, JobFolder, Progress
from service.site.machines.machine import Machine
from service.store.records import ModelVersion
from twin_core.identification.checkpoint import CheckpointMismatchError
from twin_core.identification.data import IdentificationData
from twin_core.identification.gates import GateReport, judge
from twin_core.identification.identify import (
    IdentificationResult,
    Method,
    identify,
)
from twin_core.identification.identify import Progress as FitProgress
from twin_core.identification.posterior import Posterior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled
from twin_core.models import ThermalModel
from twin_core.naive import NaiveForecasts, fit_naive
from twin_core.windows import Window, window_of

PROGRESS_EVERY_WALL_S = 0.25
CHECKPOINT_EVERY_WALL_S = 0.5
_FIT_SHARE = 0.8


@dataclass(frozen=True, slots=True)
class JobOrder:
    """All that a worker needs; it never sees the store.

    Attributes
    ----------
    folder : JobFolder
        Where progress and checkpoints go and the mark to stop appears.
    machine : Machine
        What the model to identify is built of.
    data : IdentificationData
        Low-risk windows.
    active : Posterior
        Of the active model, against which the gates compare.
    method : str
        noa+refine, refine or noa.
    seed : int
        Of the search.
    budget : int or None
        Most evaluations; None takes the method's own.
    earlier : sequence of ModelVersion
        Versions that the result is compared with, oldest first.
    """

    folder: JobFolder
    machine: Machine
    data: IdentificationData
    active: Posterior
    method: Method
    seed: int
    budget: int | None
    earlier: Sequence[ModelVersion] = ()


@dataclass(frozen=True, slots=True, eq=False)
class JobResult:
    """What a worker found.

    Attributes
    ----------
    posterior : Posterior
        What is known of the parameters now.
    best_fitness, active_fitness : float or None
        Sum of squared residuals, and that of the active model.
    evaluations : int
        Simulations of the data.
    convergence : list of [evaluations, fitness]
        How the best fitness fell.
    windows : sequence of Window
        What it was identified from.
    gates : GateReport
        Whether it may become the active model, and why.
    drift : DriftDocument
        Comparison with earlier versions.
    naive : NaiveForecasts
        The simple forecasts that its own must beat, fitted to the same windows.
    """

    posterior: Posterior
    best_fitness: float
    active_fitness: float | None
    evaluations: int
    convergence: list[list[float]]
    windows: Sequence[Window]
    gates: GateReport
    drift: DriftDocument
    naive: NaiveForecasts


def run_identification(order: JobOrder) -> JobResult | None:
    """Identify, then let the gates decide whether the result may become active.

    Goes on from the checkpoint that a worker left which was killed with the same order. None when
    the job was cancelled.
    """
    model = order.machine.build()
    active_fitness = fitness_of(model, order.data, order.active)
    try:
        try:
            fit = _fit(order, model, active_fitness, order.folder.read_checkpoint())
        except CheckpointMismatchError:
            # More data have come, or this is another version of the software.
            fit = _fit(order, model, active_fitness, None)
        return assessed(
            model,
            order.data,
            fit,
            active=order.active,
            active_fitness=active_fitness,
            earlier=earlier_versions(order.earlier),
            cancelled=lambda: _is_stopped(order.folder),
        )
    except IdentificationCancelled:
        return None


def assessed(
    model: ThermalModel,
    data: IdentificationData,
    fit: IdentificationResult,
    *,
    active: Posterior,
    active_fitness: float | None,
    earlier: Sequence[EarlierVersion],
    cancelled: Callable[[], bool] | None = None,
) -> JobResult:
    """Let the gates judge a fit, and compare it with earlier versions.

    Parameters
    ----------
    model, data, fit
        The candidate and what it was identified from.
    active, active_fitness
        Of the active model.
    earlier
        Versions that it is compared with, oldest first.
    cancelled
        Asked during the fits of the gates.

    Raises
    ------
    IdentificationCancelled
        When ``cancelled`` says so.
    """
    report = judge(model, data, fit, active=active, cancelled=cancelled)
    windows = [window_of(window.minutes) for window in data.windows]
    return JobResult(
        posterior=fit.posterior,
        best_fitness=fit.best_fitness,
        active_fitness=active_fitness,
        evaluations=fit.evaluations,
        convergence=Convergence([*fit.history, (fit.evaluations, fit.best_fitness)]).points,
        windows=windows,
        gates=report,
        drift=drift_document(model, fit.posterior, windows, earlier),
        naive=fit_naive([window.minutes for window in data.windows]),
    )


def fitness_of(model: ThermalModel, data: IdentificationData, posterior: Posterior) -> float | None:
    """Sum of squared residuals of known parameters: what an identification has to fall below."""
    [cost] = IdentificationProblem(model, data).costs(posterior.z[np.newaxis])
    return float(cost) if math.isfinite(cost) else None


def _fit(
    order: JobOrder,
    model: ThermalModel,
    active_fitness: float | None,
    resume: Mapping[str, Any] | None,
) -> IdentificationResult:
    return identify(
        model,
        order.data,
        method=order.method,
        budget=order.budget,
        seed=order.seed,
        progress=_ProgressReporter(order.folder, active_fitness, (resume or {}).get("history", ())),
        cancelled=lambda: _is_stopped(order.folder),
        save=_CheckpointWriter(order.folder),
        resume=resume,
    )


def _is_stopped(folder: JobFolder) -> bool:
    """Tell whether the job is to stop. It is asked after every step: that is the sign of life."""
    folder.show_life()
    return folder.cancelled


class _CheckpointWriter:
    """Writes checkpoints to the job's folder, not too often."""

    def __init__(self, folder: JobFolder) -> None:
        self._folder = folder
        self._saved_at = time.monotonic()

    def __call__(self, checkpoint: Callable[[], Mapping[str, object]]) -> None:
        if time.monotonic() - self._saved_at >= CHECKPOINT_EVERY_WALL_S:
            self._folder.write_checkpoint(checkpoint())
            self._saved_at = time.monotonic()


class _ProgressReporter:
    """Writes an identification's progress to the job's folder, a few times a second."""

    def __init__(
        self,
        folder: JobFolder,
        active_fitness: float | None,
        history: Iterable[Sequence[float | None]],
    ) -> None:
        self._folder = folder
        self._active_fitness = active_fitness
        self._convergence = Convergence(history)
        self._reported_at = 0.0

    def __call__(self, progress: FitProgress) -> None:
        self._convergence.add(progress.evaluations, progress.best_fitness)
        if (
            time.monotonic() - self._reported_at < PROGRESS_EVERY_WALL_S
            and progress.phase != "done"
        ):
            return
        self._reported_at = time.monotonic()
        fitness = progress.best_fitness
        self._folder.write_progress(
            Progress(
                # The gates take the last part of the bar.
                fraction=_FIT_SHARE * progress.fraction,
                phase="gates" if progress.phase == "done" else progress.phase,
                evaluations=progress.evaluations,
                best_fitness=fitness if math.isfinite(fitness) else None,
                active_fitness=self._active_fitness,
                convergence=self._convergence.points,
            )
        )
