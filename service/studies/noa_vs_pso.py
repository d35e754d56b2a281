"""Study ``noa-vs-pso``: how many simulations each optimiser needs (section 5.1, figure 9).

The paper compares one run of NOA with one of PSO by the seconds until k4 is accurate enough. Here
every method runs from twenty seeds, with one more question asked of all: the simulations until all
seven parameters are within 1 %. Seconds depend on a machine and on a library's bookkeeping;
simulations do not, so they carry the comparison.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from service.studies.common import Plot, Progress, Report, Table, figure, in_processes, require
from service.studies.inverse import (
    TOLERANCE,
    CountedSearch,
    FloatArray,
    simple_network_problem,
)
from service.studies.methods import METHODS
from service.studies.methods import run as run_method

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "noa-vs-pso"
RUNS = 20
PAPER_NOA_S = 103.0
PAPER_PSO_S = 1045.0

_K4 = 3
_MOST_FAIL = 0.5


@dataclass(frozen=True, slots=True)
class Task:
    """One method from one seed."""

    method: str
    seed: int
    budget: int


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What one method did from one seed.

    Parameters
    ----------
    method, seed, budget
        As asked.
    reached
        Simulations until all seven parameters were within 1 %, or None.
    k4_settled
        Simulations from which on k4 stayed within 1 %, or None.
    seconds
        Until the target or the end.
    k4
        (improvements, 3) simulations, seconds and k4 relative to its target at every new best.
    """

    method: str
    seed: int
    budget: int
    reached: int | None
    k4_settled: int | None
    seconds: float
    k4: FloatArray


def run(progress: Progress) -> Report:
    """Compare all methods from twenty seeds each."""
    require("pymoo", "cma")
    # The longest first, so that no processor waits long for the last one.
    order = sorted(METHODS, key=lambda name: -METHODS[name].budget)
    tasks = [Task(name, seed, METHODS[name].budget) for seed in range(RUNS) for name in order]
    return report(in_processes(search, tasks, progress))


def search(task: Task) -> Run:
    """Run one method from one seed until the target or the end of its budget."""
    problem = simple_network_problem()  # compiled before the clock starts
    counted = CountedSearch(problem, task.budget)
    run_method(METHODS[task.method], counted, task.seed)
    target = problem.targets[_K4]
    k4 = np.array(
        [(best.evaluations, best.seconds, best.values[_K4] / target) for best in counted.trace]
    )
    return Run(
        task.method,
        task.seed,
        task.budget,
        counted.reached,
        counted.settled(_K4),
        counted.seconds,
        k4,
    )


def report(runs: Sequence[Run]) -> Report:
    """Put runs together into figures, table and plot."""
    methods = {name: summary([run for run in runs if run.method == name]) for name in METHODS}
    noa, pso = methods["noa"], methods["pso"]
    ratio, is_bound = ratio_of_k4(runs)
    seeds = sorted({run.seed for run in runs})
    document = {
        "study": NAME,
        "runs": len(seeds),
        "seeds": seeds,
        "success": "all 7 parameters of the best point within 1 % of their targets",
        "methods": methods,
        "ratio_pso_over_noa": ratio,
        "ratio_is_lower_bound": is_bound,
        "ratio_of": "median simulations until k4 is within 1 % for good",
        "paper": {
            "noa_seconds": PAPER_NOA_S,
            "pso_seconds": PAPER_PSO_S,
            "ratio_pso_over_noa": PAPER_PSO_S / PAPER_NOA_S,
        },
    }
    table = Table(
        f"NOA against other optimisers, simple network, {len(seeds)} seeds",
        (
            "method",
            "all within 1 %",
            "simulations, median",
            "most",
            "seconds, median",
            "k4 within 1 %, median",
            "settings",
        ),
        tuple(_row(name, facts) for name, facts in methods.items()),
        (
            f"PSO needs {'more than ' if is_bound else ''}{ratio:.1f} times the simulations of NOA "
            f"until k4 is within 1 % for good (NOA {noa['k4_median_evaluations']:.0f}, PSO "
            f"{'none of most runs within ' if is_bound else ''}"
            f"{pso['budget'] if is_bound else pso['k4_median_evaluations']:.0f}). The paper, one "
            f"run each: {PAPER_NOA_S:.0f} s against {PAPER_PSO_S:.0f} s, "
            f"{PAPER_PSO_S / PAPER_NOA_S:.1f} times.",
            "A run that fails counts with its budget. Every simulation counts, those of finite "
            "differences too. T of NOA is its budget and its schedule at once.",
        ),
    )
    return Report(NAME, document, (table,), (Plot("fig09-noa-vs-pso", partial(_draw, runs)),))


