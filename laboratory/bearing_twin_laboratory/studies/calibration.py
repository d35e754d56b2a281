"""Study ``calibration``: do the bands hold what they state, and how wide are they for it.

Every bench is one of three families. A 6311 climbs through six speeds; its twin forecasts the rest
from the first 90 and 270 samples. A 6016 has run under 2650 and 3300 N and is forecast at 5500 N.
No sisters. Beside the share of the readings inside the bands of each moment stands the share of
whole runs inside the band of the whole run, and the interval score, which punishes width.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adapters.virtual_bench.families import FAMILIES, random_bench
from bearing_twin_laboratory.studies.bench_runs import (
    RINGS,
    BenchRun,
    Stage,
    forecast_from,
    identify_twin,
    run_bench,
)
from bearing_twin_laboratory.studies.bench_scores import pair, percent
from bearing_twin_laboratory.studies.study import Document, Options, Study, Table, cell, mean, table
from twin_core import scores
from twin_core.forecasting import Forecast

BENCHES = 20
SPEEDS_RPM = (1500.0, 2400.0, 4200.0, 4900.0, 5600.0, 6200.0)
_STAIRCASE = tuple(Stage(90, speed, 2650.0) for speed in SPEEDS_RPM)
_TWO_LOADS = (Stage(360, 5800.0, 2650.0), Stage(90, 5800.0, 3300.0), Stage(180, 5800.0, 5500.0))


@dataclass(frozen=True, slots=True)
class Question:
    """What a twin is asked: the bearing, what it runs, and how many of these stages are known."""

    bearing: str
    stages: tuple[Stage, ...]
    known: int


QUESTIONS = {
    "N_90": Question("6311", _STAIRCASE, 1),
    "N_270": Question("6311", _STAIRCASE, 3),
    "two loads": Question("6016", _TWO_LOADS, 2),
}
QUICK = {"quick": Question("6016", (Stage(60, 5800.0, 2650.0), Stage(45, 5800.0, 3300.0)), 1)}


@dataclass(frozen=True, slots=True)
class Task:
    """All questions to one bench of a family."""

    seed: int
    family: str
    quick: bool


@dataclass(frozen=True, slots=True)
class RingBands:
    """How the bands of one ring did over one run.

    - ``coverage_50``, ``coverage_95``: share of the readings inside the bands of each moment.
    - ``held_whole``: whether all readings lay inside the band of the whole run.
    - ``whole_run_factor``: by how much that is wider than the 95 % band.
    - ``half_width_k``, ``interval_score_k``, ``max_error_k``: of the 95 % band and of the median,
      against the readings.
    """

    coverage_50: float
    coverage_95: float
    held_whole: bool
    whole_run_factor: float
    half_width_k: float
    interval_score_k: float
    max_error_k: float


@dataclass(frozen=True, slots=True)
class CalibrationRun:
    """One forecast; without rings where the bench ran away or the fit was refused."""

    task: Task
    question: str
    ran_away: bool
    refused: str
    rings: Mapping[str, RingBands]


def cases(options: Options) -> list[Task]:
    """Every seed as a bench of each family."""
    return [
        Task(seed, family, options.quick) for seed in options.seeds(BENCHES) for family in FAMILIES
    ]


def examine(task: Task) -> list[CalibrationRun]:
    """Ask one bench everything."""
    found = []
    for name, question in (QUICK if task.quick else QUESTIONS).items():
        bench = random_bench(task.seed, question.bearing, task.family)
        run = run_bench(bench, question.stages, task.seed)
        first, end = run.first_row(question.known), run.first_row(len(question.stages))
        if run.ran_away(0, end):
            found.append(CalibrationRun(task, name, True, "", {}))
            continue
        twin = identify_twin(run, first)
        if not twin.may_forecast:
            found.append(CalibrationRun(task, name, False, twin.result.reason, {}))
            continue
        made = forecast_from(twin, run, first - 1, run.measured(first - 1, end))
        rings = {ring: _bands(made, run, ring, first) for ring in RINGS}
        found.append(CalibrationRun(task, name, False, "", rings))
    return found


def _bands(made: Forecast, run: BenchRun, ring: str, first: int) -> RingBands:
    """Score all rows after the present one."""
    low, lower, median, upper, high = made.quantile(ring)[:, 1:]
    whole_low, whole_high = made.whole_run(ring)[:, 1:]
    measured = run.minutes.temperatures_c[ring][first : first + median.size]
    return RingBands(
        coverage_50=scores.coverage(lower, upper, measured),
        coverage_95=scores.coverage(low, high, measured),
        held_whole=scores.coverage(whole_low, whole_high, measured) == 1.0,
        whole_run_factor=float(made.whole_run_factor[-1, made.sensors.index(ring)]),
        half_width_k=float(0.5 * np.mean(high - low)),
        interval_score_k=scores.interval_score(low, high, measured),
        max_error_k=scores.max_error(median, measured),
    )


def figures_of(found: Sequence[Sequence[CalibrationRun]]) -> Document:
    """Figures by question and family, and of all families together."""
    runs = [run for one in found for run in one]
    rows = []
    for question in dict.fromkeys(run.question for run in runs):
        for family in (*FAMILIES, None):
            asked = [
                run
                for run in runs
                if run.question == question and family in (None, run.task.family)
            ]
            rows.append({"question": question, "family": family or "all", **_figures(asked)})
    return {"seeds": sorted({run.task.seed for run in runs}), "rows": rows}


def _figures(asked: Sequence[CalibrationRun]) -> Document:
    scored = [run for run in asked if run.rings]

    def by_ring(name: str) -> dict[str, float | None]:
        return {ring: mean(getattr(run.rings[ring], name) for run in scored) for ring in RINGS}

    return {
        "runs": len(scored),
        "ran_away": sum(run.ran_away for run in asked),
        "refused": [f"{run.task.family} {run.task.seed}" for run in asked if run.refused],
        "worst_coverage_95": {
            ring: min((run.rings[ring].coverage_95 for run in scored), default=None)
            for ring in RINGS
        },
        **{name: by_ring(name) for name in RingBands.__slots__},
    }


def tables(found: Sequence[Sequence[CalibrationRun]], document: Document) -> Iterator[Table]:
    """One row per question and family."""
    yield table(
        "Calibration of the bands without sisters, T_ir/T_or",
        document["rows"],
        (
            ("question", cell("question")),
            ("family", cell("family")),
            ("runs", cell("runs")),
            ("in 50 %", cell("coverage_50", percent)),
            ("in 95 %", cell("coverage_95", percent)),
            ("worst run", cell("worst_coverage_95", percent)),
            ("whole runs in 90 %", cell("held_whole", percent)),
            ("factor", cell("whole_run_factor", pair)),
            ("half-width, K", cell("half_width_k", pair)),
            ("interval score, K", cell("interval_score_k", pair)),
            ("largest error, K", cell("max_error_k", pair)),
        ),
        "In 50 %, in 95 %: share of the readings inside the bands of each moment. Whole runs: "
        "those with all readings inside the band of the whole run, which is the 95 % band times "
        "the factor. Benches that ran away and fits that were refused count nowhere.",
    )


STUDY = Study("calibration", cases, examine, figures_of, tables)
