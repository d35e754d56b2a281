"""The table that stands next to every forecast of a study: the twin, and what it must beat.

All methods learn from the same rows, know the same profile ahead and the same readings at its
first row, and are scored against the same temperatures.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.lab.studies.common import Table
from twin_core import scores
from twin_core.forecasting import (
    QUANTILE_LEVELS,
    Forecast,
    Forecaster,
    SensorForecast,
    naive_forecasters,
    of_ensemble,
)
from twin_core.simulation import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

TWIN = "twin"


@dataclass(frozen=True, slots=True)
class ForecastScore:
    """How one method did on one sensor; the means over runs where there are several.

    Attributes
    ----------
    method, sensor
        Which.
    max_error_k, rms_k
        Of the centre.
    coverage, half_width_k, interval_score_k
        Of the 95 % band; None for a method without one.
    crps_k
        Continuous ranked probability score, for a method without a band its mean absolute error.
    """

    method: str
    sensor: str
    max_error_k: float
    rms_k: float
    coverage: float | None
    half_width_k: float | None
    interval_score_k: float | None
    crps_k: float


def compare(
    training: Sequence[MinuteData],
    ahead: OperatingProfile,
    initial_c: Mapping[str, float],
    measured_c: Mapping[str, FloatArray],
    twin: Forecast | SensorForecast,
    truth_c: Mapping[str, FloatArray] | None = None,
) -> tuple[ForecastScore, ...]:
    """Score the twin and the methods next to it.

    Parameters
    ----------
    training
        Windows that the twin was identified from; all methods learn from them.
    ahead
        n rows; the first is now.
    initial_c
        What every sensor reads now.
    measured_c
        (n,) temperatures by sensor; NaN at rows that do not count.
    twin
        Its forecast over the same rows.
    truth_c
        (n,) noise-free temperatures by sensor, where they are known: then errors are against them,
        while bands are always scored against the measurements.

    Raises
    ------
    ValueError
        If the twin's rows are not those of the profile.
    """
    own = of_ensemble(twin) if isinstance(twin, Forecast) else twin
    if not np.array_equal(own.time_s, ahead.time_s):
        raise ValueError(
            f"the twin's forecast has {own.time_s.size} rows, expected the {ahead.size} rows of "
            "the profile"
        )
    found = score(TWIN, own, measured_c, truth_c)
    for method, forecaster in rivals(training).items():
        found += score(method, forecaster(ahead, initial_c), measured_c, truth_c)
    return found


def rivals(training: Sequence[MinuteData]) -> dict[str, Forecaster]:
    """Fit every method that is compared with the twin.

    Those are the naive forecasts and, where scikit-learn is installed and some operating point was
    held long enough to learn from, the surrogates.
    """
    found = naive_forecasters(training)
    if find_spec("sklearn") is not None:
        from service.lab.surrogates import surrogate_forecasters

        with suppress(ValueError):
            found |= surrogate_forecasters(training)
    return found


def score(
    method: str,
    forecast: SensorForecast,
    measured_c: Mapping[str, FloatArray],
    truth_c: Mapping[str, FloatArray] | None = None,
) -> tuple[ForecastScore, ...]:
    """Score one method's forecast on every sensor that was measured at all; see `compare`."""
    found = []
    for name, values_c in measured_c.items():
        known = np.isfinite(values_c)
        if not known.any():
            continue
        target_c = values_c if truth_c is None else np.where(known, truth_c[name], np.nan)
        centre_c, quantiles_c = forecast.centre(name), forecast.quantiles(name)
        coverage = half_width_k = interval_score_k = None
        if quantiles_c is None:
            crps_k = float(np.nanmean(np.abs(centre_c - values_c)))
        else:
            lower_c, upper_c = quantiles_c[0], quantiles_c[-1]
            coverage = scores.coverage(lower_c, upper_c, values_c)
            half_width_k = float(np.mean((upper_c - lower_c)[known]) / 2.0)
            interval_score_k = scores.interval_score(lower_c, upper_c, values_c)
            crps_k = scores.crps_from_quantiles(quantiles_c, QUANTILE_LEVELS, values_c)
        found.append(
            ForecastScore(
                method,
                name,
                scores.max_error(centre_c, target_c),
                scores.rms(centre_c, target_c),
                coverage,
                half_width_k,
                interval_score_k,
                crps_k,
            )
        )
    return tuple(found)


def mean_scores(runs: Sequence[Sequence[ForecastScore]]) -> tuple[ForecastScore, ...]:
    """Means over runs, by method and sensor in the order of their first appearance.

    A run whose method failed with an infinite error makes the mean infinite.
    """
    groups: dict[tuple[str, str], list[ForecastScore]] = {}
    for run in runs:
        for one in run:
            groups.setdefault((one.method, one.sensor), []).append(one)
    figures = [field.name for field in fields(ForecastScore)][2:]
    return tuple(
        ForecastScore(
            *key, **{name: _mean([getattr(one, name) for one in group]) for name in figures}
        )
        for key, group in groups.items()
    )


def _mean(values: Sequence[float | None]) -> Any:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def score_table(
    found: Sequence[ForecastScore],
    title: str = "The twin beside naive forecasts and surrogates",
    notes: Sequence[str] = (),
) -> Table:
    """One row per method; a cell holds the sensors' figures in their order."""
    methods = list(dict.fromkeys(one.method for one in found))
    sensors = list(dict.fromkeys(one.sensor for one in found))
    by_key = {(one.method, one.sensor): one for one in found}
    rows = []
    for method in methods:
        of_sensors = [by_key[method, sensor] for sensor in sensors if (method, sensor) in by_key]
        rows.append(
            (
                method,
                _cell([one.max_error_k for one in of_sensors]),
                _cell([one.rms_k for one in of_sensors]),
                _cell([one.crps_k for one in of_sensors]),
                _cell([one.coverage for one in of_sensors], "{:.0%}"),
                _cell([one.half_width_k for one in of_sensors]),
                _cell([one.interval_score_k for one in of_sensors]),
            )
        )
    return Table(
        title,
        (
            "method",
            "max error, K",
            "rms, K",
            "CRPS, K",
            "95 % band covers",
            "half-width, K",
            "interval score, K",
        ),
        tuple(rows),
        (
            f"Figures of {' / '.join(sensors)}. A method without a band has no coverage, and its "
            "CRPS is its mean absolute error.",
            *notes,
        ),
    )


def _cell(values: Sequence[float | None], form: str = "{:.2f}") -> str:
    return " / ".join("–" if value is None else form.format(value) for value in values)


def score_document(found: Sequence[ForecastScore]) -> dict[str, dict[str, dict[str, Any]]]:
    """Plain JSON types: method, then sensor, then figures; None where one is not finite."""
    document: dict[str, dict[str, dict[str, Any]]] = {}
    for one in found:
        figures = asdict(one)
        method, sensor = figures.pop("method"), figures.pop("sensor")
        document.setdefault(method, {})[sensor] = {
            name: value if value is not None and np.isfinite(value) else None
            for name, value in figures.items()
        }
    return document
