"""What the studies on random benches keep: a fit, its forecast, and how good that was."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies.bench_runs import (
    NODES,
    RINGS,
    BenchRun,
    forecast_from,
    identify_twin,
)
from bearing_twin_laboratory.studies.bench_scores import (
    RingScores,
    beside,
    node_coverage,
    node_errors,
    score_rings,
)
from bearing_twin_laboratory.studies.drawing import Curves, curves
from bearing_twin_laboratory.studies.forecasters import ForecastScore
from twin_core.forecasting.labels import RUNAWAY

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BenchResult:
    """One forecast of one bench; also of one that ran away, or whose fit must not forecast.

    - ``refused``: why the fit must not forecast; empty if it may.
    - ``rings``, ``parts``: scores of all rows, and of parts of them by name; ``planned``: of all
      rows, where set-points and the ambient of the present row were all that was known.
    - ``node_errors_k``, ``nodes_truth_c``, ``node_coverage``: (13, rows) median minus truth and the
      truth of the paper's nodes, (13,) shares inside the 95 % band.
    - ``not_known``, ``labels``: what the forecast says of nodes and of itself; of the planned one
      where there is such.
    - ``methods``: the twin and the methods next to it; none where they were not asked for.
    - ``shown``: curves of the rings.
    """

    seed: int
    ran_away: bool
    refused: str
    rings: RingScores
    parts: Mapping[str, RingScores]
    node_errors_k: FloatArray
    nodes_truth_c: FloatArray
    node_coverage: FloatArray
    not_known: tuple[str, ...]
    labels: tuple[str, ...]
    methods: tuple[ForecastScore, ...]
    shown: Curves
    seconds: float
    evaluations: int

    @property
    def nodes_c(self) -> FloatArray:
        """Medians of the nodes, (13, rows)."""
        return self.nodes_truth_c + self.node_errors_k

    @property
    def warned(self) -> bool:
        """Whether the forecast said "runaway not excluded"."""
        return RUNAWAY in self.labels


@dataclass(frozen=True, slots=True, eq=False)
class SchemesResult:
    """One bench under several schemes, by name."""

    seed: int
    ran_away: bool
    schemes: dict[str, BenchResult]


def forecast_bench(
    seed: int,
    run: BenchRun,
    rows: int,
    begun: int,
    first: int,
    *,
    sensors: tuple[str, ...] = RINGS,
    parts: Mapping[str, NDArray[np.bool_]] | None = None,
    planned: bool = False,
    compared: bool = False,
) -> BenchResult:
    """Identify a twin from the first rows, forecast the rest of the run and score that.

    - ``rows``: how many rows are used.
    - ``begun``, ``first``: row at which the forecast begins, and the first that counts.
    - ``sensors``: temperatures that are used.
    - ``parts``: by name, which of the rows from ``first`` on are scored apart, too.
    - ``planned``: whether a second forecast is scored that knows the plan only.
    - ``compared``: whether other methods forecast the same.
    """
    end = run.first_row(len(run.stages))
    twin = identify_twin(run, rows, sensors=sensors)
    ahead = run.measured(begun, end)
    made = forecast_from(twin, run, begun, ahead)
    scored = {
        name: score_rings(made, run, begun, first, end, counts)
        for name, counts in (parts or {}).items()
    }
    labels = made.labels
    if planned:
        plan = forecast_from(twin, run, begun, run.planned(begun, end))
        scored["planned"], labels = score_rings(plan, run, begun, first, end), plan.labels
    return BenchResult(
        seed,
        run.ran_away(0, end),
        "" if twin.may_forecast else twin.result.reason,
        score_rings(made, run, begun, first, end),
        scored,
        node_errors(made, run, begun, first, end),
        np.array([run.truth_c[name][first:end] for name in NODES]),
        node_coverage(made, run, begun, first, end),
        tuple(made.not_known),
        tuple(labels),
        beside(twin, run, made, ahead, begun, [(first, end)])[0] if compared else (),
        curves(run, made, begun),
        twin.seconds,
        twin.result.evaluations,
    )


def usable(results: Iterable[BenchResult]) -> list[BenchResult]:
    """Benches that did not run away and whose fits may forecast."""
    return [result for result in results if not (result.ran_away or result.refused)]


def seeds_of(results: Sequence[BenchResult]) -> dict[str, object]:
    """Seeds of all benches, of those that ran away, and of those whose fit must not forecast."""
    return {
        "seeds": [result.seed for result in results],
        "ran_away": [result.seed for result in results if result.ran_away],
        "refused": {result.seed: result.refused for result in results if result.refused},
    }


def refused_seeds(results: Iterable[SchemesResult], scheme: str) -> dict[int, str]:
    """Seeds of the benches whose fit of a scheme must not forecast, with the reason."""
    return {result.seed: reason for result in results if (reason := result.schemes[scheme].refused)}
