"""Study ``ledger``: whether the published share of a ledger is flattered by plans that are left.

A 6016 that is mounted too tight has run at 5800 rpm under 2650 N for six hours; 4000 and 5500 N
follow. A forecast is kept every ten minutes. The controller stops a machine whose inner ring passes
95 degC: the plan of the forecasts that missed it is left. The same machine also runs on, as if
there were no such controller, and, in a third case, loses both sensors when it is that hot. The
service's own ledger scores all three.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from adapters.samples import Sample
from adapters.virtual_bench.families import FAMILIES, random_bench
from bearing_twin_laboratory.studies.bench_runs import (
    RINGS,
    BenchRun,
    Stage,
    Twin,
    follow,
    identify_twin,
    run_bench,
)
from bearing_twin_laboratory.studies.study import (
    Document,
    Options,
    Study,
    Table,
    cell,
    share,
    table,
)
from service.clock import MICROSECONDS
from service.features.ledger.documents import forecast_performance
from service.features.ledger.keeping import issued_forecast
from service.features.ledger.scoring import ForecastScoring
from service.features.ledger.tables import KeptForecasts
from service.live.estimate import EstimatedState, RunningModel
from service.live.issues import LiveIssue
from service.live.profiles import StepAhead
from service.store import Store
from service.store.forecast_records import IssuedForecast
from twin_core.forecasting import forecast
from twin_core.profiles import Point
from twin_core.windows import LowRiskRegion

BENCHES = 20
SPEED_RPM, TRIP_C = 5800.0, 95.0
LIGHT = Stage(360, SPEED_RPM, 2650.0)
AHEAD = (Stage(180, SPEED_RPM, 4000.0), Stage(180, SPEED_RPM, 5500.0))
QUICK = (Stage(60, SPEED_RPM, 2650.0), Stage(30, SPEED_RPM, 5500.0))
LOST_CLEARANCES_UM = (12.0, 18.0, 24.0)
EVERY_ROWS, HORIZON_ROWS = 10, 240
REGION = LowRiskRegion(speed_rpm_max=5900.0, load_n_max=3400.0)
COURSES = ("ran on", "stopped", "sensors lost")
_START_US = 1_763_700_000 * MICROSECONDS
_GOOD = 192
_LATER_US = 40 * 3600 * MICROSECONDS


@dataclass(frozen=True, slots=True)
class Task:
    """One bench; ``lost_um``: by how much its clearance is too small, micrometres."""

    seed: int
    family: str
    lost_um: float
    quick: bool


@dataclass(frozen=True, slots=True)
class Counts:
    """What a ledger says of one bench, all sensors and lead times together."""

    scored: int = 0
    inside: int = 0
    left: int = 0
    left_inside: int = 0
    set_aside: int = 0
    whole_runs: int = 0
    whole_runs_inside: int = 0
    independent_runs: int = 0


@dataclass(frozen=True, slots=True)
class LedgerRun:
    """One bench; ``courses`` by name, empty where it never became so hot or was lost before."""

    task: Task
    courses: dict[str, Counts]


def cases(options: Options) -> list[Task]:
    """Every seed as a bench of each family and of each clearance."""
    return [
        Task(seed, family, lost_um, options.quick)
        for seed in options.seeds(BENCHES)
        for family in FAMILIES
        for lost_um in LOST_CLEARANCES_UM
    ]


def examine(task: Task) -> LedgerRun:
    """Run a bench, forecast it every ten minutes until it is too hot, and score all that."""
    stages = QUICK if task.quick else (LIGHT, *AHEAD)
    bench = random_bench(task.seed, "6016", task.family)
    run = run_bench(
        replace(bench, clearance_um=bench.clearance_um - task.lost_um), stages, task.seed
    )
    first, end = run.first_row(1), run.first_row(len(stages))
    inner_c = run.minutes.temperatures_c[RINGS[0]]
    hot = np.flatnonzero(inner_c > TRIP_C)
    if task.quick:
        hot = np.array([end - 12])
    if hot.size == 0 or hot[0] <= first:
        return LedgerRun(task, {})
    twin = identify_twin(run, first)
    if not twin.may_forecast:
        return LedgerRun(task, {})
    trip = int(hot[0])
    made = [_issued(twin, run, row, end) for row in range(first - 1, trip, EVERY_ROWS)]
    forecasts = [one for one in made if one is not None]
    with TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        courses = {
            name: _scored(store, f"bench-{number}", forecasts, _samples(run, trip, name))
            for number, name in enumerate(COURSES)
        }
    return LedgerRun(task, courses)


def _issued(twin: Twin, run: BenchRun, row: int, end: int) -> IssuedForecast | None:
    """What the service keeps of a forecast that is made at a row."""
    planned = run.planned(row, min(row + HORIZON_ROWS + 1, end - 1))
    ambient_c = float(planned.ambient_c[0])
    machine = follow(twin, run, row).state(ambient_c)
    result = forecast(twin.model, twin.posterior, machine, planned)
    ends = np.flatnonzero(np.diff(planned.load_n)) + 1
    bounds = [0, *ends.tolist(), planned.size - 1]
    steps = [
        StepAhead(float(last - begin) * 60.0, SPEED_RPM, float(planned.load_n[begin]), ambient_c)
        for begin, last in pairwise(bounds)
        if last > begin
    ]
    point = Point(SPEED_RPM, float(planned.load_n[0]), ambient_c)
    state = EstimatedState(
        RunningModel(1, twin.model, twin.posterior, 0), machine, point, _time_us(row)
    )
    return issued_forecast("", LiveIssue(state, steps, result, None), "period", REGION, RINGS, {})


def _time_us(row: int) -> int:
    return _START_US + row * 60 * MICROSECONDS


def _samples(run: BenchRun, trip: int, course: str) -> Iterator[tuple[str, int, float]]:
    """Channel, time and value of each minute, at its middle."""
    minutes = run.minutes
    for row in range(minutes.size - 1):
        stopped = course == "stopped" and row >= trip
        at_us = _time_us(row) + 30 * MICROSECONDS
        yield "speed_rpm", at_us, 0.0 if stopped else float(minutes.speed_rpm[row])
        yield "load_n", at_us, 0.0 if stopped else float(minutes.load_n[row])
        if course == "sensors lost" and row >= trip:
            continue
        for ring in RINGS:
            around_c = minutes.temperatures_c[ring][row : row + 2]
            yield ring, at_us, float(np.mean(around_c))


def _scored(
    store: Store,
    asset: str,
    forecasts: Sequence[IssuedForecast],
    samples: Iterator[tuple[str, int, float]],
) -> Counts:
    """What the ledger says of forecasts of an asset whose samples are these."""
    version = store.models.add(asset, "candidate", "", {}, 0)
    store.models.activate(asset, version, "study", "", 0)
    store.samples.write(
        [Sample(asset, name, at_us, value, _GOOD, 0) for name, at_us, value in samples]
    )
    kept = store.part(KeptForecasts)
    kept.add(
        [IssuedForecast(asset, one.time_us, version, one.reason, one.content) for one in forecasts]
    )
    scoring = ForecastScoring(store, rate=1.0)
    while scoring.look(_START_US + _LATER_US)[0]:
        pass
    items = forecast_performance(kept.since(asset, 0)).items
    return Counts(
        sum(one.n for one in items),
        sum(round(one.n * (one.coverage_95 or 0.0)) for one in items),
        sum(one.left for one in items),
        sum(one.left_inside_95 for one in items),
        sum(one.set_aside for one in items),
        sum(one.whole_runs for one in items),
        sum(one.whole_runs_inside for one in items),
        max((one.independent_runs for one in items), default=0),
    )


def _row(name: str, counts: Sequence[Counts]) -> Document:
    def total(field: str) -> int:
        return sum(getattr(one, field) for one in counts)

    scored, left, runs = total("scored"), total("left"), total("whole_runs")
    inside = total("inside")
    return {
        "name": name,
        "benches": len(counts),
        "scored": scored,
        "left": left,
        "set_aside": total("set_aside"),
        "share_followed": inside / scored if scored else None,
        "share": (inside + total("left_inside")) / (scored + left) if scored + left else None,
        "whole_runs": runs,
        "whole_runs_share": total("whole_runs_inside") / runs if runs else None,
        "independent_runs": total("independent_runs"),
    }


def figures_of(runs: Sequence[LedgerRun]) -> Document:
    """Shares of each course, of the benches that became too hot."""
    hot = [one for one in runs if one.courses]
    rows = [_row(name, [one.courses[name] for one in hot]) for name in COURSES]
    shares = {row["name"]: row["share"] for row in rows}
    true = shares[COURSES[0]]
    return {
        "seeds": sorted({one.task.seed for one in runs}),
        "families": list(FAMILIES),
        "lost_clearances_um": list(LOST_CLEARANCES_UM),
        "trip_c": TRIP_C,
        "benches": len(runs),
        "too_hot": len(hot),
        "courses": rows,
        "difference": {
            name: None if true is None or shares[name] is None else shares[name] - true
            for name in COURSES[1:]
        },
        "by_bench": [
            {
                "seed": one.task.seed,
                "family": one.task.family,
                "lost_um": one.task.lost_um,
                "shares": {name: _row(name, [of])["share"] for name, of in one.courses.items()},
            }
            for one in hot
        ],
    }


def tables(runs: Sequence[LedgerRun], document: Document) -> Iterator[Table]:
    """The published share of each course, and what it was without interrupted readings."""
    yield table(
        f"The ledger of machines that become too hot ({document['too_hot']} of "
        f"{document['benches']} benches)",
        document["courses"],
        (
            ("what the machine did", cell("name")),
            ("benches", cell("benches")),
            ("scored to the end", cell("scored")),
            ("interrupted", cell("left")),
            ("inside, of those scored to the end, %", cell("share_followed", share, 1)),
            ("**published share**, %", cell("share", share, 1)),
            ("whole runs", cell("whole_runs")),
            ("inside, %", cell("whole_runs_share", share, 1)),
            ("independent runs", cell("independent_runs")),
        ),
        "The share of the machine that ran on is what the others' would have been. The band of the "
        "whole run states 90 %.",
    )


STUDY = Study("ledger", cases, examine, figures_of, tables)
