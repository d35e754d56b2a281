"""Forecasts with honest intervals, and the naive ones that they must beat."""

from twin_core.forecasting.ensemble import forecast
from twin_core.forecasting.forecasters import (
    Fit,
    Forecaster,
    SensorForecast,
    naive_forecasters,
    of_ensemble,
    with_normal_band,
)
from twin_core.forecasting.result import Exceedance, Forecast
from twin_core.scores import QUANTILE_LEVELS

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
