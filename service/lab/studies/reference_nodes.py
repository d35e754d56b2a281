"""Study ``reference-nodes``: sensors in 4 to 13 nodes (section 5.2.2, figure 15, table 7).

The run of the study ``sample-size``; identified from its first 180 samples, from the temperatures
of the paper's nodes T1 to Tn, and compared in all 13 nodes over the prediction zone. The paper
compares its model with itself, here the bench knows the true temperatures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench import BenchParameters
from service.lab.studies.bench_runs import NODES, RINGS, forecast_from, identify_twin, run_bench
from service.lab.studies.bench_scores import node_coverage, node_errors, text
from service.lab.studies.common import Options, Plot, Progress, Report, Table, figure, in_processes
from service.lab.studies.sample_size import BEARING, STAIRCASE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

NAME = "reference-nodes"
BENCHES = 10
SAMPLES = 180
SCHEMES = {"rings": RINGS, **{f"N_Ref_{count}": NODES[:count] for count in (4, 6, 8, 10, 13)}}
PAPER_DISTANCE_K = {
    "N_Ref_4": 13.7,
    "N_Ref_6": 12.7,
    "N_Ref_8": 5.0,
    "N_Ref_10": 3.4,
    "N_Ref_13": 0.7,
}


@dataclass(frozen=True, slots=True, eq=False)
class NodesRun:
    """One scheme on one bench.

    Parameters
    ----------
    refused
        Why the fit must not forecast; empty if it may.
    errors_k
        (13, rows) median minus truth.
    coverage
        (13,) of the 95 % bands.
    """

    refused: str
    errors_k: FloatArray
    coverage: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BenchResult:
    """All schemes on one bench."""

    seed: int
    ran_away: bool
    schemes: dict[str, NodesRun]


def run(progress: Progress, options: Options) -> Report:
    """Identify and forecast with all schemes on all benches."""
    return report(in_processes(examine, options.seeds(BENCHES), progress))


def examine(seed: int) -> BenchResult:
    """Run all schemes on one bench."""
    bench = run_bench(BenchParameters.random(seed, BEARING), STAIRCASE, seed, node_sensors=True)
    end = bench.first_row(len(STAIRCASE))
    begun = SAMPLES - 1
    schemes = {}
    for name, sensors in SCHEMES.items():
        twin = identify_twin(bench, SAMPLES, sensors=sensors)
        made = forecast_from(twin, bench, begun, bench.measured(begun, end))
        schemes[name] = NodesRun(
            "" if twin.may_forecast else twin.result.reason,
            node_errors(made, bench, begun, SAMPLES, end),
            node_coverage(made, bench, begun, SAMPLES, end),
        )
    return BenchResult(seed, bench.ran_away(0, end), schemes)


def report(results: Sequence[BenchResult]) -> Report:
    """Put all benches together into figures, table and plot."""
    normal = [result for result in results if not result.ran_away]
    schemes = {name: _figures(name, normal) for name in SCHEMES}
    falling = _falls([schemes[name]["euclidean_distance_k"] for name in PAPER_DISTANCE_K])
    document = {
        "study": NAME,
        "bearing": BEARING,
        "samples": SAMPLES,
        "seeds": [result.seed for result in results],
        "ran_away": [result.seed for result in results if result.ran_away],
        "schemes": schemes,
        "falls_monotonically": falling,
    }
    rows = [
        (
            name,
            f"T1 to T{len(SCHEMES[name])}" if name in PAPER_DISTANCE_K else "T_ir, T_or",
            text(PAPER_DISTANCE_K.get(name), 1),
            text(found["euclidean_distance_k"], 1),
            text(found["rms_error_k"]),
            text(found["worst_node_rms_error_k"]),
            "–" if found["coverage_95"] is None else f"{100.0 * found['coverage_95']:.0f}",
            str(len(found["refused"])),
        )
        for name, found in schemes.items()
    ]
    table = Table(
        f"Reference nodes: all 13 nodes in the prediction zone, {len(normal)} benches",
        (
            "scheme",
            "thermometers",
            "paper, distance in K",
            "ours, distance in K",
            "rms, K",
            "worst node, rms",
            "covers, %",
            "fit too poor",
        ),
        tuple(rows),
        (
            "Mean over nodes and benches. The paper's reference is its own model with other "
            "parameters, ours the bench's true temperatures. "
            + ("The error falls" if falling else "The error does not fall")
            + " with every further step of reference nodes.",
            "Fit too poor: more than 0.5 K rms off in a node, a twin that the service would not "
            "let forecast; counted in the figures here, as these schemes are about how much the "
            "network itself can follow.",
        ),
    )
    return Report(
        NAME, document, (table,), (Plot("fig15-reference-nodes", partial(_draw, schemes)),)
    )


def _figures(name: str, results: Sequence[BenchResult]) -> dict[str, Any]:
    runs = [result.schemes[name] for result in results]
    errors = np.array([one.errors_k for one in runs])
    distance = np.sqrt(np.sum(errors**2, axis=2)).mean(axis=0) if runs else np.zeros(0)
    rms = np.sqrt(np.mean(errors**2, axis=2)).mean(axis=0) if runs else np.zeros(0)
    covered = np.array([one.coverage for one in runs])
    return {
        "sensors": list(SCHEMES[name]),
        "benches": len(runs),
        "euclidean_distance_k": float(distance.mean()) if runs else None,
        "rms_error_k": float(rms.mean()) if runs else None,
        "worst_node_rms_error_k": float(rms.max()) if runs else None,
        "coverage_95": float(covered.mean()) if runs else None,
        "nodes": {
            node: {"euclidean_distance_k": float(far), "rms_error_k": float(error)}
            for node, far, error in zip(NODES, distance, rms, strict=False)
        },
        "refused": {
            result.seed: result.schemes[name].refused
            for result in results
            if result.schemes[name].refused
        },
        "paper": {"euclidean_distance_k": PAPER_DISTANCE_K.get(name)},
    }


def _falls(values: Sequence[float | None]) -> bool:
    known = [value for value in values if value is not None]
    return len(known) == len(values) and all(later < earlier for earlier, later in pairwise(known))


def _draw(schemes: dict[str, Any]) -> "Figure":
    """Figure 15 of the paper: every node under every scheme; reference nodes are framed."""
    made = figure(12.0, 4.0)
    axes = made.subplots()
    values = np.array(
        [
            [found["nodes"].get(node, {}).get("euclidean_distance_k", np.nan) for node in NODES]
            for found in schemes.values()
        ]
    )
    image = axes.imshow(values, cmap="YlOrBr_r", aspect="auto", vmin=0.0)
    for (row, column), value in np.ndenumerate(values):
        shade = "black" if value > 0.4 * np.nanmax(values) else "white"
        framed = NODES[column] in list(schemes.values())[row]["sensors"]
        axes.text(
            column,
            row,
            f"{value:.1f}",
            ha="center",
            va="center",
            color=shade,
            bbox={"boxstyle": "round", "fill": False, "edgecolor": shade} if framed else None,
        )
    axes.set_xticks(range(len(NODES)), [f"T{number + 1}" for number in range(len(NODES))])
    axes.set_yticks(range(len(schemes)), list(schemes))
    axes.set_title(
        "Euclidean distance in K between forecast and truth, mean over the benches; framed: "
        "thermometer"
    )
    made.colorbar(image, ax=axes)
    return made
