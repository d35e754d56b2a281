"""Forecasts with honest intervals, and the naive ones that they must beat."""

from twin_core.forecasting.ensemble import (
    QUANTILE_LEVELS,
    Exceedance,
    Forecast,
    forecast,
)
from twin_core.forecasting.forecasters import (
    Fit,
    Forecaster,
    SensorForecast,
    of_ensemble,
    with_normal_band,
)
from twin_core.forecasting.naive import (
    NAIVE_KINDS,
    NaiveForecasts,
    fit_naive,
    naive_forecasters,
    naive_rms,
)

__all__ = [
    "NAIVE_KINDS",
    "QUANTILE_LEVELS",
    "Exceedance",
    "Fit",
    "Forecast",
    "Forecaster",
    "NaiveForecasts",
    "SensorForecast",
    "fit_naive",
    "forecast",
    "naive_forecasters",
    "naive_rms",
    "of_ensemble",
    "with_normal_band",
]
