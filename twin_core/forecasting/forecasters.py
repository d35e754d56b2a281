"""What every forecasting method offers, so that one can stand in for another.

A method is fitted to windows of measured rows (`Fit`) and then forecasts what the sensors will
read over a profile, from what they read at its first row (`Forecaster`). The naive forecasts and
others may be of this form; `of_ensemble` brings the twin's forecast into it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.result import Forecast
from twin_core.naive import NAIVE_KINDS, fit_naive
from twin_core.scores import QUANTILE_LEVELS
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

_MEDIAN = QUANTILE_LEVELS.index(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class SensorForecast:
    """What the sensors will read."""

    time_s: FloatArray  # (n,) times of the profile's rows
    sensors: tuple[str, ...]
    centre_c: FloatArray  # (n, s) in degC: median where there is a band, else the forecast itself
    #: (5, n, s) at `QUANTILE_LEVELS`, degC; None for a method that does not say how sure it is.
    quantiles_c: FloatArray | None = None

    def centre(self, name: str) -> FloatArray:
        """Return the (n,) path of a sensor; KeyError if there is no such sensor."""
        return np.asarray(self.centre_c[:, self._column(name)])

    def quantiles(self, name: str) -> FloatArray | None:
        """Return the (5, n) quantiles of a sensor, None without a band."""
        column = self._column(name)
        return None if self.quantiles_c is None else np.asarray(self.quantiles_c[:, :, column])

    def _column(self, name: str) -> int:
        if name not in self.sensors:
            known = ", ".join(self.sensors)
            raise KeyError(f"{name!r} is not in this forecast, expected one of {known}")
        return self.sensors.index(name)


Forecaster: TypeAlias = Callable[[OperatingProfile, Mapping[str, float]], SensorForecast]
"""Forecasts a profile, whose first row is now, from the sensors' present readings in degC."""

Fit: TypeAlias = Callable[[Sequence[MinuteData]], Forecaster]
"""Learns from windows that all have the same sensors; ValueError where nothing can be learned."""


def with_normal_band(
    time_s: FloatArray, sensors: tuple[str, ...], centre_c: FloatArray, deviation_k: FloatArray
) -> SensorForecast:
    """Make a forecast whose errors are normal with standard deviations (n, s) in K."""
    steps = np.array([NormalDist().inv_cdf(level) for level in QUANTILE_LEVELS])
    return SensorForecast(
        time_s, sensors, centre_c, centre_c + steps[:, None, None] * deviation_k[None]
    )


def of_ensemble(forecast: Forecast) -> SensorForecast:
    """Take the sensors' part of the twin's ensemble forecast."""
    quantiles_c = forecast.quantiles[:, :, : len(forecast.sensors)]
    return SensorForecast(forecast.time_s, forecast.sensors, quantiles_c[_MEDIAN], quantiles_c)


def naive_forecasters(windows: Sequence[MinuteData]) -> dict[str, Forecaster]:
    """Fit the naive models and return them as forecasters by kind; raises as `fit_naive` does."""
    models = fit_naive(windows)

    def of_kind(kind: str) -> Forecaster:
        def forecast(profile: OperatingProfile, initial_c: Mapping[str, float]) -> SensorForecast:
            by_sensor = models.forecast(profile, initial_c)[kind]
            table = np.stack([by_sensor[name] for name in models.sensors], axis=1)
            return SensorForecast(profile.time_s, models.sensors, table)

        return forecast

    return {kind: of_kind(kind) for kind in NAIVE_KINDS}
