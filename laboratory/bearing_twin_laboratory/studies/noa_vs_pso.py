"""Study ``noa-vs-pso``: how many simulations each optimiser needs (section 5.1, figure 9).

The paper compares one run of NOA with one of PSO by the seconds until k4 is accurate enough. Here
every method runs from twenty seeds, with one more question asked of all: the simulations until all
seven parameters are within 1 %. Seconds depend on a machine and on a library's bookkeeping;
simulations do not, so they carry the comparison.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from bearing_twin_laboratory.studies.inverse import (
    TOLERANCE,
    CountedSearch,
    FloatArray,
    simple_network_problem,
)
from bearing_twin_laboratory.studies.methods import METHODS
from bearing_twin_laboratory.studies.methods import run as run_method
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Options,
    Study,
    Table,
    cell,
    figure,
    named,
    table,
    text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RUNS = 20
QUICK_RUNS = 2
PAPER_NOA_S = 103.0
PAPER_PSO_S = 1045.0

_K4 = 3
_HALF = 0.5

K4Event = Literal["k4_first", "k4_for_good"]


@dataclass(frozen=True, slots=True)
class Task:
    """One method from one seed."""

    method: str
    seed: int
    budget: int


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What one method did from one seed.

    - ``method``, ``seed``, ``budget``: as asked.
    - ``reached``: simulations until all seven parameters were within 1 %, or None.
    - ``k4_first``, ``k4_for_good``: simulations until k4 was within 1 % for the first time, and
      from which on it stayed so; None if never.
    - ``seconds``: until the target or the end.
    - ``k4``: (improvements, 2) simulations and k4 relative to its target at every new best.
    """

    method: str
    seed: int
    budget: int
    reached: int | None
    k4_first: int | None
    k4_for_good: int | None
    seconds: float
    k4: FloatArray


def cases(options: Options) -> list[Task]:
    """All methods from all seeds, the longest first: no processor waits long for the last one."""
    order = sorted(METHODS, key=lambda name: -METHODS[name].budget)
    runs = QUICK_RUNS if options.quick else RUNS
    return [Task(name, seed, METHODS[name].budget) for seed in range(runs) for name in order]


def search(task: Task) -> Run:
    """Run one method from one seed until the target or the end of its budget."""
    problem = simple_network_problem()  # compiled before the clock starts
    counted = CountedSearch(problem, task.budget)
    run_method(METHODS[task.method], counted, task.seed)
    target = problem.targets[_K4]
    k4 = np.array([(best.evaluations, best.values[_K4] / target) for best in counted.trace])
    return Run(
        task.method,
        task.seed,
        task.budget,
        counted.reached,
        *counted.within(_K4),
        counted.seconds,
        k4,
    )


def figures_of(runs: Sequence[Run]) -> Document:
    """Figures of all methods, and how PSO compares with NOA."""
    # A best point that is still far from the target passes k4's by chance, again and again.
    ratio, is_bound = ratio_of_k4(runs, "k4_for_good")
    first_ratio, first_is_bound = ratio_of_k4(runs, "k4_first")
    seeds = sorted({run.seed for run in runs})
    return {
        "runs": len(seeds),
        "seeds": seeds,
        "success": "all 7 parameters of the best point within 1 % of their targets",
        "methods": {name: summary([run for run in runs if run.method == name]) for name in METHODS},
        "ratio_pso_over_noa": ratio,
        "ratio_is_lower_bound": is_bound,
        "ratio_of": "median simulations from which on k4 of the best point is within 1 %",
        "ratio_first_time": first_ratio,
        "ratio_first_time_is_lower_bound": first_is_bound,
        "paper": {
            "noa_seconds": PAPER_NOA_S,
            "pso_seconds": PAPER_PSO_S,
            "ratio_pso_over_noa": PAPER_PSO_S / PAPER_NOA_S,
        },
    }


def tables(runs: Sequence[Run], document: Document) -> Iterator[Table]:
    """All methods."""

    def count(name: str) -> Callable[[Document], str]:
        return lambda row: f"over {row['budget']}" if row[name] is None else f"{row[name]:.0f}"

    yield table(
        f"NOA against other optimisers, simple network, {document['runs']} seeds",
        named(document["methods"]),
        (
            ("method", cell("name")),
            ("solved", lambda row: f"{row['success_rate']:.0%}"),
            ("simulations", count("median_evaluations")),
            ("most", count("max_evaluations")),
            ("seconds", cell("median_seconds", text)),
            ("k4 within 1 %", count("k4_first_median")),
            ("for good", count("k4_for_good_median")),
        ),
        f"Until k4 is within 1 % for good PSO needs "
        f"{_times(document['ratio_pso_over_noa'], document['ratio_is_lower_bound'])} the "
        f"simulations of NOA. The paper, in seconds, one run each: {PAPER_NOA_S:.0f} s against "
        f"{PAPER_PSO_S:.0f} s, {_times(PAPER_PSO_S / PAPER_NOA_S, False)}. The first time, "
        "which may be by chance: "
        f"{_times(document['ratio_first_time'], document['ratio_first_time_is_lower_bound'])}.",
        "Solved: all seven parameters of the best point within 1 %. Medians, and the most of "
        "any run; a run that fails counts with its budget. Every simulation counts, those of "
        "finite differences too.",
        "Searched by all: the logarithms of the parameters, and instead of k6 the resistance "
        "at 3000 rpm that it makes with k7, because the two hide each other.",
        "Settings: "
        + "; ".join(f"{name}: {method.settings}" for name, method in METHODS.items())
        + ". T of NOA is its budget and its schedule at once.",
    )


