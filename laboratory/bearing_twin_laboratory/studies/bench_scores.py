"""Scores of forecasts for bench runs, and their figures over several benches.

Errors are against the noise-free temperatures of the bench, coverage and the scores of bands
against what the sensors read.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies.bench_runs import NODES, RINGS, BenchRun, Twin, with_sensors
from bearing_twin_laboratory.studies.forecasters import TWIN, ForecastScore, score
from bearing_twin_laboratory.studies.study import Table, mean, share, table, text
from twin_core import scores
from twin_core.forecasting import Forecast, naive_forecasters, of_ensemble
from twin_core.simulation import OperatingProfile

FloatArray = NDArray[np.float64]

LEAST_COVERAGE = 0.8
"""A bench below this share is named: its band was wrong."""


@dataclass(frozen=True, slots=True)
class Score:
    """How good a forecast of one ring sensor was over some rows.

    - ``max_error_k``, ``rms_error_k``: median against the noise-free temperature.
    - ``rise_max_k``: largest error before the steady phases; 0 where there is no such row.
    - ``steady_error_k``, ``steady_bias_k``: mean of the absolute and of the signed error over the
      steady phases.
    - ``coverage_95``, ``rise_coverage_95``, ``steady_coverage_95``: share of the readings inside
      the 95 % band: of all, and of the two phases (that of the rise, where it has no row, is that
      of all).
    - ``half_width_k``: half the mean width of the band.
    - ``interval_score_k``, ``crps_k``: of the readings.
    - ``r_squared``: of the median against the readings.
    """

    max_error_k: float
    rms_error_k: float
    rise_max_k: float
    steady_error_k: float
    steady_bias_k: float
    coverage_95: float
    rise_coverage_95: float
    steady_coverage_95: float
    half_width_k: float
    interval_score_k: float
    crps_k: float
    r_squared: float


RingScores = Mapping[str, Score]
"""The scores of both rings."""


def score_rings(
    made: Forecast,
    run: BenchRun,
    begun: int,
    first: int,
    end: int,
    counts: NDArray[np.bool_] | None = None,
) -> RingScores:
    """Score a forecast over the rows from ``first`` to before ``end``.

    - ``made``: a forecast whose first row is row ``begun`` of the run.
    - ``run``: what then happened.
    - ``begun``, ``first``, ``end``: rows of the run.
    - ``counts``: (end - first,) which of them count; all of them by default.
    """
    chosen = np.arange(first, end) if counts is None else first + np.flatnonzero(counts)
    return {name: _score(made, run, name, chosen, begun) for name in RINGS}


def _score(made: Forecast, run: BenchRun, sensor: str, rows: NDArray[np.intp], begun: int) -> Score:
    ahead = rows - begun
    low, _, median, _, high = made.quantile(sensor)[:, ahead]
    measured = run.minutes.temperatures_c[sensor][rows]
    error = median - run.truth_c[sensor][rows]
    steady = run.steady(int(rows[0]), int(rows[-1]) + 1)[rows - rows[0]]

    def covered(rows: NDArray[np.bool_]) -> float:
        return scores.coverage(low[rows], high[rows], measured[rows])

    whole = scores.coverage(low, high, measured)
    return Score(
        max_error_k=float(np.max(np.abs(error))),
        rms_error_k=float(np.sqrt(np.mean(error**2))),
        rise_max_k=float(np.max(np.abs(error[~steady]), initial=0.0)),
        steady_error_k=float(np.mean(np.abs(error[steady]))),
        steady_bias_k=float(np.mean(error[steady])),
        coverage_95=whole,
        rise_coverage_95=whole if steady.all() else covered(~steady),
        steady_coverage_95=covered(steady),
        half_width_k=float(0.5 * np.mean(high - low)),
        interval_score_k=scores.interval_score(low, high, measured),
        crps_k=scores.crps_from_members(
            made.members_c[:, ahead, made.sensors.index(sensor)], measured
        ),
        r_squared=scores.r_squared(median, measured),
    )


def node_errors(made: Forecast, run: BenchRun, begun: int, first: int, end: int) -> FloatArray:
    """Median minus truth of the paper's 13 nodes, (13, rows)."""
    ahead = slice(first - begun, end - begun)
    return np.array(
        [made.quantile(name)[2, ahead] - run.truth_c[name][first:end] for name in NODES]
    )


def node_coverage(made: Forecast, run: BenchRun, begun: int, first: int, end: int) -> FloatArray:
    """Share of the rows at which a node's true temperature lies inside its 95 % band, (13,)."""
    ahead = slice(first - begun, end - begun)
    return np.array(
        [
            scores.coverage(
                made.quantile(name)[0, ahead],
                made.quantile(name)[-1, ahead],
                run.truth_c[name][first:end],
            )
            for name in NODES
        ]
    )


