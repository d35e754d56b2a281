"""The forecasts that a twin must beat: persistence, a static linear model, ARX.

All are fitted on the same rows as the twin and know speed, load and ambient of the span ahead, as
the twin does. They are meant to be strong: what a twin is worth shows against the best simple
forecast, not against a careless one.

``persistence``
    Every sensor stays as it is now.
``static_linear``
    Steady excess over ambient, linear in speed and load, fitted to settled rows; no inertia.
``arx``
    Excesses of all sensors in the next row, linear in those of this row, speed and load; least
    squares, damped where it would run away. On random virtual benches a ridge penalty changed
    nothing up to a thousandth of the regressors' variance, with two sensors or with thirteen;
    steps of five minutes or a product of speed and load were better in some tests and worse in
    others. So it stays what textbooks mean by ARX.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core.operating_points import STANDING_RPM, split
from twin_core.scores import rms
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

NAIVE_KINDS = ("persistence", "static_linear", "arx")

# A settled row lies in the later half of an operating point that lasted at least so long.
_SETTLED_AFTER_S = 1800.0
# Speed or load that varies less than this share of its largest value teaches no coefficient.
_LEAST_VARIATION = 0.05
_LARGEST_RADIUS = 0.9999


@dataclass(frozen=True, slots=True, eq=False)
class NaiveForecasts:
    """Fitted naive models of all sensors."""

    sensors: tuple[str, ...]  # names, s of them
    static: FloatArray  # (3, s) excess over ambient of the steady state per (1, krpm, kN)
    transition: FloatArray  # (s, s) how the excesses of one row carry over to the next
    drive: FloatArray  # (3, s) what (1, krpm, kN) add per row
    spacing_s: float  # time between two rows of the ARX model

    def forecast(
        self, profile: OperatingProfile, last_c: Mapping[str, float]
    ) -> dict[str, dict[str, FloatArray]]:
        """Forecast all sensors with all naive models over n rows; the first is now.

        `last_c` are the last measured temperatures. Returns kind to sensor to (n,) temperatures in
        degC.
        """
        now_c = np.array([last_c[name] for name in self.sensors])
        inputs = _inputs(profile.speed_rpm, profile.load_n)
        static = profile.ambient_c[:, None] + inputs @ self.static
        tables = {
            "persistence": np.tile(now_c, (profile.size, 1)),
            "static_linear": static,
            "arx": self._run_on(profile, inputs, now_c),
        }
        return {
            kind: {name: table[:, column].copy() for column, name in enumerate(self.sensors)}
            for kind, table in tables.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "sensors": list(self.sensors),
            "static": self.static.tolist(),
            "transition": self.transition.tolist(),
            "drive": self.drive.tolist(),
            "spacing_s": self.spacing_s,
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "NaiveForecasts":
        """Take back what `to_dict` gave.

        Raises `ValueError` if something is missing or does not belong together.
        """
        try:
            sensors = tuple(str(name) for name in document["sensors"])
            static, transition, drive = (
                np.array(document[name], np.float64) for name in ("static", "transition", "drive")
            )
            spacing_s = float(document["spacing_s"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"naive forecasts: {error!r}") from error
        count = len(sensors)
        shapes = (static.shape, transition.shape, drive.shape)
        if shapes != ((3, count), (count, count), (3, count)) or not spacing_s > 0.0:
            raise ValueError(f"naive forecasts: shapes {shapes} of {count} sensors")
        return cls(sensors, static, transition, drive, spacing_s)

    def _run_on(
        self, profile: OperatingProfile, inputs: FloatArray, now_c: FloatArray
    ) -> FloatArray:
        end_s = float(profile.time_s[-1] - profile.time_s[0])
        steps = int(np.ceil(end_s / self.spacing_s))
        grid_s = profile.time_s[0] + self.spacing_s * np.arange(steps + 1)
        rows = np.clip(
            np.searchsorted(profile.time_s, grid_s + 1e-6, side="right") - 1, 0, profile.size - 1
        )
        excess = np.empty((steps + 1, len(self.sensors)))
        excess[0] = now_c - profile.ambient_c[0]
        drive = inputs[rows] @ self.drive
        for step in range(steps):
            excess[step + 1] = excess[step] @ self.transition + drive[step]
        at_rows = [np.interp(profile.time_s, grid_s, column) for column in excess.T]
        return np.asarray(np.stack(at_rows, axis=1) + profile.ambient_c[:, None])


def fit_naive(windows: Sequence[MinuteData]) -> NaiveForecasts:
    """Fit the naive models by least squares.

    A coefficient of speed or load is only fitted where the rows vary in it, otherwise it is zero.
    An ARX model that would run away is damped until it does not.

    `windows`: rows with the same sensors in every window. Raises `ValueError` without rows, or
    where the windows differ in their sensors.
    """
    if not windows:
        raise ValueError("no windows, expected at least one")
    sensors = windows[0].sensors
    if any(window.sensors != sensors for window in windows):
        raise ValueError("the windows differ in their sensors")
    good = [window.take(window.good) for window in windows]
    spacing_s = float(np.median(np.concatenate([np.diff(rows.time_s) for rows in good])))
    excess = [_excess(rows) for rows in good]
    inputs = [_inputs(rows.speed_rpm, rows.load_n) for rows in good]
    settled = [_settled(rows, spacing_s) for rows in good]
    if not any(chosen.any() for chosen in settled):
        settled = [np.abs(rows.speed_rpm) >= STANDING_RPM for rows in good]
    static = _fit(
        np.concatenate([u[chosen] for u, chosen in zip(inputs, settled, strict=True)]),
        np.concatenate([y[chosen] for y, chosen in zip(excess, settled, strict=True)]),
    )
    before, after, driven = [], [], []
    for rows, y, u in zip(good, excess, inputs, strict=True):
        follows = np.flatnonzero(np.abs(np.diff(rows.time_s) - spacing_s) < 0.5 * spacing_s)
        before.append(y[follows])
        after.append(y[follows + 1])
        driven.append(u[follows])
    coefficients = _fit(
        np.concatenate(driven), np.concatenate(after), always=np.concatenate(before)
    )
    transition = coefficients[3:]
    radius = float(np.max(np.abs(np.linalg.eigvals(transition)))) if transition.size else 0.0
    if radius > _LARGEST_RADIUS:
        transition = transition * (_LARGEST_RADIUS / radius)
    return NaiveForecasts(sensors, static, transition, coefficients[:3], spacing_s)


def naive_rms(
    training: Sequence[MinuteData], test: MinuteData
) -> dict[str, dict[str, float | None]]:
    """Return kind to sensor to rms error in K of forecasts over ``test``, made at its first row.

    None where a sensor has no good value.
    """
    models = fit_naive(training)
    rows = test.take(test.good)
    profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
    last_c = {}
    for name, values in rows.temperatures_c.items():
        known = values[np.isfinite(values)]
        last_c[name] = float(known[0]) if known.size else float("nan")
    forecasts = models.forecast(profile, last_c)
    scores: dict[str, dict[str, float | None]] = {}
    for kind, by_sensor in forecasts.items():
        scores[kind] = {}
        for name, values in by_sensor.items():
            score = rms(values, rows.temperatures_c[name])
            scores[kind][name] = score if np.isfinite(score) else None
    return scores


def _inputs(speed_rpm: FloatArray, load_n: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(speed_rpm), np.abs(speed_rpm) / 1e3, load_n / 1e3], axis=1)


def _excess(rows: MinuteData) -> FloatArray:
    return np.stack([rows.temperatures_c[name] - rows.ambient_c for name in rows.sensors], axis=1)


def _settled(rows: MinuteData, spacing_s: float) -> NDArray[np.bool_]:
    chosen = np.zeros(rows.size, dtype=np.bool_)
    for point in split(rows.time_s, rows.speed_rpm, rows.load_n, spacing_s):
        if point.duration_s >= _SETTLED_AFTER_S:
            middle_s = point.start_s + 0.5 * point.duration_s
            chosen |= (rows.time_s >= middle_s) & (rows.time_s < point.end_s)
    return chosen


def _fit(inputs: FloatArray, targets: FloatArray, always: FloatArray | None = None) -> FloatArray:
    """Least squares of every target column; coefficients of inputs without variation are zero."""
    features = inputs if always is None else np.hstack([inputs, always])
    coefficients = np.zeros((features.shape[1], targets.shape[1]))
    used = np.ones(features.shape[1], dtype=np.bool_)
    for column in (1, 2):
        values = inputs[:, column]
        used[column] = values.size > 0 and np.ptp(values) > _LEAST_VARIATION * np.max(values)
    known = np.all(np.isfinite(features), axis=1)
    for column in range(targets.shape[1]):
        rows = known & np.isfinite(targets[:, column])
        solution, *_ = np.linalg.lstsq(features[rows][:, used], targets[rows, column], rcond=None)
        coefficients[used, column] = solution
    return coefficients
