"""Identification from start to end: global search, refinement, posterior, verdict on the fit."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.data import IdentificationData
from twin_core.identification.noa import Nutcracker
from twin_core.identification.posterior import Posterior, posterior_at
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled, refine
from twin_core.models import ThermalModel

FloatArray = NDArray[np.float64]
Method = Literal["noa+refine", "noa", "refine"]
Phase = Literal["search", "refinement", "sampling", "done"]
Status = Literal["converged", "failed fit"]

DEFAULT_BUDGET = 1000
"""Simulations of the data set that the global search of ``noa+refine`` and ``noa`` may take."""

DEFAULT_SAMPLES = 200
"""Posterior samples, as many as a forecast has members."""

# The global search looks where the prior has practically all its mass.
_SEARCH_Z = 3.0
_RANDOM_START_SD = 0.5
_WORST_RMS_K = 0.5
_WORST_COST = 2.0
_SEARCH_SHARE = 0.4
_REFINED_SHARE = 0.8
_RESERVE_ITERATIONS = 25


@dataclass(frozen=True, slots=True)
class Progress:
    """How far an identification has come.

    Attributes
    ----------
    fraction
        0 to 1, never falls.
    phase
        ``"search"``, ``"refinement"``, ``"sampling"`` or ``"done"``.
    evaluations
        Simulations of the data set so far.
    best_fitness
        Smallest sum of squared residuals so far; infinite before the first.
    """

    fraction: float
    phase: Phase
    evaluations: int
    best_fitness: float


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationResult:
    """What an identification found.

    Attributes
    ----------
    posterior
        Most probable parameters and their uncertainty.
    status, reason
        ``"converged"``, or ``"failed fit"`` with the reason; a failed fit must not forecast.
    history
        (evaluations, best sum of squares) over the run.
    evaluations
        Simulations of the data set, finite differences included.
    best_fitness
        Sum of squared residuals at the end, priors included.
    starts
        Cost that each refinement reached, by name of its start.
    unknowns
        (d,) parameters, lag and initial states, for further use with the same data.
    """

    posterior: Posterior
    status: Status
    reason: str
    history: tuple[tuple[int, float], ...]
    evaluations: int
    best_fitness: float
    starts: dict[str, float]
    unknowns: FloatArray


def identify(
    model: ThermalModel,
    data: IdentificationData,
    *,
    method: Method = "noa+refine",
    budget: int = DEFAULT_BUDGET,
    seed: int = 0,
    guess_z: FloatArray | None = None,
    samples: int = DEFAULT_SAMPLES,
    progress: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> IdentificationResult:
    """Identify a model's parameters from low-risk windows.

    Parameters
    ----------
    model
        What is identified.
    data
        Windows of measured rows.
    method
        ``"noa+refine"``: the nutcracker search, then bounded least squares from its best point,
        from the prior's centre and from a random point near it. ``"refine"``: without the search
        but with one more random start. ``"noa"``: the search alone.
    budget
        Evaluations of the search, at least 25; not used by ``"refine"``.
    seed
        Same seed, same result.
    guess_z
        (p,) a known good guess, such as the active model's; a further start of the refinement.
    samples
        Even number of posterior samples; 0 for none, where only the optimum matters.
    progress
        Called at every sweep and iteration.
    cancelled
        Asked at every sweep and iteration.

    Raises
    ------
    IdentificationCancelled
        When ``cancelled`` says so.
    ValueError
        For an unknown method, too small a budget, or a sensor that the model does not have.
    """
    if method not in get_args(Method):
        raise ValueError(f"method is {method!r}, expected one of {', '.join(get_args(Method))}")
    run = _Run(IdentificationProblem(model, data, guess_z), progress, cancelled)
    rng = np.random.default_rng(seed)
    p = model.parameters.size
    starts: dict[str, FloatArray] = {}
    if method != "refine":
        starts["search"] = _search(
            run, budget, seed, _SEARCH_SHARE if "+" in method else _REFINED_SHARE
        )
    starts["prior"] = np.zeros(p)
    if guess_z is not None:
        starts["guess"] = guess_z
    for number in range(2 if method == "refine" else 1):
        starts[f"random {number + 1}"] = rng.normal(0.0, _RANDOM_START_SD, p)
    if method == "noa":
        best = run.problem.with_nuisance(starts["search"])
        costs = {"search": run.best}
    else:
        best, costs = _refine_all(run, starts)
    run.tell(run.fraction, "sampling")
    posterior = posterior_at(run.problem, best, samples, seed)
    reason = fit_problem(posterior)
    run.tell(1.0, "done")
    return IdentificationResult(
        posterior=posterior,
        status="failed fit" if reason else "converged",
        reason=reason or _describe(posterior),
        history=tuple(run.history),
        evaluations=run.problem.evaluations,
        best_fitness=run.best,
        starts=costs,
        unknowns=best,
    )


def fit_problem(posterior: Posterior) -> str:
    """Say why a fit must not forecast; empty if nothing is wrong with it."""
    for name, rms in posterior.train_rms_k.items():
        if not rms <= _WORST_RMS_K:
            return f"{name} is met with {rms:.2f} K rms only, expected at most {_WORST_RMS_K} K"
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


@dataclass(slots=True, eq=False)
class _Run:
    """Book-keeping of one identification: best cost, history, progress, cancellation."""

    problem: IdentificationProblem
    progress: Callable[[Progress], None] | None
    cancelled: Callable[[], bool] | None
    best: float = float("inf")
    fraction: float = 0.0
    history: list[tuple[int, float]] = field(default_factory=list)

    def tell(self, fraction: float, phase: Phase, cost: float = float("inf")) -> None:
        if cost < self.best or not self.history:
            self.best = min(self.best, cost)
            self.history.append((self.problem.evaluations, self.best))
        self.fraction = max(self.fraction, min(fraction, 1.0))
        if self.progress is not None:
            self.progress(Progress(self.fraction, phase, self.problem.evaluations, self.best))
        if phase != "done" and self.cancelled is not None and self.cancelled():
            raise IdentificationCancelled


def _search(run: _Run, budget: int, seed: int, share: float) -> FloatArray:
    """Global search in the unit box over the prior's coordinates; returns the best (p,)."""
    problem = run.problem
    p = problem.parameter_count
    lower = np.maximum(problem.lower[:p], -_SEARCH_Z)
    width = np.minimum(problem.upper[:p], _SEARCH_Z) - lower
    search = Nutcracker(np.zeros(p), np.ones(p), budget=budget, seed=seed)
    while not search.finished:
        search.tell(problem.costs(lower + width * search.ask()))
        run.tell(share * search.evaluations / budget, "search", search.best_fitness)
    return np.asarray(lower + width * search.best_position)


def _refine_all(run: _Run, starts: dict[str, FloatArray]) -> tuple[FloatArray, dict[str, float]]:
    """Refine from every start; returns the best unknowns and the cost that each reached."""
    problem = run.problem
    begun = run.fraction
    best, costs = np.zeros(0), {}
    for number, (name, z) in enumerate(starts.items()):
        done = 0

        def on_iteration(cost: float, number: int = number) -> None:
            nonlocal done
            done += 1
            within = min(done / _RESERVE_ITERATIONS, 1.0)
            run.tell(
                begun + (_REFINED_SHARE - begun) * (number + within) / len(starts),
                "refinement",
                cost,
            )

        refined = refine(
            problem,
            problem.with_nuisance(z),
            on_iteration=on_iteration,
            cancelled=run.cancelled,
        )
        costs[name] = float("inf") if refined is None else refined.cost
        if refined is not None and (best.size == 0 or refined.cost <= min(costs.values())):
            best = refined.unknowns
            run.tell(run.fraction, "refinement", refined.cost)
    if best.size == 0:
        raise ValueError("the simulation fails at every start: are speed, load and ambient sound?")
    return best, costs
