"""Forecasts with honest intervals, and the naive ones that they must beat."""

from twin_core.forecasting.ensemble import (
    QUANTILE_LEVELS,
    RUNAWAY_C,
    Exceedance,
    Forecast,
    forecast,
)
from twin_core.forecasting.naive import NAIVE_KINDS, NaiveForecasts, fit_naive, naive_rms

__all__ = [
    "NAIVE_KINDS",
    "QUANTILE_LEVELS",
    "RUNAWAY_C",
    "Exceedance",
    "Forecast",
    "NaiveForecasts",
    "fit_naive",
    "forecast",
    "naive_rms",
]