def beside(
    twin: Twin,
    run: BenchRun,
    made: Forecast,
    ahead: OperatingProfile,
    begun: int,
    spans: Sequence[tuple[int, int]],
) -> list[tuple[ForecastScore, ...]]:
    """The twin and the naive methods next to it, scored over one span of rows after another.

    - ``twin``, ``made``, ``ahead``: the twin, its forecast and what that was made for.
    - ``run``: what then happened.
    - ``begun``: row of the run at which the forecasts begin.
    - ``spans``: first row, and the row after the last, of each span.
    """
    low = with_sensors(run.minutes.take(slice(0, twin.rows)), RINGS)
    initial = {name: float(run.minutes.temperatures_c[name][begun]) for name in RINGS}
    forecasts = {TWIN: of_ensemble(made)}
    for method, forecaster in naive_forecasters([low]).items():
        forecasts[method] = forecaster(ahead, initial)
    rows = np.arange(begun, begun + ahead.size)
    truth = {name: run.truth_c[name][rows] for name in RINGS}
    found = []
    for first, end in spans:
        counts = (rows >= first) & (rows < end)
        measured = {
            name: np.where(counts, run.minutes.temperatures_c[name][rows], np.nan) for name in RINGS
        }
        scored: tuple[ForecastScore, ...] = ()
        for method, one in forecasts.items():
            scored += score(method, one, measured, truth)
        found.append(scored)
    return found


def figures(found: Sequence[RingScores]) -> dict[str, object]:
    """Figures of one condition over its benches, plain JSON types; None without any bench.

    Every ``_c`` and ``_by_sensor`` is given per sensor; means over benches but for ``worst_…``.
    """
    by_sensor = {
        field.name: {ring: _column(found, ring, field.name) for ring in RINGS}
        for field in fields(Score)
    }

    def mean_of(name: str) -> dict[str, float | None]:
        return {ring: mean(values) for ring, values in by_sensor[name].items()}

    def over_all(name: str) -> float | None:
        return mean([value for values in by_sensor[name].values() for value in values])

    def worst(name: str, of: Any) -> dict[str, float | None]:
        return {ring: of(values) if values else None for ring, values in by_sensor[name].items()}

    return {
        "benches": len(found),
        "max_error_c": mean_of("max_error_k"),
        "worst_max_error_c": worst("max_error_k", max),
        "rms_error_k": over_all("rms_error_k"),
        "rms_error_by_sensor_k": mean_of("rms_error_k"),
        "rise_max_c": mean_of("rise_max_k"),
        "steady_error_c": mean_of("steady_error_k"),
        "worst_steady_error_c": worst("steady_error_k", max),
        "steady_bias_c": mean_of("steady_bias_k"),
        "coverage_95": over_all("coverage_95"),
        "coverage_95_by_sensor": mean_of("coverage_95"),
        "worst_coverage_95": worst("coverage_95", min),
        "benches_covered_below_80_percent": {
            ring: sum(value < LEAST_COVERAGE for value in values)
            for ring, values in by_sensor["coverage_95"].items()
        },
        "rise_coverage_95": over_all("rise_coverage_95"),
        "steady_coverage_95": over_all("steady_coverage_95"),
        "half_width_c": mean_of("half_width_k"),
        "interval_score_c": mean_of("interval_score_k"),
        "crps_c": mean_of("crps_k"),
        "r_squared": mean_of("r_squared"),
    }


def _column(found: Sequence[RingScores], ring: str, name: str) -> list[float]:
    return [float(getattr(one[ring], name)) for one in found]


def pair(by_sensor: Mapping[str, float | None] | None, digits: int = 2) -> str:
    """Both rings' figures as they stand in the tables, inner ring first."""
    if by_sensor is None:
        return "–"
    return "/".join(text(by_sensor[ring], digits) for ring in RINGS)


def percent(by_sensor: Mapping[str, float | None]) -> str:
    """Both rings' shares in percent, inner ring first."""
    return "/".join(share(by_sensor[ring]) for ring in RINGS)


def phases(found: Mapping[str, float | None]) -> str:
    """Coverage before the last half hours of the stages, and in them."""
    return f"{text(found['rise_coverage_95'])}/{text(found['steady_coverage_95'])}"


def methods_tables(
    title: str, conditions: Mapping[str, Sequence[ForecastScore]]
) -> tuple[Table, Table]:
    """The twin and the methods next to it, one row each: largest errors, and scores.

    - ``conditions``: mean scores by condition.
    """
    methods = dict.fromkeys(one.method for found in conditions.values() for one in found)

    def of(condition: str, figure: str) -> Callable[[str], str]:
        return lambda method: pair(of_method(conditions[condition], method, figure))

    def one_table(what: str, figure: str, note: str) -> Table:
        columns = [(condition, of(condition, figure)) for condition in conditions]
        heading = f"{title}: {what}, K, T_ir/T_or"
        return table(heading, methods, [("method", str), *columns], note)

    return (
        one_table(
            "largest error",
            "max_error_k",
            "Means over the benches. All methods learn from the same rows and know the same "
            "operation ahead.",
        ),
        one_table(
            "CRPS",
            "crps_k",
            "Continuous ranked probability score of the readings; for a method without a band its "
            "mean absolute error.",
        ),
    )


def of_method(found: Iterable[ForecastScore], method: str, figure: str) -> dict[str, float | None]:
    """One figure of one method for both rings; None where it has none."""
    own = {one.sensor: getattr(one, figure) for one in found if one.method == method}
    return {ring: own.get(ring) for ring in RINGS}
