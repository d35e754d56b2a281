"""Study ``surrogates``: the paper's three kinds of virtual model on the same benches (section 2).

The paper names physics (kind A), mathematical surrogates (B) and intelligent algorithms (C), says
that B and C need more data than two sensors give, and leaves them for later. Here all learn
from the same low-risk rows of random benches, from few operating points and from many, and forecast
three spans from the same present: between the points they learned from, at a higher speed, and
under a heavier load. Next to them stand the naive forecasts and the hybrid, a Gaussian process on
the residual of the twin: of the default model, and of the paper's own form, which leaves a larger
residual. That fit is shown here even where it is so poor that it must not forecast.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench import BenchParameters
from service.lab.studies.bench_runs import (
    RINGS,
    BenchRun,
    Stage,
    Twin,
    forecast_from,
    identify_twin,
    run_bench,
)
from service.lab.studies.bench_scores import (
    of_method,
    pair,
    percent,
    seeds_of,
    usable,
)
from service.lab.studies.drawing import RING_NAMES
from service.lab.studies.forecasters import (
    TWIN,
    ForecastScore,
    mean_scores,
    rivals,
    score,
    score_document,
)
from service.lab.studies.study import Document, Drawing, Study, Table, figure, table, text
from twin_core.forecasting import SensorForecast, of_ensemble
from twin_core.initial_state import initial_state
from twin_core.naive import NAIVE_KINDS
from twin_core.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
Scores = tuple[ForecastScore, ...]

BENCHES = 10
BEARING = "6311"
PAPER = "paper_model"
MODELS = {TWIN: "default", PAPER: "paper"}
"""Twins by their name in the tables, and their models."""
HYBRIDS = {twin: f"{twin}_gp" for twin in MODELS}
FEW, MANY = "3 points", "12 points"
_FEW_POINTS = tuple(Stage(60, speed, 2650.0) for speed in (1500.0, 3000.0, 4200.0))
_MORE_POINTS = tuple(
    Stage(45, speed, load)
    for speed, load in (
        (4200.0, 2000.0),
        (4200.0, 3300.0),
        (3000.0, 3300.0),
        (3000.0, 2000.0),
        (1500.0, 2000.0),
        (1500.0, 3300.0),
        (2200.0, 2650.0),
        (3600.0, 2650.0),
        (3600.0, 2000.0),
    )
)
TRAININGS: dict[str, tuple[Stage, ...]] = {
    FEW: (Stage(3, 0.0, 2650.0), *_FEW_POINTS),
    MANY: (Stage(3, 0.0, 2650.0), *_FEW_POINTS, *_MORE_POINTS),
}
"""The second begins with the first."""
BACK = Stage(60, 4200.0, 2650.0)
TESTS: dict[str, tuple[Stage, ...]] = {
    "between": (Stage(60, 2600.0, 2650.0), Stage(60, 3900.0, 2650.0)),
    "faster": (Stage(90, 6200.0, 2650.0),),
    "heavier": (Stage(90, 4200.0, 5500.0),),
}
"""Before each the bench runs at `BACK`, a point that all know."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """One test of one bench for the plot: hours, and temperatures of the inner ring."""

    time_h: FloatArray
    truth_c: FloatArray
    centres_c: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class BenchResult:
    """All methods on one bench.

    Parameters
    ----------
    seed
        Of the bench.
    ran_away
        Whether it did.
    refused
        By training, why the twin of the default model must not forecast.
    scores
        By training and test.
    shown
        By test, learned from many points.
    """

    seed: int
    ran_away: bool
    refused: dict[str, str]
    scores: dict[str, dict[str, Scores]]
    shown: dict[str, Shown]


def examine(seed: int) -> BenchResult:
    """Fit all methods to both parts of one bench's low-risk run and forecast all tests."""
    ahead_of_tests = [stage for test in TESTS.values() for stage in (BACK, *test)]
    stages = (*TRAININGS[MANY], *ahead_of_tests)
    bench = run_bench(BenchParameters.random(seed, BEARING), stages, seed)
    scores: dict[str, dict[str, Scores]] = {}
    refused = {}
    shown = {}
    for title, training in TRAININGS.items():
        rows = bench.first_row(len(training))
        twins = {name: identify_twin(bench, rows, model_name=MODELS[name]) for name in MODELS}
        if not twins[TWIN].may_forecast:
            refused[title] = twins[TWIN].result.reason
        forecasters = rivals([bench.minutes.take(slice(0, rows))])
        scores[title] = {}
        stage = len(TRAININGS[MANY])
        for test, own in TESTS.items():
            first, end = bench.first_row(stage + 1), bench.first_row(stage + 1 + len(own))
            stage += 1 + len(own)
            begun = first - 1
            ahead = bench.planned(begun, end)
            now_c = {ring: float(bench.minutes.temperatures_c[ring][begun]) for ring in RINGS}
            made = {}
            for name, twin in twins.items():
                made[name] = of_ensemble(forecast_from(twin, bench, begun, ahead))
                made[HYBRIDS[name]] = hybrid(twin, bench, made[name], begun, end)
            made |= {method: forecast(ahead, now_c) for method, forecast in forecasters.items()}
            scores[title][test] = _scores(bench, made, begun, end)
            if title == MANY:
                shown[test] = Shown(
                    ahead.time_s / 3600.0,
                    bench.truth_c[RINGS[0]][begun:end],
                    {method: forecast.centre(RINGS[0]) for method, forecast in made.items()},
                )
    return BenchResult(
        seed, bench.ran_away(0, bench.first_row(len(stages))), refused, scores, shown
    )


