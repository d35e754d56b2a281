"""Study ``reference-nodes``: sensors in 4 to 13 nodes (section 5.2.2, figure 15, table 7).

The run of the study ``sample-size``; identified from its first 180 samples, from the temperatures
of the paper's nodes T1 to Tn, and compared in all 13 nodes over the prediction zone. The paper
compares its model with itself, here the bench knows the true temperatures.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_results import (
    SchemesResult,
    forecast_bench,
    refused_seeds,
)
from bearing_twin_laboratory.studies.bench_runs import NODES, RINGS, run_bench
from bearing_twin_laboratory.studies.drawing import draw_node_map
from bearing_twin_laboratory.studies.sample_size import BEARING, STAIRCASE
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Study,
    Table,
    cell,
    named,
    share,
    table,
    text,
)

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


def examine(seed: int) -> SchemesResult:
    """Run all schemes on one bench."""
    run = run_bench(BenchParameters.random(seed, BEARING), STAIRCASE, seed, node_sensors=True)
    schemes = {
        name: forecast_bench(seed, run, SAMPLES, SAMPLES - 1, SAMPLES, sensors=sensors)
        for name, sensors in SCHEMES.items()
    }
    return SchemesResult(seed, run.ran_away(0, run.first_row(len(STAIRCASE))), schemes)


def figures_of(results: Sequence[SchemesResult]) -> Document:
    """Figures of all schemes over the benches that do not run away."""
    normal = [result for result in results if not result.ran_away]
    schemes = {name: _figures(name, normal) for name in SCHEMES}
    return {
        "bearing": BEARING,
        "samples": SAMPLES,
        "seeds": [result.seed for result in results],
        "ran_away": [result.seed for result in results if result.ran_away],
        "schemes": schemes,
        "falls_monotonically": _falls(
            [schemes[name]["euclidean_distance_k"] for name in PAPER_DISTANCE_K]
        ),
    }


def _figures(name: str, results: Sequence[SchemesResult]) -> Document:
    runs = [result.schemes[name] for result in results]
    errors = np.array([one.node_errors_k for one in runs])
    distance = np.sqrt(np.sum(errors**2, axis=2)).mean(axis=0) if runs else np.zeros(0)
    rms = np.sqrt(np.mean(errors**2, axis=2)).mean(axis=0) if runs else np.zeros(0)
    covered = np.array([one.node_coverage for one in runs])
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
        "refused": refused_seeds(results, name),
        "paper": {"euclidean_distance_k": PAPER_DISTANCE_K.get(name)},
    }


def _falls(values: Sequence[float | None]) -> bool:
    known = [value for value in values if value is not None]
    return len(known) == len(values) and all(later < earlier for earlier, later in pairwise(known))


def tables(results: Sequence[SchemesResult], document: Document) -> Iterator[Table]:
    """All schemes."""
    benches = len(results) - len(document["ran_away"])
    yield table(
        f"Reference nodes: all 13 nodes in the prediction zone, {benches} benches",
        named(document["schemes"]),
        (
            ("scheme", cell("name")),
            ("thermometers", lambda scheme: _thermometers(scheme["name"])),
            ("paper, distance in K", cell("paper.euclidean_distance_k", text, 1)),
            ("ours, distance in K", cell("euclidean_distance_k", text, 1)),
            ("rms, K", cell("rms_error_k", text)),
            ("worst node, rms", cell("worst_node_rms_error_k", text)),
            ("covers, %", cell("coverage_95", share)),
            ("fit too poor", lambda scheme: str(len(scheme["refused"]))),
        ),
        "Mean over nodes and benches. The paper's reference is its own model with other "
        "parameters, ours the bench's true temperatures. "
        f"The error {'falls' if document['falls_monotonically'] else 'does not fall'} with every "
        "further step of reference nodes.",
        "Fit too poor: more than 0.5 K rms off in a node, a twin that the service would not "
        "let forecast; counted in the figures here, as these schemes are about how much the "
        "network itself can follow.",
    )


def _thermometers(scheme: str) -> str:
    return f"T1 to T{len(SCHEMES[scheme])}" if scheme in PAPER_DISTANCE_K else "T_ir, T_or"


def plots(results: Sequence[SchemesResult], document: Document) -> dict[str, Drawing]:
    """Figure 15 of the paper."""
    title = (
        "Euclidean distance in K between forecast and truth, mean over the benches; framed: "
        "thermometer"
    )
    draw = partial(draw_node_map, document["schemes"], "euclidean_distance_k", title, 1)
    return {"fig15-reference-nodes": draw}


STUDY = Study(
    "reference-nodes", lambda options: options.seeds(BENCHES), examine, figures_of, tables, plots
)
