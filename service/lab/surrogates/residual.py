"""The hybrid: a Gaussian process on what the twin gets wrong in the data it was fitted to.

The process has mean zero and short reach (`_SCALES`): where nothing like the present operating
point was seen, its mean is zero and the twin's forecast stays as it is, only its band grows by the
spread of the residuals. What it can do is repeat a structured error at a point seen before; what
it cannot is to correct an extrapolation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from service.lab.surrogates.gaussian_process import predicted, unsettled_fits
from twin_core.forecasting.forecasters import SensorForecast
from twin_core.scores import QUANTILE_LEVELS
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

# What counts as a unit of distance in speed (rpm), load (N), temperature (K) and the logarithm of
# the minutes since the operating point changed; the process reaches half to twice as far.
_SCALES = np.array([800.0, 500.0, 15.0, 1.0])
_REACH = (0.5, 2.0)
_SETTLED_MIN = 90.0
_CHANGE = (0.03, 50.0)
_MOST_ROWS = 200
_FEWEST_ROWS = 30
# The observer has just corrected the twin's state: the residual returns as the deviation of the
# twin's ensemble does.
_RETURN_S = 1800.0


@dataclass(frozen=True, slots=True, eq=False)
class ResidualModel:
    """A fitted process for every sensor.

    Attributes
    ----------
    sensors
        Names, s of them.
    processes
        From scaled features to the residual, measured minus twin, in units of ``spread_k``.
    spread_k
        (s,) rms residual in the training data.
    """

    sensors: tuple[str, ...]
    processes: tuple[GaussianProcessRegressor, ...]
    spread_k: FloatArray

    def correction(
        self, profile: OperatingProfile, centre_c: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n, s) in K along the twin's path (n, s) over a profile."""
        since = _minutes_since_change(profile.time_s, profile.speed_rpm, profile.load_n)
        returned = -np.expm1(-(profile.time_s - profile.time_s[0]) / _RETURN_S)[:, None]
        found = [
            predicted(
                process,
                _features(profile.speed_rpm, profile.load_n, centre_c[:, column], since),
            )
            for column, process in enumerate(self.processes)
        ]
        mean = np.stack([mean for mean, _ in found], axis=1)
        deviation = np.stack([deviation for _, deviation in found], axis=1)
        return returned * mean * self.spread_k, returned * deviation * self.spread_k


def fit_residual(
    windows: Sequence[MinuteData], twin_c: Sequence[Mapping[str, FloatArray]]
) -> ResidualModel:
    """Fit the process to the twin's residuals.

    Parameters
    ----------
    windows
        What the twin was identified from, with the same sensors in every window.
    twin_c
        For every window and sensor the temperatures (n,) that the twin has at the window's rows
        when it runs free from the first of them.

    Raises
    ------
    ValueError
        With fewer than 30 residuals of a sensor, or where windows and paths do not fit.
    """
    if not windows or len(windows) != len(twin_c):
        raise ValueError(
            f"{len(windows)} windows and {len(twin_c)} paths of the twin, expected as many, "
            "at least one"
        )
    sensors = windows[0].sensors
    processes, spread = [], []
    for name in sensors:
        parts = [
            _rows(window, path[name], name) for window, path in zip(windows, twin_c, strict=True)
        ]
        features = np.concatenate([part for part, _ in parts])
        residual = np.concatenate([part for _, part in parts])
        if residual.size < _FEWEST_ROWS:
            raise ValueError(f"{name}: {residual.size} residuals, expected at least {_FEWEST_ROWS}")
        chosen = slice(None, None, -(-residual.size // _MOST_ROWS))
        size = float(np.sqrt(np.mean(residual**2))) + 1e-6
        kernel = ConstantKernel(1.0, (0.1, 10.0)) * RBF(np.ones(4), _REACH)
        process = GaussianProcessRegressor(kernel + WhiteKernel(0.2, (0.01, 1.0)), random_state=0)
        with unsettled_fits():
            process.fit(features[chosen], residual[chosen] / size)
        processes.append(process)
        spread.append(size)
    return ResidualModel(sensors, tuple(processes), np.array(spread))


def with_residual(
    forecast: SensorForecast, profile: OperatingProfile, model: ResidualModel
) -> SensorForecast:
    """Add the process to the twin's forecast; where that has a band, the variances add up.

    Raises
    ------
    ValueError
        If forecast and process are not of the same sensors.
    """
    if forecast.sensors != model.sensors:
        raise ValueError(
            f"forecast of {', '.join(forecast.sensors)}, expected {', '.join(model.sensors)}"
        )
    mean, deviation = model.correction(profile, forecast.centre_c)
    centre_c = forecast.centre_c + mean
    if forecast.quantiles_c is None:
        return SensorForecast(forecast.time_s, forecast.sensors, centre_c)
    steps = ndtri(np.array(QUANTILE_LEVELS))[:, None, None]
    own = forecast.quantiles_c - forecast.centre_c
    grown = np.sign(steps) * np.hypot(own, steps * deviation)
    return SensorForecast(forecast.time_s, forecast.sensors, centre_c, centre_c + grown)


def _rows(window: MinuteData, twin_c: FloatArray, name: str) -> tuple[FloatArray, FloatArray]:
    if twin_c.shape != window.time_s.shape:
        raise ValueError(
            f"{name}: the twin's path has shape {twin_c.shape}, expected {window.time_s.shape}"
        )
    known = window.good & np.isfinite(window.temperatures_c[name])
    rows = window.take(known)
    since = _minutes_since_change(rows.time_s, rows.speed_rpm, rows.load_n)
    features = _features(rows.speed_rpm, rows.load_n, twin_c[known], since)
    return features, rows.temperatures_c[name] - twin_c[known]


def _features(
    speed_rpm: FloatArray, load_n: FloatArray, temperature_c: FloatArray, since_min: FloatArray
) -> FloatArray:
    columns = (np.abs(speed_rpm), load_n, temperature_c, np.log1p(since_min))
    return np.asarray(np.stack(columns, axis=1) / _SCALES)


def _minutes_since_change(
    time_s: FloatArray, speed_rpm: FloatArray, load_n: FloatArray
) -> FloatArray:
    """Minutes since speed or load last changed, at most 90, which is also what rows begin with."""
    since = np.empty(time_s.size)
    changed_s = -np.inf
    reference = (np.nan, np.nan)
    relative, absolute = _CHANGE
    for row, point in enumerate(zip(np.abs(speed_rpm).tolist(), load_n.tolist(), strict=True)):
        moved = any(
            abs(value - before) > relative * abs(before) + absolute
            for value, before in zip(point, reference, strict=True)
        )
        if moved or row == 0:
            reference = point
        if moved:
            changed_s = float(time_s[row])
        since[row] = min((float(time_s[row]) - changed_s) / 60.0, _SETTLED_MIN)
    return since