def hybrid(
    twin: Twin, bench: BenchRun, made: SensorForecast, begun: int, end: int
) -> SensorForecast:
    """The twin's forecast with a Gaussian process on its residual in its training rows."""
    from service.lab.surrogates import fit_residual, with_residual

    training = bench.minutes.take(slice(0, twin.rows))
    residual = fit_residual([training], [twin_path(twin, bench)])
    return with_residual(made, bench.planned(begun, end), residual)


def twin_path(twin: Twin, bench: BenchRun) -> dict[str, FloatArray]:
    """What the twin says the sensors read in its training rows, running free from their first."""
    model, values = twin.model, twin.model.parameters.values_from_z(twin.posterior.z)
    profile = bench.measured(0, twin.rows)
    readings = {ring: float(bench.minutes.temperatures_c[ring][0]) for ring in RINGS}
    start, _ = initial_state(
        model, values, readings, float(profile.ambient_c[0]), 0.0, 0.0, at_rest=True
    )
    nodes = simulate(model, values, profile, start, 0.0).temperatures_c
    return {
        ring: np.interp(
            profile.time_s - twin.posterior.sensor_lag_s,
            profile.time_s,
            nodes @ model.sensor_row(ring),
        )
        for ring in RINGS
    }


def _scores(bench: BenchRun, made: Mapping[str, SensorForecast], begun: int, end: int) -> Scores:
    measured = {ring: bench.minutes.temperatures_c[ring][begun:end].copy() for ring in RINGS}
    for values in measured.values():
        values[0] = np.nan  # the present row is known, not forecast
    truth = {ring: bench.truth_c[ring][begun:end] for ring in RINGS}
    return tuple(
        one for method, forecast in made.items() for one in score(method, forecast, measured, truth)
    )


def figures_of(results: Sequence[BenchResult]) -> Document:
    """Figures of all methods over the benches whose fits may forecast."""
    used = usable(results)
    return {
        "bearing": BEARING,
        **seeds_of(results),
        "benches": len(used),
        "trainings": {
            title: {
                "rows": sum(stage.minutes for stage in training),
                "tests": {test: score_document(_means(used, title, test)) for test in TESTS},
                "hybrid_gain": {
                    twin: {test: _gain(used, title, test, twin) for test in TESTS}
                    for twin in MODELS
                },
            }
            for title, training in TRAININGS.items()
        },
        "paper": {"figures": None, "says": "kinds B and C need more data than two sensors give"},
    }


def _means(used: Sequence[BenchResult], title: str, test: str) -> Scores:
    return mean_scores([result.scores[title][test] for result in used])


def _gain(used: Sequence[BenchResult], title: str, test: str, twin: str) -> dict[str, float | None]:
    """How the hybrid's error compares with the twin's own."""
    errors = np.array(
        [
            [
                np.sqrt(np.mean([one.rms_k**2 for one in scores if one.method == method]))
                for method in (twin, HYBRIDS[twin])
            ]
            for scores in (result.scores[title][test] for result in used)
        ]
    ).reshape(-1, 2)
    if not len(errors):
        return {"twin_rms_k": None, "hybrid_rms_k": None, "benches_better": 0}
    return {
        "twin_rms_k": float(np.mean(errors[:, 0])),
        "hybrid_rms_k": float(np.mean(errors[:, 1])),
        "benches_better": int(np.sum(errors[:, 1] < errors[:, 0])),
    }


