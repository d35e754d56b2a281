"""The table that stands next to every forecast of a study: the twin, and what it must beat.

All methods learn from the same rows, know the same profile ahead and the same readings at its
first row, and are scored against the same temperatures.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies.study import mean
from twin_core import scores
from twin_core.forecasting import (
    QUANTILE_LEVELS,
    SensorForecast,
)

FloatArray = NDArray[np.float64]

TWIN = "twin"


@dataclass(frozen=True, slots=True)
class ForecastScore:
    """How one method did on one sensor; the means over runs where there are several.

    - ``max_error_k``, ``rms_k``: of the centre.
    - ``coverage``, ``half_width_k``, ``interval_score_k``: of the 95 % band; None for a method
      without one.
    - ``crps_k``: continuous ranked probability score, for a method without a band its mean absolute
      error.
    """

    method: str
    sensor: str
    max_error_k: float
    rms_k: float
    coverage: float | None
    half_width_k: float | None
    interval_score_k: float | None
    crps_k: float


def score(
    method: str,
    forecast: SensorForecast,
    measured_c: Mapping[str, FloatArray],
    truth_c: Mapping[str, FloatArray] | None = None,
) -> tuple[ForecastScore, ...]:
    """Score one method's forecast on every sensor that was measured at all.

    Errors are against the truth where it is known, bands always against the readings.
    """
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
            *key, **{name: _mean_known(getattr(one, name) for one in group) for name in figures}
        )
        for key, group in groups.items()
    )


def _mean_known(values: Iterable[float | None]) -> Any:
    return mean(value for value in values if value is not None)


def score_document(found: Sequence[ForecastScore]) -> dict[str, dict[str, dict[str, float | None]]]:
    """Plain JSON types: method, then sensor, then figures; None where one is not finite."""
    document: dict[str, dict[str, dict[str, float | None]]] = {}
    for one in found:
        figures = asdict(one)
        method, sensor = figures.pop("method"), figures.pop("sensor")
        document.setdefault(method, {})[sensor] = {
            name: value if value is not None and np.isfinite(value) else None
            for name, value in figures.items()
        }
    return document
