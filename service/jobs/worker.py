"""What the background worker computes: fit, gates, scores. Runs in a process of its own."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.documents.models import DriftDocument
from service.jobs.comparison import EarlierVersion, drift_document, earlier_versions
from service.jobs.relatives import NO_RELATIVES, Relatives
from service.jobs.unit_gate import unless_in_another_unit
from service.jobs.workspace import Convergence, JobFolder, Progress
from service.site.machines.bearings import BearingSection
from service.site.machines.machine import Machine
from service.store.records import ModelVersion
from twin_core.identification.checkpoint import CheckpointMismatchError
from twin_core.identification.data import IdentificationData
from twin_core.identification.gates import GateReport, judge
from twin_core.identification.identify import (
    FitSettings,
    IdentificationProgress,
    IdentificationResult,
    Method,
    identify,
)
from twin_core.identification.posterior import Posterior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled
from twin_core.models import ThermalModel
from twin_core.naive import NaiveForecasts, fit_naive
from twin_core.sisters import (
    SisterVerdict,
    WithSisters,
    identify_with_sisters,
    part_of,
    same_run,
)
from twin_core.windows import Window, window_of

PROGRESS_EVERY_WALL_S = 0.25
CHECKPOINT_EVERY_WALL_S = 0.5
_FIT_SHARE = 0.8
# Share of the fit's progress in which the machine is identified without its sisters.
_WITHOUT_SISTERS = 0.4


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
    relatives : Relatives
        The other machines of its family.
    """

    folder: JobFolder
    machine: Machine
    data: IdentificationData
    active: Posterior
    method: Method
    seed: int
    budget: int | None
    earlier: Sequence[ModelVersion] = ()
    relatives: Relatives = NO_RELATIVES


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
    own : Posterior or None
        What the data say with the literature's prior, without samples; None where `posterior` says
        just that.
    sisters : SisterVerdict or None
        What became of the sisters; None without any.
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
    own: Posterior | None = None
    sisters: SisterVerdict | None = None


def run_identification(order: JobOrder) -> JobResult | None:
    """Identify, then let the gates decide whether the result may become active.

    Goes on from the checkpoint that a worker left which was killed with the same order. None when
    the job was cancelled.
    """
    model = order.machine.build()
    active_fitness = fitness_of(model, order.data, order.active)
    share = _WITHOUT_SISTERS if order.relatives.sisters else 1.0
    resume = order.folder.read_checkpoint()
    reporter = _ProgressReporter(order.folder, active_fitness, (resume or {}).get("history", ()))
    try:
        try:
            fit = _fit(order, model, part_of(reporter, 0.0, share), resume)
        except CheckpointMismatchError:
            # More data have come, or this is another version of the software.
            reporter = _ProgressReporter(order.folder, active_fitness, ())
            fit = _fit(order, model, part_of(reporter, 0.0, share), None)
        return assessed(
            model,
            order.data,
            fit,
            bearing=order.machine.bearing,
            active=order.active,
            active_fitness=active_fitness,
            earlier=earlier_versions(order.earlier),
            relatives=order.relatives,
            seed=order.seed,
            progress=part_of(reporter, share, 1.0),
            cancelled=lambda: is_stopped(order.folder),
        )
    except IdentificationCancelled:
        return None


