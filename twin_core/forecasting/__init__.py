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
    naive_forecasters,
    of_ensemble,
    with_normal_band,
)

__all__ = [
    "QUANTILE_LEVELS",
    "Exceedance",
    "Fit",
    "Forecast",
    "Forecaster",
    "SensorForecast",
    "forecast",
    "naive_forecasters",
    "of_ensemble",
    "with_normal_band",
]
