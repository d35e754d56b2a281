"""Identification from start to end: global search, refinement, posterior, verdict on the fit."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.checkpoint import Checkpoint
from twin_core.identification.data import IdentificationData
from twin_core.identification.noa import Nutcracker
from twin_core.identification.posterior import Posterior, posterior_at
from twin_core.identification.preload import preload_warning
from twin_core.identification.priors import NormalPrior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled, refine
from twin_core.identification.searching import IdentificationSpace, Search, SearchEnd
from twin_core.identification.stopping import BUDGET_ONLY, StoppingCriteria, run_search
from twin_core.identification.whitening import Loss
from twin_core.models import ThermalModel
from twin_core.network_model import ErrorModel

FloatArray = NDArray[np.float64]
Method = Literal["noa+refine", "noa", "refine"]
Phase = Literal["search", "refinement", "sampling", "done"]
Status = Literal["converged", "failed fit"]

DEFAULT_BUDGET = 1000
"""Evaluations of the global search that a refinement follows."""

SEARCH_ALONE_BUDGET = 20_000
"""Evaluations of a global search that has to finish without a refinement."""

DEFAULT_SAMPLES = 200
"""Posterior samples, as many as a forecast has members."""

Save = Callable[[Callable[[], dict[str, Any]]], None]
"""Called with a function that returns the checkpoint, so that what is not kept costs nothing."""

_RANDOM_START_SD = 0.5
_WORST_RMS_K = 0.5
_WORST_COST = 2.0
_SEARCH_SHARE = 0.4
_REFINED_SHARE = 0.8
_RESERVE_ITERATIONS = 25


@dataclass(frozen=True, slots=True)
class IdentificationProgress:
    """How far an identification has come."""

    fraction: float  # 0 to 1, never falls
    phase: Phase  # ``"search"``, ``"refinement"``, ``"sampling"`` or ``"done"``
    evaluations: int  # simulations of the data set so far
    best_fitness: float  # smallest sum of squared residuals so far; infinite before the first


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationResult:
    """What an identification found."""

    posterior: Posterior  # most probable parameters and their uncertainty
    #: ``"converged"``, or ``"failed fit"`` with the reason; a failed fit must not forecast.
    status: Status
    reason: str
    #: (evaluations, best sum of squares) over the run; in the search with lag and initial states
    #: linearised.
    history: tuple[tuple[int, float], ...]
    #: Simulations of the data set. One that gives its derivatives as well counts as one; it takes
    #: as long as some seven (default model) or four (paper's).
    evaluations: int
    best_fitness: float  # sum of squared residuals at the end, priors included
    starts: dict[str, float]  # cost that each refinement reached, by name of its start
    #: (d,) parameters, lag and initial states, for further use with the same data.
    unknowns: FloatArray


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How parameters are searched and refined."""

    #: ``"noa+refine"``: the nutcracker search, then bounded least squares from its best point, from
    #: the prior's centre and from a random point near it. ``"refine"``: without the search but with
    #: one more random start. ``"noa"``: the search alone.
    method: Method = "noa+refine"
    #: Evaluations of the search, at least 25; by default `default_budget`. Not used by
    #: ``"refine"``.
    budget: int | None = None
    seed: int = 0  # same seed, same result
    #: Even number of posterior samples; 0 for none, where only the optimum matters.
    samples: int = DEFAULT_SAMPLES
    search: Search | None = None  # another global search in NOA's place
    #: What ends the nutcracker search before its budget is used up.
    stopping: StoppingCriteria = BUDGET_ONLY
    loss: Loss = "linear"  # of the measurements; a robust one keeps outliers from bending the fit

    @property
    def evaluations(self) -> int:
        """Evaluations that the search may take."""
        return default_budget(self.method) if self.budget is None else self.budget