def tables(results: Sequence[BenchResult], document: Document) -> Iterator[Table]:
    """Errors and bands, by what was learned from."""
    used = usable(results)

    def columns(
        tests: Mapping[str, Scores], show: Callable[[Scores, str], str]
    ) -> list[tuple[str, Callable[[str], str]]]:
        return [("method", str), *((test, partial(show, tests[test])) for test in tests)]

    def errors(found: Scores, method: str) -> str:
        largest, crps = (of_method(found, method, name) for name in ("max_error_k", "crps_k"))
        return f"{pair(largest)}  ({pair(crps)})"

    def bands(found: Scores, method: str) -> str:
        held, width = (of_method(found, method, name) for name in ("coverage", "half_width_k"))
        return f"{percent(held)}  ({pair(width, 1)})"

    for title in TRAININGS:
        tests = {test: _means(used, title, test) for test in TESTS}
        methods = _methods(tests)
        yield table(
            f"Learned from {title}: largest error (CRPS), K, T_ir/T_or, {len(used)} benches",
            methods,
            columns(tests, errors),
            "Means over the benches; the present readings and the plan are all that is known. "
            "For a method without a band the CRPS is its mean absolute error.",
        )
        gained = {
            twin: "; ".join(
                f"{test} {text(gain['twin_rms_k'])} to {text(gain['hybrid_rms_k'])} K, "
                f"better on {gain['benches_better']} benches"
                for test, gain in by_test.items()
            )
            for twin, by_test in document["trainings"][title]["hybrid_gain"].items()
        }
        yield table(
            f"Learned from {title}: share in the 95 % band, % (its half-width, K), T_ir/T_or",
            [method for method in methods if method not in NAIVE_KINDS],
            columns(tests, bands),
            *(
                f"What the Gaussian process does to the rms error of {twin}: {gain}."
                for twin, gain in gained.items()
            ),
        )


def _methods(tests: Mapping[str, Scores]) -> list[str]:
    return list(dict.fromkeys(one.method for found in tests.values() for one in found))


def plots(results: Sequence[BenchResult], document: Document) -> dict[str, Drawing]:
    """Errors of all methods, and the forecasts of one bench."""
    used = usable(results)
    means = {title: {test: _means(used, title, test) for test in TESTS} for title in TRAININGS}
    drawn: dict[str, Drawing] = {"surrogates-errors": partial(_draw_errors, means)}
    if used:
        drawn["surrogates-forecasts"] = partial(_draw_forecasts, used[0])
    return drawn


def _draw_errors(means: Mapping[str, Mapping[str, Scores]]) -> "Figure":
    drawn = figure(12.0, 7.0)
    grid = drawn.subplots(len(TRAININGS), len(TESTS), sharey=True, squeeze=False)
    for row, (title, tests) in zip(grid, means.items(), strict=True):
        for axes, (test, found) in zip(row, tests.items(), strict=True):
            methods = _methods(tests)
            places = np.arange(len(methods))
            for shift, ring in zip((-0.2, 0.2), RINGS, strict=True):
                errors = [
                    of_method(found, method, "max_error_k")[ring] or np.nan for method in methods
                ]
                axes.barh(places + shift, errors, 0.4, label=RING_NAMES[ring])
            axes.set_yticks(places, methods)
            axes.set_title(f"{test}, learned from {title}", fontsize=10)
            axes.grid(alpha=0.3, axis="x")
            axes.set_axisbelow(True)
    grid[0, 0].invert_yaxis()
    for axes in grid[-1]:
        axes.set_xlabel("largest error, K")
    grid[0, 0].legend()
    return drawn


def _draw_forecasts(result: BenchResult) -> "Figure":
    drawn = figure(13.0, 4.5)
    row = drawn.subplots(1, len(result.shown), squeeze=False)[0]
    for axes, (test, shown) in zip(row, result.shown.items(), strict=True):
        axes.plot(shown.time_h, shown.truth_c, color="black", linewidth=2.5, label="truth")
        for method, centre_c in shown.centres_c.items():
            style = "-" if method in MODELS else ":" if method in NAIVE_KINDS else "-."
            if method in HYBRIDS.values():
                style = "--"
            axes.plot(shown.time_h, centre_c, style, linewidth=1.2, label=method)
        axes.set_title(f"{test}: T_ir of bench {result.seed}, learned from {MANY}", fontsize=10)
        axes.set_xlabel("hours ahead")
        axes.grid(alpha=0.3)
    row[0].set_ylabel("degC")
    drawn.legend(*row[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return drawn


STUDY = Study(
    "surrogates",
    lambda options: options.seeds(BENCHES),
    examine,
    figures_of,
    tables,
    plots,
    libraries=("sklearn",),
)
