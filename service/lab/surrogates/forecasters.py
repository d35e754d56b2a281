"""Surrogates as forecasters: a fitted map of steady temperatures, approached with a common lag."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from service.lab.surrogates.lag import LaggedPoints, approach, fit_lag, inputs_of
from service.lab.surrogates.maps import SteadyMap, SurrogateKind, fit_map
from twin_core.forecasting.forecasters import Forecaster, SensorForecast, with_normal_band
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

SURROGATE_KINDS: tuple[SurrogateKind, ...] = get_args(SurrogateKind)


@dataclass(frozen=True, slots=True, eq=False)
class Surrogate:
    """A fitted surrogate; call it as a `Forecaster`.

    Attributes
    ----------
    lag
        The approach to the steady values, common to all kinds, and the points learned from.
    steady
        The map of steady values.
    training_rms_k
        (s,) error of free runs over the training windows; part of the band.
    """

    lag: LaggedPoints
    steady: SteadyMap
    training_rms_k: FloatArray

    def __call__(self, profile: OperatingProfile, initial_c: Mapping[str, float]) -> SensorForecast:
        """Forecast; a sensor whose present reading is not finite starts at its steady value."""
        steady_k, deviation_k = self.steady.predict(inputs_of(profile))
        now_k = np.array([initial_c[name] for name in self.lag.sensors]) - profile.ambient_c[0]
        start_k = np.where(np.isfinite(now_k), now_k, steady_k[0])
        path = approach(profile, start_k, steady_k, self.lag.generator_per_s)
        centre_c = profile.ambient_c[:, None] + path
        if deviation_k is None:
            return SensorForecast(profile.time_s, self.lag.sensors, centre_c)
        # The steady values of a span err together: their error grows along the same lag.
        grown = approach(profile, np.zeros_like(start_k), deviation_k, self.lag.generator_per_s)
        return with_normal_band(
            profile.time_s, self.lag.sensors, centre_c, np.hypot(grown, self.training_rms_k)
        )


def fit_surrogate(kind: SurrogateKind, windows: Sequence[MinuteData]) -> Surrogate:
    """Fit one surrogate.

    Parameters
    ----------
    kind
        One of `SURROGATE_KINDS`.
    windows
        Rows with the same sensors in every window.

    Raises
    ------
    ValueError
        For an unknown kind, or where no operating point was held long enough to learn from.
    """
    return _fit(kind, fit_lag(windows), windows)


def surrogate_forecasters(windows: Sequence[MinuteData]) -> dict[str, Forecaster]:
    """Fit all surrogates on the same lag; raises as `fit_surrogate` does."""
    lag = fit_lag(windows)
    return {kind: _fit(kind, lag, windows) for kind in SURROGATE_KINDS}


def _fit(kind: SurrogateKind, lag: LaggedPoints, windows: Sequence[MinuteData]) -> Surrogate:
    steady = fit_map(kind, lag.points, lag.steady_k)
    plain = Surrogate(lag, steady, np.zeros(len(lag.sensors)))
    return Surrogate(lag, steady, _training_rms(plain, windows))


def _training_rms(surrogate: Surrogate, windows: Sequence[MinuteData]) -> FloatArray:
    """Rms error (s,) of free runs over the windows, each from its first row."""
    sensors = surrogate.lag.sensors
    squares, count = np.zeros(len(sensors)), np.zeros(len(sensors))
    for window in windows:
        rows = window.take(window.good)
        if rows.size < 2:
            continue
        profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
        measured = np.stack([rows.temperatures_c[name] for name in sensors], axis=1)
        start = dict(zip(sensors, measured[0].tolist(), strict=True))
        errors = surrogate(profile, start).centre_c - measured
        squares += np.nansum(errors**2, axis=0)
        count += np.sum(np.isfinite(errors), axis=0)
    return np.asarray(np.sqrt(squares / np.maximum(count, 1.0)))
