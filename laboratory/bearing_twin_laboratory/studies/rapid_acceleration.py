"""Study ``rapid-acceleration``: a fast run-up forecast beforehand (section 5.2.1, figure 12).

The twin is identified from the staircase of the study ``sample-size``. The machine then stands for
twelve hours; from there the twin forecasts a test that accelerates at 300 rpm/s to 5600 and 6200
rpm, with stops between.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_results import (
    BenchResult,
    forecast_bench,
    seeds_of,
    usable,
)
from bearing_twin_laboratory.studies.bench_runs import RINGS, Stage, run_bench
from bearing_twin_laboratory.studies.bench_scores import figures, methods_tables, pair, percent
from bearing_twin_laboratory.studies.drawing import RING_NAMES, draw_agreement, draw_curves
from bearing_twin_laboratory.studies.forecasters import mean_scores, score_document
from bearing_twin_laboratory.studies.sample_size import BEARING, LOAD_N, STAIRCASE
from bearing_twin_laboratory.studies.study import Document, Drawing, Study, Table, cell, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BENCHES = 10
STANDSTILL = Stage(720, 0.0, LOAD_N)
ACCELERATIONS = (
    Stage(60, 5600.0, LOAD_N),
    Stage(20, 0.0, LOAD_N),
    Stage(30, 5600.0, LOAD_N),
    Stage(10, 0.0, LOAD_N),
    Stage(45, 6200.0, LOAD_N),
)
RAMP_RPM_PER_S = 300.0
# Figures 12b and 12c; which of the two temperature sensors is which the paper's text does not say.
PAPER_R_SQUARED = (0.9821, 0.9939)


def examine(seed: int) -> BenchResult:
    """Identify from the staircase of one bench and forecast its test."""
    run = run_bench(
        BenchParameters.random(seed, BEARING),
        (*STAIRCASE, STANDSTILL, *ACCELERATIONS),
        seed,
        speed_ramp_rpm_per_s=RAMP_RPM_PER_S,
    )
    first, end = run.first_row(len(STAIRCASE) + 1), run.first_row(len(run.stages))
    turning = run.planned(first, end).speed_rpm > 0.0
    found = forecast_bench(
        seed,
        run,
        run.first_row(len(STAIRCASE)),
        first - 1,
        first,
        parts={"running": turning, "standing": ~turning},
        planned=True,
        compared=True,
    )
    return replace(found, shown=found.shown.since(first - 1))


def figures_of(results: Sequence[BenchResult]) -> Document:
    """Figures of the test and of its parts over the benches whose fit may forecast."""
    used = usable(results)
    return {
        "bearing": BEARING,
        **seeds_of(results),
        **figures([result.rings for result in used]),
        "running": figures([result.parts["running"] for result in used]),
        "standing": figures([result.parts["standing"] for result in used]),
        "ambient_and_points_as_planned": figures([result.parts["planned"] for result in used]),
        "methods": score_document(mean_scores([result.methods for result in used])),
        "paper": {"r_squared": list(PAPER_R_SQUARED), "coverage_95": "nearly all points"},
    }


def tables(results: Sequence[BenchResult], document: Document) -> Iterator[Table]:
    """The test and its parts; the methods next to the twin."""
    used = usable(results)
    parts = ("running", "standing", "ambient_and_points_as_planned")
    columns = (document, *(document[part] for part in parts))

    def row(title: str, paper: str, *shown: Any) -> tuple[str, ...]:
        return (title, paper, *map(cell(*shown), columns))

    yield Table(
        f"Rapid acceleration: forecast from a cold machine, T_ir/T_or, {len(used)} benches",
        ("", "paper", "ours", "running", "in the stops", "plan only"),
        (
            row("R2", "/".join(f"{value:.4f}" for value in PAPER_R_SQUARED), "r_squared", pair, 4),
            row("95 % band covers, %", "all", "coverage_95_by_sensor", percent),
            row("worst bench, %", "–", "worst_coverage_95", percent),
            row("largest error, K", "–", "max_error_c", pair),
            row("worst bench, K", "–", "worst_max_error_c", pair),
            row("rms error, K", "–", "rms_error_by_sensor_k", pair),
            row("half-width, K", "wide", "half_width_c", pair),
        ),
        (
            "Errors against the noise-free temperature; R2 and coverage of the measured data. "
            "Whole test, its part on the running machine, its stops; plan only: set-points and the "
            "ambient at the start. The paper does not say which R2 is whose, nor whether its test "
            "has stops; its text says nearly all points, its conclusion all.",
        ),
    )
    methods = {"test": mean_scores([result.methods for result in used])}
    yield from methods_tables("Rapid acceleration, the twin beside others", methods)


def plots(results: Sequence[BenchResult], document: Document) -> dict[str, Drawing]:
    """Figure 12 of the paper, of the first bench."""
    return {"fig12-rapid-acceleration": partial(_draw, (usable(results) or results)[0])}


def _draw(drawn: BenchResult) -> "Figure":
    """Figure 12 of the paper: curves, and agreement of both temperature sensors."""
    made = figure(15.0, 4.6)
    left, *others = made.subplots(1, 3, width_ratios=(1.4, 1, 1))
    draw_curves(left, drawn.shown, legend=True)
    left.set_title(f"Bench {drawn.seed}: rapid acceleration")
    for axes, ring in zip(others, RINGS, strict=True):
        score = drawn.rings[ring]
        draw_agreement(
            axes,
            drawn.shown.measured_c[ring][1:],
            drawn.shown.quantiles_c[ring][:, 1:],
            f"{RING_NAMES[ring]}: R2 {score.r_squared:.4f}, {score.coverage_95:.0%} inside",
        )
    return made


STUDY = Study(
    "rapid-acceleration", lambda options: options.seeds(BENCHES), examine, figures_of, tables, plots
)
