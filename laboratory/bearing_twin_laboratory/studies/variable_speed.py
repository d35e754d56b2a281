"""Study ``variable-speed``: all six speeds identified, all nodes shown (figures 10 and 11).

The run of the study ``sample-size``, identified from all its 540 samples. The paper shows how well
its model then follows the two temperature sensors, and the temperatures that it gives for the nodes
without one; here the bench shows how true those are.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_results import (
    BenchResult,
    forecast_bench,
    seeds_of,
    usable,
)
from bearing_twin_laboratory.studies.bench_runs import NODES, RINGS, run_bench
from bearing_twin_laboratory.studies.bench_scores import figures, pair, percent
from bearing_twin_laboratory.studies.drawing import RING_NAMES, draw_curves
from bearing_twin_laboratory.studies.sample_size import BEARING, STAIRCASE
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Study,
    Table,
    cell,
    figure,
    mean,
    share,
    table,
    text,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Texts = tuple[str, ...]

BENCHES = 10
PAPER_MAX_C = dict(zip(RINGS, (1.2, 0.5), strict=True))
NODE_TITLES = (
    "house",
    "outer ring",
    "balls",
    "inner ring",
    "shaft, left",
    "cage",
    "grease, oil, air",
    "end cap, left",
    "end cap, right",
    "sleeve, left",
    "sleeve, right",
    "shaft, centre",
    "bench",
)


def examine(seed: int) -> BenchResult:
    """Identify on one bench and run the twin over the same samples."""
    run = run_bench(BenchParameters.random(seed, BEARING), STAIRCASE, seed)
    return forecast_bench(seed, run, run.first_row(len(STAIRCASE)), 0, 0)


def figures_of(results: Sequence[BenchResult]) -> Document:
    """Figures of the rings and of all nodes over the benches whose fit may forecast."""
    used = usable(results)
    errors = [result.node_errors_k for result in used]
    covered = [result.node_coverage for result in used]
    return {
        "bearing": BEARING,
        "samples": results[0].node_errors_k.shape[1],
        **seeds_of(results),
        **figures([result.rings for result in used]),
        "nodes": {
            node: {
                "rms_error_k": mean(float(np.sqrt(np.mean(one[number] ** 2))) for one in errors),
                "bias_at_6200_rpm_k": mean(float(np.mean(one[number, -30:])) for one in errors),
                "coverage_95": mean(float(one[number]) for one in covered),
                "not_known": mean(float(node in result.not_known) for result in used),
            }
            for number, node in enumerate(NODES)
        },
        "seconds": mean(result.seconds for result in used),
        "evaluations": mean(float(result.evaluations) for result in used),
        "paper": {"max_error_c": PAPER_MAX_C},
    }


def tables(results: Sequence[BenchResult], document: Document) -> Iterator[Table]:
    """Rings, then nodes."""

    def row(title: str, show: Callable[..., str], name: str, worst: str = "", *how: int) -> Texts:
        paper = pair(PAPER_MAX_C, 1) if name == "max_error_c" else "–"
        return (
            title,
            paper,
            show(document[name], *how),
            show(document[worst], *how) if worst else "–",
        )

    yield Table(
        f"Variable speed: the twin of all {document['samples']} samples, T_ir/T_or, "
        f"{document['benches']} benches",
        ("", "paper", "ours", "worst bench"),
        (
            row("largest error, K", pair, "max_error_c", "worst_max_error_c"),
            row("rms error, K", pair, "rms_error_by_sensor_k"),
            row("95 % band covers, %", percent, "coverage_95_by_sensor", "worst_coverage_95"),
            row("half-width of the band, K", pair, "half_width_c"),
            row("R2", pair, "r_squared", "", 4),
        ),
        (
            "Against the noise-free temperature, from the cold start on, over the samples that the "
            "twin was identified from; the thermometers follow with a lag of 20 s, which shows in "
            "the first minutes.",
            f"Identified within {text(document['seconds'], 1)} s and "
            f"{text(document['evaluations'], 0)} simulations. The paper: 103 s for the seven "
            "parameters of its five-node network.",
        ),
    )
    yield table(
        "Variable speed: all nodes, of which none has a thermometer",
        [
            {"title": title, "node": f"T{number + 1}", **found}
            for number, (title, found) in enumerate(
                zip(NODE_TITLES, document["nodes"].values(), strict=True)
            )
        ],
        (
            ("node", cell("node")),
            ("", cell("title")),
            ("rms error, K", cell("rms_error_k", text)),
            ("bias at 6200 rpm, K", cell("bias_at_6200_rpm_k", text)),
            ("95 % band covers, %", cell("coverage_95", share)),
            ("said to be not known, % of the benches", cell("not_known", share)),
        ),
        "The paper has no data of these nodes and shows the twin's temperatures alone.",
    )


def plots(results: Sequence[BenchResult], document: Document) -> dict[str, Drawing]:
    """Figures 10 and 11 of the paper, of the first bench."""
    drawn = (usable(results) or results)[0]
    return {
        "fig10-variable-speed": partial(_draw_rings, drawn),
        "fig11-nodes": partial(_draw_all_nodes, drawn),
    }


def _draw_rings(drawn: BenchResult) -> "Figure":
    """Figure 10 of the paper: temperatures above, errors below."""
    made = figure(9.0, 6.5)
    upper, lower = made.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    draw_curves(upper, drawn.shown, legend=True)
    for ring, colour in zip(RINGS, ("tab:red", "tab:blue"), strict=True):
        error = drawn.shown.quantiles_c[ring][2] - drawn.shown.measured_c[ring]
        lower.plot(drawn.shown.ahead_h, error, color=colour, label=RING_NAMES[ring])
    upper.set_xlabel("")
    lower.set(xlabel="time, h", ylabel="predicted − real, K")
    lower.grid(alpha=0.3)
    lower.legend(loc="upper right", fontsize="small")
    upper.set_title(f"Bench {drawn.seed}: identified from all six speeds")
    return made


def _draw_all_nodes(drawn: BenchResult) -> "Figure":
    """Figure 11 of the paper, with what the bench truly did."""
    made = figure(12.0, 5.5)
    left, right = made.subplots(1, 2, sharey=True)
    colours = [f"C{number % 10}" for number in range(len(NODES))]
    for axes, values, title in (
        (left, drawn.nodes_c, "twin"),
        (right, drawn.nodes_truth_c, "bench"),
    ):
        for number, colour in enumerate(colours):
            axes.plot(
                drawn.shown.ahead_h,
                values[number],
                color=colour,
                linestyle="-" if number < 10 else "--",
                label=f"T{number + 1} {NODE_TITLES[number]}",
            )
        axes.set(title=f"{title}, bench {drawn.seed}", xlabel="time, h")
        axes.grid(alpha=0.3)
    left.set_ylabel("temperature, °C")
    left.legend(fontsize="x-small", ncols=2, loc="upper left")
    return made


STUDY = Study(
    "variable-speed", lambda options: options.seeds(BENCHES), examine, figures_of, tables, plots
)