def plots(runs: Sequence[Run], document: Document) -> dict[str, Drawing]:
    """Figure 9 of the paper."""
    return {"fig09-noa-vs-pso": partial(_draw, runs)}


def summary(runs: Sequence[Run]) -> dict[str, object]:
    """Figures of one method over its seeds; None where more than half of the runs failed."""
    budget = runs[0].budget
    reached = np.array([run.budget if run.reached is None else run.reached for run in runs])
    success = float(np.mean([run.reached is not None for run in runs]))
    facts = {
        "success_rate": success,
        "median_evaluations": float(np.median(reached)) if success >= _HALF else None,
        "max_evaluations": int(np.max(reached)) if success >= _HALF else None,
        "median_seconds": float(np.median([run.seconds for run in runs])),
    }
    for name in get_args(K4Event):
        share = float(np.mean([getattr(run, name) is not None for run in runs]))
        facts[f"{name}_rate"] = share
        facts[f"{name}_median"] = float(np.median(_until(runs, name))) if share >= _HALF else None
    return {
        **facts,
        "budget": budget,
        "settings": METHODS[runs[0].method].settings,
    }


def ratio_of_k4(runs: Sequence[Run], event: K4Event) -> tuple[float, bool]:
    """Simulations of PSO over those of NOA until an event of k4, medians.

    Returns
    -------
    ratio : float
        A run that never gets there counts with its budget.
    is_bound : bool
        Whether that happens to at least half of PSO's runs, so that the true ratio is larger.
    """
    noa = [run for run in runs if run.method == "noa"]
    pso = [run for run in runs if run.method == "pso"]
    never = float(np.mean([getattr(run, event) is None for run in pso]))
    return float(np.median(_until(pso, event)) / np.median(_until(noa, event))), never >= _HALF


def _until(runs: Sequence[Run], event: K4Event) -> FloatArray:
    counts = [getattr(run, event) for run in runs]
    return np.array(
        [
            float(run.budget if count is None else count)
            for run, count in zip(runs, counts, strict=True)
        ]
    )


def _times(ratio: float, is_bound: bool) -> str:
    return f"{'more than ' if is_bound else ''}{ratio:.1f} times"


def _draw(runs: Sequence[Run]) -> "Figure":
    """Figure 9 of the paper, all seeds; and how the share of solved runs grows."""
    drawn = figure(12.0, 4.5)
    left, right = drawn.subplots(1, 2)
    _draw_k4(left, runs)
    _draw_solved(right, runs)
    for axes in (left, right):
        axes.set(xscale="log", xlabel="simulations")
        axes.grid(alpha=0.3)
    left.set_xlim(300, None)
    right.set_xlim(50, None)
    return drawn


def _draw_k4(axes: "Axes", runs: Sequence[Run]) -> None:
    for method, colour in (("pso", "tab:orange"), ("noa", "tab:blue")):
        for number, one in enumerate(run for run in runs if run.method == method):
            end = one.budget if one.reached is None else one.reached
            axes.step(
                np.append(one.k4[:, 0], end),
                np.append(one.k4[:, 1], one.k4[-1, 1]),
                where="post",
                color=colour,
                alpha=0.5,
                linewidth=0.8,
                label=method.upper() if number == 0 else None,
            )
    axes.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color="0.85", zorder=0)
    axes.set_ylabel("k4 of the best point / target")
    axes.set_ylim(0.7, 1.3)
    axes.legend(loc="upper right")


def _draw_solved(axes: "Axes", runs: Sequence[Run]) -> None:
    longest = max(run.budget for run in runs)
    for name in METHODS:
        own = [run for run in runs if run.method == name]
        ends = sorted(run.reached for run in own if run.reached is not None)
        share = [100.0 * number / len(own) for number in range(len(ends) + 1)]
        axes.step([1, *ends, longest], [*share, share[-1]], where="post", label=name)
    axes.set_ylabel("runs with all 7 within 1 %, in %")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


STUDY = Study("noa-vs-pso", cases, search, figures_of, tables, plots, libraries=("pymoo", "cma"))
