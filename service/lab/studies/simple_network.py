"""Study ``simple-network``: the paper's inverse problem of section 5.1 (figure 8).

Seven parameters of the five-node network from noise-free temperatures of two nodes. Model and data
share their equations, as in the paper; what an identification is worth on a real bench is shown by
the other studies.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from service.lab.studies.common import Options, Plot, Progress, Report, Table, figure
from service.lab.studies.inverse import (
    TOLERANCE,
    Best,
    CountedSearch,
    FloatArray,
    InverseProblem,
    simple_network_problem,
)
from service.lab.studies.methods import METHODS
from service.lab.studies.methods import run as run_method

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAME = "simple-network"
SEED = 0
_NOISE_K = 0.1
_DIFFERENCE = 1e-4


def run(progress: Progress, _: Options) -> Report:
    """Identify with the default method and, as the paper does, with NOA alone."""
    problem = simple_network_problem()
    found = _search(problem, "noa+refine")
    progress(0.1, "noa+refine")
    alone = _search(problem, "noa")
    progress(0.9, "noa alone")
    spread, condition = identifiability(problem)
    identified, noa_identified = found.trace[-1].values, alone.trace[-1].values
    names = problem.model.parameters.names
    document = {
        "study": NAME,
        "method": "noa+refine",
        "settings": METHODS["noa+refine"].settings,
        "seed": SEED,
        "parameters": {
            name: {
                "target": float(target),
                "identified": float(value),
                "noa_alone": float(noa_value),
                "std_at_0.1_k_noise": float(target * relative),
            }
            for name, target, value, noa_value, relative in zip(
                names, problem.targets, identified, noa_identified, spread, strict=True
            )
        },
        "evaluations": found.evaluations,
        "evaluations_to_1_percent": found.reached,
        "seconds": found.trace[-1].seconds,
        "noa_alone": {
            "settings": METHODS["noa"].settings,
            "evaluations_to_1_percent": alone.reached,
            "seconds_to_1_percent": _seconds_at(alone),
        },
        "rms_error_k": float(np.sqrt(np.mean(problem.residuals_of(identified) ** 2))),
        "condition": condition,
        "paper": {"identified": "near-complete agreement with the targets, no figures printed"},
    }
    rows = [
        (
            name,
            f"{target:g}",
            f"{value:.6g} ({100 * (value / target - 1):+.4f} %)",
            f"{noa_value:.4g} ({100 * (noa_value / target - 1):+.2f} %)",
            f"{100 * relative:.1f} %",
        )
        for name, target, value, noa_value, relative in zip(
            names, problem.targets, identified, noa_identified, spread, strict=True
        )
    ]
    table = Table(
        "Simple network: seven parameters from noise-free data",
        ("", "paper's target", "noa+refine", "NOA alone", "std. dev. at 0.1 K noise"),
        tuple(rows),
        (
            f"noa+refine ({METHODS['noa+refine'].settings}): all within 1 % after {found.reached} "
            f"evaluations, ended by itself after {found.evaluations} and "
            f"{document['seconds']:.2f} s.",
            f"NOA alone ({METHODS['noa'].settings}): {_reached(alone)}; at the end the errors "
            "above. The paper: the per-unit values approach unity, no figures printed.",
            f"Condition of the sensitivities {condition:.0f}: with real noise k5, k6 and k7 cannot "
            "be had to 1 %, whatever the optimiser.",
        ),
    )
    plot = Plot(
        "fig08-convergence", partial(_draw, names, problem.targets, alone.trace, found.trace)
    )
    return Report(NAME, document, (table,), (plot,))


def identifiability(problem: InverseProblem) -> tuple[FloatArray, float]:
    """Relative standard deviations (p,) with 0.1 K of white noise, and the condition number.

    Linearised at the targets, in the logarithm of the parameters.
    """
    steps = _DIFFERENCE * np.concatenate((np.eye(problem.dimensions), -np.eye(problem.dimensions)))
    moved = problem.residuals_of(problem.targets * np.exp(steps))
    jacobian = (moved[: problem.dimensions] - moved[problem.dimensions :]).T / (2 * _DIFFERENCE)
    covariance = _NOISE_K**2 * np.linalg.inv(jacobian.T @ jacobian)
    return np.sqrt(np.diag(covariance)), float(np.linalg.cond(jacobian))


def _search(problem: InverseProblem, method: str) -> CountedSearch:
    search = CountedSearch(problem, METHODS[method].budget, stop_at_target=False)
    run_method(METHODS[method], search, SEED)
    return search


def _seconds_at(search: CountedSearch) -> float | None:
    for best in search.trace:
        if best.evaluations == search.reached:
            return best.seconds
    return None


def _reached(search: CountedSearch) -> str:
    if search.reached is None:
        return "not all within 1 %"
    return f"all within 1 % after {search.reached} evaluations"


def _draw(
    names: Sequence[str],
    targets: FloatArray,
    alone: Sequence[Best],
    found: Sequence[Best],
) -> "Figure":
    """Figure 8 of the paper, for NOA alone and for the default method."""
    drawn = figure(11.0, 4.5)
    left, right = drawn.subplots(1, 2, sharey=True)
    for axes, trace, title in ((left, alone, "NOA alone"), (right, found, "NOA, then refinement")):
        _draw_trace(axes, names, targets, trace)
        axes.set_title(title)
    left.set_ylabel("best value so far / target")
    right.legend(ncols=7, loc="lower right", columnspacing=0.8, handlelength=1.0)
    return drawn


def _draw_trace(
    axes: "Axes", names: Sequence[str], targets: FloatArray, trace: Sequence[Best]
) -> None:
    count = [best.evaluations for best in trace]
    relative = np.array([best.values for best in trace]) / targets
    for column, name in enumerate(names):
        axes.step(count, relative[:, column], where="post", label=name)
    axes.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color="0.85", zorder=0)
    axes.set_xscale("log")
    axes.set_xlim(10, None)
    axes.set_yscale("log")
    axes.set_xlabel("simulations")
    axes.grid(alpha=0.3)
