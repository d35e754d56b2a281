"""Study ``simple-network``: the paper's inverse problem of section 5.1 (figure 8).

Seven parameters of the five-node network from noise-free temperatures of two nodes. Model and data
share their equations, as in the paper; what an identification is worth on a real bench is shown by
the other studies.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bearing_twin_laboratory.studies.inverse import (
    TOLERANCE,
    Best,
    CountedSearch,
    FloatArray,
    InverseProblem,
    simple_network_problem,
)
from bearing_twin_laboratory.studies.methods import METHODS
from bearing_twin_laboratory.studies.methods import run as run_method
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Study,
    Table,
    cell,
    figure,
    named,
    table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEFAULT = "noa+refine"
SEED = 0
_NOISE_K = 0.1
_DIFFERENCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What one method found: every new best point, and the simulations to 1 % and to its end."""

    trace: list[Best]
    evaluations: int
    reached: int | None

    @property
    def values(self) -> FloatArray:
        """The best parameters."""
        return self.trace[-1].values

    @property
    def seconds_at_target(self) -> float | None:
        """Seconds until all parameters were within 1 %."""
        return next((best.seconds for best in self.trace if best.evaluations == self.reached), None)


def examine(method: str) -> Found:
    """Search with one method to the end of its budget."""
    search = CountedSearch(simple_network_problem(), METHODS[method].budget, stop_at_target=False)
    run_method(METHODS[method], search, SEED)
    return Found(search.trace, search.evaluations, search.reached)


def figures_of(results: Sequence[Found]) -> Document:
    """The default method and, as the paper has it, NOA alone."""
    found, alone = results
    problem = simple_network_problem()
    spread, condition = identifiability(problem)
    return {
        "method": DEFAULT,
        "settings": METHODS[DEFAULT].settings,
        "seed": SEED,
        "parameters": {
            name: {
                "target": float(target),
                "identified": float(value),
                "noa_alone": float(noa_value),
                "std_at_0.1_k_noise": float(target * relative),
            }
            for name, target, value, noa_value, relative in zip(
                problem.model.parameters.names,
                problem.targets,
                found.values,
                alone.values,
                spread,
                strict=True,
            )
        },
        "evaluations": found.evaluations,
        "evaluations_to_1_percent": found.reached,
        "seconds": found.trace[-1].seconds,
        "noa_alone": {
            "settings": METHODS["noa"].settings,
            "evaluations_to_1_percent": alone.reached,
            "seconds_to_1_percent": alone.seconds_at_target,
        },
        "rms_error_k": float(np.sqrt(np.mean(problem.residuals_of(found.values) ** 2))),
        "condition": condition,
        "paper": {"identified": "near-complete agreement with the targets, no figures printed"},
    }


def tables(results: Sequence[Found], document: Document) -> Iterator[Table]:
    """All parameters."""
    found, alone = results

    def beside(name: str, digits: str, error: str) -> Callable[[Document], str]:
        return lambda row: (
            f"{row[name]:{digits}} ({100 * (row[name] / row['target'] - 1):{error}} %)"
        )

    reached = "not all within 1 %"
    if alone.reached is not None:
        reached = f"all within 1 % after {alone.reached} evaluations"
    yield table(
        "Simple network: seven parameters from noise-free data",
        named(document["parameters"]),
        (
            ("", cell("name")),
            ("paper's target", lambda row: f"{row['target']:g}"),
            (DEFAULT, beside("identified", ".6g", "+.4f")),
            ("NOA alone", beside("noa_alone", ".4g", "+.2f")),
            (
                "std. dev. at 0.1 K noise",
                lambda row: f"{100 * (row['std_at_0.1_k_noise'] / row['target']):.1f} %",
            ),
        ),
        f"{DEFAULT} ({document['settings']}): all within 1 % after {found.reached} "
        f"evaluations, ended after {found.evaluations} and "
        f"{document['seconds']:.2f} s.",
        f"NOA alone ({METHODS['noa'].settings}): {reached}; at the end the errors "
        "above. The paper: the per-unit values approach unity, no figures printed.",
        f"Condition of the sensitivities {document['condition']:.0f}: with real noise k5, k6 and "
        "k7 cannot be had to 1 %, whatever the optimiser.",
    )


def plots(results: Sequence[Found], document: Document) -> dict[str, Drawing]:
    """Figure 8 of the paper."""
    return {"fig08-convergence": partial(_draw, *results)}


def identifiability(problem: InverseProblem) -> tuple[FloatArray, float]:
    """Relative standard deviations (p,) with 0.1 K of white noise, and the condition number.

    Linearised at the targets, in the logarithm of the parameters.
    """
    steps = _DIFFERENCE * np.concatenate((np.eye(problem.dimensions), -np.eye(problem.dimensions)))
    moved = problem.residuals_of(problem.targets * np.exp(steps))
    jacobian = (moved[: problem.dimensions] - moved[problem.dimensions :]).T / (2 * _DIFFERENCE)
    covariance = _NOISE_K**2 * np.linalg.inv(jacobian.T @ jacobian)
    return np.sqrt(np.diag(covariance)), float(np.linalg.cond(jacobian))


def _draw(found: Found, alone: Found) -> "Figure":
    """Figure 8 of the paper, for NOA alone and for the default method."""
    problem = simple_network_problem()
    drawn = figure(11.0, 4.5)
    left, right = drawn.subplots(1, 2, sharey=True)
    for axes, one, title in ((left, alone, "NOA alone"), (right, found, "NOA, then refinement")):
        _draw_trace(axes, problem.model.parameters.names, problem.targets, one.trace)
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


STUDY = Study(
    "simple-network", lambda options: (DEFAULT, "noa"), examine, figures_of, tables, plots
)