def assessed(
    model: ThermalModel,
    data: IdentificationData,
    fit: IdentificationResult,
    *,
    bearing: BearingSection | None,
    active: Posterior,
    active_fitness: float | None,
    earlier: Sequence[EarlierVersion],
    relatives: Relatives = NO_RELATIVES,
    seed: int = 0,
    progress: Callable[[IdentificationProgress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> JobResult:
    """Learn from sisters, let the gates judge, and compare with earlier versions.

    Where the gates refuse what the sisters brought but not what the data say alone, that is taken.
    A drift is always one of the machine's own data: new sisters are no change of the machine.

    Parameters
    ----------
    model, data, fit
        The candidate and what it was identified from.
    bearing
        What it is a model of; None for a network of one's own.
    active, active_fitness
        Of the active model.
    earlier
        Versions that it is compared with, oldest first.
    relatives
        The other machines of the family.
    seed, progress
        Of the identification with sisters.
    cancelled
        Asked during all fits.

    Raises
    ------
    IdentificationCancelled
        When ``cancelled`` says so.
    """
    chosen, verdict, prior = fit, None, None
    if relatives.sisters or relatives.left_out:
        learned = _learned(model, data, fit, active, relatives, seed, progress, cancelled)
        chosen, verdict, prior = learned.result, learned.verdict, learned.prior
    report = judge(model, data, chosen, active=active, prior=prior, cancelled=cancelled)
    if verdict is not None and verdict.accepted and not report.accepted:
        alone = judge(model, data, fit, active=active, cancelled=cancelled)
        if alone.accepted:
            why = f"a gate refuses the model with the sisters' prior ({report.reason})"
            verdict = replace(verdict, accepted=False, reason=why, laws={})
            chosen, report = fit, alone
    report = unless_in_another_unit(report, bearing, data)
    windows = [window_of(window.minutes) for window in data.windows]
    own = replace(fit.posterior, samples=fit.posterior.samples[:0])
    return JobResult(
        posterior=chosen.posterior,
        best_fitness=chosen.best_fitness,
        active_fitness=active_fitness,
        evaluations=fit.evaluations,
        convergence=Convergence([*fit.history, (fit.evaluations, fit.best_fitness)]).points,
        windows=windows,
        gates=report,
        drift=drift_document(model, fit.posterior, windows, earlier),
        naive=fit_naive([window.minutes for window in data.windows]),
        own=None if chosen is fit else own,
        sisters=verdict,
    )


def _learned(
    model: ThermalModel,
    data: IdentificationData,
    fit: IdentificationResult,
    active: Posterior,
    relatives: Relatives,
    seed: int,
    progress: Callable[[IdentificationProgress], None] | None,
    cancelled: Callable[[], bool] | None,
) -> WithSisters:
    """Learn from the relatives that are no copies of the machine itself."""
    left_out = dict(relatives.left_out)
    for sister in relatives.sisters:
        if sister.data is not None and same_run(data, sister.data):
            left_out[sister.name] = "the same run as the data: a machine is no sister of itself"
    sisters = [one for one in relatives.sisters if one.name not in left_out]
    learned = identify_with_sisters(
        model,
        data,
        sisters,
        fit,
        FitSettings(seed=seed),
        earlier=active,
        progress=progress,
        cancelled=cancelled,
    )
    verdict = learned.verdict
    aside = left_out | dict(verdict.set_aside)
    return replace(learned, verdict=replace(verdict, set_aside=aside))


def fitness_of(model: ThermalModel, data: IdentificationData, posterior: Posterior) -> float | None:
    """Sum of squared residuals of known parameters: what an identification has to fall below."""
    [cost] = IdentificationProblem(model, data).costs(posterior.z[np.newaxis])
    return float(cost) if math.isfinite(cost) else None


def _fit(
    order: JobOrder,
    model: ThermalModel,
    progress: Callable[[IdentificationProgress], None] | None,
    resume: Mapping[str, Any] | None,
) -> IdentificationResult:
    return identify(
        model,
        order.data,
        FitSettings(method=order.method, budget=order.budget, seed=order.seed),
        progress=progress,
        cancelled=lambda: is_stopped(order.folder),
        save=_CheckpointWriter(order.folder),
        resume=resume,
    )


def is_stopped(folder: JobFolder) -> bool:
    """Return whether the job is to stop. It is asked after every step: that is the sign of life."""
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

    def __call__(self, progress: IdentificationProgress) -> None:
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
                phase="gates" if progress.fraction >= 1.0 else progress.phase,
                evaluations=progress.evaluations,
                best_fitness=fitness if math.isfinite(fitness) else None,
                active_fitness=self._active_fitness,
                convergence=self._convergence.points,
            )
        )