def identify(
    model: ThermalModel,
    data: IdentificationData,
    fit: FitSettings = FitSettings(),
    *,
    guess_z: FloatArray | None = None,
    warm: bool = False,
    prior: NormalPrior | None = None,
    progress: Callable[[IdentificationProgress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    save: Save | None = None,
    resume: Mapping[str, Any] | None = None,
) -> IdentificationResult:
    """Identify a model's parameters from low-risk windows.

    Parameters
    ----------
    guess_z
        (p,) a known good guess, such as the active model's; a further start of the refinement.
    warm
        Refine from the guess alone: a twentieth of the work where the machine has hardly changed
        since the guess; where it has, it may end in another optimum than the best. With a guess and
        ``"refine"`` only.
    prior
        Of the parameters, such as sisters give; the literature's by default. The search still looks
        through the literature's box, the other starts are taken around this prior's mean.
    progress, cancelled
        Called at every sweep and iteration.
    save
        Called after every sweep of the nutcracker search and every refined start.
    resume
        A checkpoint that `save` was given: the identification goes on from there and ends as if it
        had not been interrupted, bit for bit.

    Raises
    ------
    IdentificationCancelled
        When ``cancelled`` says so.
    CheckpointMismatchError
        If the checkpoint belongs to another identification.
    ValueError
        For an unknown method, too small a budget, or a sensor that the model does not have.
    """
    if fit.method not in get_args(Method):
        raise ValueError(f"method is {fit.method!r}, expected one of {', '.join(get_args(Method))}")
    if warm and (fit.method != "refine" or guess_z is None):
        raise ValueError(f"warm with method {fit.method!r}: expected 'refine' and a guess")
    problem = IdentificationProblem(model, data, guess_z, fit.loss, prior=prior)
    state = Checkpoint(_order(problem, fit, guess_z, warm))
    if resume is not None:
        state = Checkpoint.from_dict(resume, state.order)
        problem.evaluations = state.evaluations
    run = _Run(problem, state, progress, cancelled, save)
    starts: dict[str, FloatArray] = {}
    if fit.method != "refine":
        starts["search"] = _searched(run, fit)
    starts |= _refinement_starts(problem, fit, guess_z, warm)
    if fit.method == "noa":
        best = problem.with_nuisance(starts["search"])
        # The search's own cost has lag and initial states linearised.
        costs = {"search": float(np.sum(problem.residuals(best)[0] ** 2))}
    else:
        best, costs = _refine_all(run, starts)
    run.report(state.fraction, "sampling")
    posterior = posterior_at(problem, best, fit.samples, fit.seed)
    reason = fit_problem(posterior, model.errors)
    if reason and model.runaway is not None:
        reason += preload_warning(data)
    run.report(1.0, "done")
    return IdentificationResult(
        posterior=posterior,
        status="failed fit" if reason else "converged",
        reason=reason or _describe(posterior),
        history=tuple(state.history),
        evaluations=problem.evaluations,
        best_fitness=min(costs.values()),
        starts=costs,
        unknowns=best,
    )


def _order(
    problem: IdentificationProblem, fit: FitSettings, guess_z: FloatArray | None, warm: bool
) -> dict[str, Any]:
    """What is identified from what and how, for a checkpoint."""
    stopping, search = fit.stopping, fit.search
    return {
        "method": fit.method,
        "budget": fit.evaluations,
        "seed": fit.seed,
        "model": problem.model.name,
        "bearing": problem.model.machine,
        "guess": None if guess_z is None else guess_z.tolist(),
        "warm": warm,
        "search": None if search is None else getattr(search, "__name__", "other"),
        "stopping": [stopping.target, stopping.stagnation_sweeps, stopping.spread],
        "loss": fit.loss,
        "data_or_model": [problem.measurement_count, *_prior_costs(problem)],
    }


def _refinement_starts(
    problem: IdentificationProblem, fit: FitSettings, guess_z: FloatArray | None, warm: bool
) -> dict[str, FloatArray]:
    """Where the refinement begins besides the end of the search, (p,) by name."""
    if guess_z is not None and warm:
        return {"guess": guess_z}
    rng = np.random.default_rng(fit.seed)
    around = problem.prior
    starts = {"prior": around.mean.copy()}
    if guess_z is not None:
        starts["guess"] = guess_z
    for number in range(2 if fit.method == "refine" else 1):
        starts[f"random {number + 1}"] = around.mean + around.factor @ rng.normal(
            0.0, _RANDOM_START_SD, problem.parameter_count
        )
    return starts


def default_budget(method: Method) -> int:
    """Evaluations that the search of a method may take by default."""
    return SEARCH_ALONE_BUDGET if method == "noa" else DEFAULT_BUDGET


def _prior_costs(problem: IdentificationProblem) -> list[float | None]:
    """Costs at the prior's centre and next to it: other data or another model give other ones."""
    p = problem.parameter_count
    costs = problem.costs(np.stack((np.zeros(p), np.full(p, 0.1))))
    return [float(cost) if np.isfinite(cost) else None for cost in costs]


def fit_problem(posterior: Posterior, errors: ErrorModel) -> str:
    """Say why a fit must not forecast; empty if nothing is wrong with it."""
    worst_k = _WORST_RMS_K * errors.scale
    for name, rms in posterior.train_rms_k.items():
        if not rms <= worst_k:
            return f"{name} is met with {rms:.2f} K rms only, expected at most {worst_k:.2g} K"
    if not posterior.cost_per_residual <= _WORST_COST:
        return (
            f"mean squared whitened residual is {posterior.cost_per_residual:.2f}, expected at "
            f"most {_WORST_COST}"
        )
    return ""


def _describe(posterior: Posterior) -> str:
    rms = ", ".join(f"{name} {value:.2f} K" for name, value in posterior.train_rms_k.items())
    return (
        f"rms {rms}; {posterior.informed_combinations} of {posterior.z.size} parameter "
        "combinations informed"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One identification: its state, and who is notified of it."""

    problem: IdentificationProblem
    state: Checkpoint
    progress: Callable[[IdentificationProgress], None] | None
    cancelled: Callable[[], bool] | None
    save: Save | None

    def report(self, fraction: float, phase: Phase, cost: float = float("inf")) -> None:
        """Note a cost and the progress, pass it on, and stop if that is wanted."""
        self.note(fraction, cost)
        state = self.state
        if self.progress is not None:
            self.progress(
                IdentificationProgress(
                    state.fraction, phase, self.problem.evaluations, state.best_fitness
                )
            )
        if phase != "done" and self.cancelled is not None and self.cancelled():
            raise IdentificationCancelled

    def note(self, fraction: float, cost: float) -> None:
        """Add a new best cost to the history; the progress never falls."""
        state = self.state
        if cost < state.best_fitness or not state.history:
            state.best_fitness = min(state.best_fitness, cost)
            state.history.append((self.problem.evaluations, state.best_fitness))
        state.fraction = max(state.fraction, min(fraction, 1.0))

    def keep(self, search: Nutcracker | None = None) -> None:
        """Offer the state to be saved, with that of a search under way."""
        state = self.state
        state.evaluations = self.problem.evaluations
        if self.save is not None:
            self.save(
                lambda: (
                    state.to_dict() | {"search": None if search is None else search.state_dict()}
                )
            )


def _searched(run: _Run, fit: FitSettings) -> FloatArray:
    """Global search in the unit box over the prior's coordinates; returns the best (p,)."""
    if run.state.found_z is not None:
        return run.state.found_z
    share = _SEARCH_SHARE if "+" in fit.method else _REFINED_SHARE
    if fit.search is not None:
        found = _other_search(run, fit, share, fit.search)
    else:
        found = _nutcracker_search(run, fit, share)
    run.state.found_z = found
    run.keep()
    return found


def _nutcracker_search(run: _Run, fit: FitSettings, share: float) -> FloatArray:
    p, budget = run.problem.parameter_count, fit.evaluations
    space = IdentificationSpace(run.problem, budget)
    if run.state.search is None:
        nutcracker = Nutcracker(np.zeros(p), np.ones(p), budget=budget, seed=fit.seed)
    else:
        nutcracker = Nutcracker.from_state(run.state.search)

    def after_sweep(nutcracker: Nutcracker) -> None:
        fraction = share * nutcracker.evaluations / budget
        run.note(fraction, nutcracker.best_fitness)
        run.keep(nutcracker)
        run.report(fraction, "search")

    run_search(nutcracker, lambda unit: run.problem.costs(space.z(unit)), fit.stopping, after_sweep)
    return space.z(nutcracker.best_position)


def _other_search(run: _Run, fit: FitSettings, share: float, search: Search) -> FloatArray:
    def after_batch(space: IdentificationSpace) -> None:
        run.report(share * space.evaluations / fit.evaluations, "search", space.best_cost)

    space = IdentificationSpace(run.problem, fit.evaluations, after_batch)
    with contextlib.suppress(SearchEnd):
        search(space, fit.seed)
    return space.best_z


def _refine_all(run: _Run, starts: dict[str, FloatArray]) -> tuple[FloatArray, dict[str, float]]:
    """Refine from every start; returns the best unknowns and the cost that each reached."""
    problem, refined = run.problem, run.state.refined
    begun = _SEARCH_SHARE if "search" in starts else 0.0
    for number, (name, z) in enumerate(starts.items()):
        if name in refined:
            continue
        done = 0

        def on_iteration(cost: float, number: int = number) -> None:
            nonlocal done
            done += 1
            within = min(done / _RESERVE_ITERATIONS, 1.0)
            run.report(
                begun + (_REFINED_SHARE - begun) * (number + within) / len(starts),
                "refinement",
                cost,
            )

        end = refine(
            problem,
            problem.with_nuisance(z),
            on_iteration=on_iteration,
            cancelled=run.cancelled,
        )
        refined[name] = None if end is None else (end.cost, end.unknowns)
        if end is not None:
            run.note(run.state.fraction, end.cost)
        run.keep()
        run.report(run.state.fraction, "refinement")
    ends = [end for end in refined.values() if end is not None]
    if not ends:
        raise ValueError("the simulation fails at every start: are speed, load and ambient sound?")
    costs = {name: float("inf") if end is None else end[0] for name, end in refined.items()}
    return min(ends, key=lambda end: end[0])[1], costs