def summary(runs: Sequence[Run]) -> dict[str, Any]:
    """Figures of one method over its seeds; None where more than half of the runs failed."""
    budget = runs[0].budget
    reached = np.array([run.budget if run.reached is None else run.reached for run in runs])
    settled = _settled(runs)
    success = np.mean([run.reached is not None for run in runs])
    k4_success = np.mean([run.k4_settled is not None for run in runs])
    known, k4_known = success >= _MOST_FAIL, k4_success >= _MOST_FAIL
    return {
        "success_rate": float(success),
        "median_evaluations": float(np.median(reached)) if known else None,
        "max_evaluations": int(np.max(reached)) if known else None,
        "median_seconds": float(np.median([run.seconds for run in runs])),
        "k4_success_rate": float(k4_success),
        "k4_median_evaluations": float(np.median(settled)) if k4_known else None,
        "budget": budget,
        "settings": METHODS[runs[0].method].settings,
    }


def ratio_of_k4(runs: Sequence[Run]) -> tuple[float, bool]:
    """Simulations of PSO over those of NOA until k4 is within 1 % for good, medians.

    Returns
    -------
    ratio : float
        A PSO run that never gets there counts with its budget.
    is_bound : bool
        Whether that happens to the median run, so that the true ratio is larger.
    """
    noa = [run for run in runs if run.method == "noa"]
    pso = [run for run in runs if run.method == "pso"]
    never = np.mean([run.k4_settled is None for run in pso]) >= 1 - _MOST_FAIL
    return float(np.median(_settled(pso)) / np.median(_settled(noa))), bool(never)


def _settled(runs: Sequence[Run]) -> FloatArray:
    return np.array(
        [float(run.budget if run.k4_settled is None else run.k4_settled) for run in runs]
    )


def _row(name: str, facts: dict[str, Any]) -> tuple[str, ...]:
    return (
        name,
        f"{facts['success_rate']:.0%}",
        _count(facts["median_evaluations"], facts["budget"]),
        _count(facts["max_evaluations"], facts["budget"]),
        f"{facts['median_seconds']:.2f}",
        _count(facts["k4_median_evaluations"], facts["budget"]),
        facts["settings"],
    )


def _count(value: float | None, budget: int) -> str:
    return f"over {budget}" if value is None else f"{value:.0f}"


def _draw(runs: Sequence[Run]) -> "Figure":
    """Figure 9 of the paper, all seeds; and how the shares of solved runs grow."""
    drawn = figure(12.0, 4.5)
    left, right = drawn.subplots(1, 2)
    for method, colour in (("pso", "tab:orange"), ("noa", "tab:blue")):
        for number, one in enumerate(run for run in runs if run.method == method):
            end = one.budget if one.reached is None else one.reached
            left.step(
                np.append(one.k4[:, 0], end),
                np.append(one.k4[:, 2], one.k4[-1, 2]),
                where="post",
                color=colour,
                alpha=0.5,
                linewidth=0.8,
                label=method.upper() if number == 0 else None,
            )
    left.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color="0.85", zorder=0)
    left.set(xscale="log", xlabel="simulations", ylabel="k4 of the best point / target")
    left.set_ylim(0.5, 1.5)
    left.legend()
    for name in METHODS:
        ends = sorted(run.reached for run in runs if run.method == name and run.reached is not None)
        count = sum(run.method == name for run in runs)
        longest = max(run.budget for run in runs)
        share = [100 * (k + 1) / count for k in range(len(ends))]
        right.step(
            [1, *ends, longest], [0, *share, share[-1] if share else 0], where="post", label=name
        )
    right.set(xscale="log", xlabel="simulations", ylabel="runs with all 7 within 1 %, in %")
    right.set_xlim(50, None)
    right.legend()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return drawn
