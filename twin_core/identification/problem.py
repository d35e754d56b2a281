"""The identification of one model from one data set as a least-squares problem.

Unknowns are the model's standard coordinates z (prior N(0, 1) each, or a narrower one), the lag of
the temperature sensors, and for every window standard coordinates of its initial temperatures:
around what its first measurements suggest, or one common deviation from ambient if the machine
stood at standstill. Residuals are those of all sensors and the unknowns' deviations from their
priors, all whitened; half the sum of their squares is the negative log posterior.
"""

from collections.abc import Mapping
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.costs import SUM_OF_SQUARES, Cost, failed_as_infinite
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.priors import NormalPrior, literature_prior
from twin_core.identification.whitening import Loss, Whitening, whitening
from twin_core.initial_state import initial_state
from twin_core.models import ThermalModel
from twin_core.process_noise import reading_errors
from twin_core.simulation import (
    OperatingProfile,
    SimulationError,
    hold_operating_point,
    simulate_batch,
    simulate_sensitivities,
)
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

_INITIAL_STATE_LIMIT = 6.0
# A machine that stood still is at the temperature of its surroundings, give or take a day's swing.
_REST_SPREAD_K = 0.3
# A PT100 in its bore follows within some 5 to 30 s. Unaccounted for, that looks like a weaker
# dependence of the friction on temperature wherever a temperature climbs.
SENSOR_LAG_S = 15.0
_LAG_SPREAD_S, _LONGEST_LAG_S = 10.0, 45.0


@dataclass(frozen=True, slots=True, eq=False)
class _Channel:
    """A sensor's good values in one window: where and what, in rows at known times.

    The sensor's lag is looked up by interpolation between the rows. Where every row is longer than
    any lag, the row before alone is near enough, and `since_before_s` says how far it is.
    """

    name: str
    row: FloatArray
    index: NDArray[np.intp]
    measured_c: FloatArray
    whitening: Whitening
    since_before_s: FloatArray
    time_s: FloatArray

    @property
    def _rows_are_long(self) -> bool:
        return bool(np.min(self.since_before_s) >= _LONGEST_LAG_S)

    def _earlier(self, lag_s: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Row before the moment that each value shows, and the part of the way to the next."""
        then_s = np.maximum(self.time_s[self.index] - lag_s, self.time_s[0])
        found = np.searchsorted(self.time_s, then_s, side="right") - 1
        low = np.clip(found, 0, self.time_s.size - 2)
        return low, (then_s - self.time_s[low]) / (self.time_s[low + 1] - self.time_s[low])

    def errors_c(self, temperatures_c: FloatArray, lag_s: FloatArray) -> FloatArray:
        """Twin minus measurement (B, n) for node temperatures (B, rows, nodes), lags (B, 1)."""
        readings = temperatures_c @ self.row
        if not self._rows_are_long:
            low, part = self._earlier(lag_s)
            first = np.take_along_axis(readings, low, axis=1)
            second = np.take_along_axis(readings, low + 1, axis=1)
            return np.asarray(first + part * (second - first) - self.measured_c)
        now = readings[:, self.index]
        before = readings[:, np.maximum(self.index - 1, 0)]
        share = np.minimum(lag_s / self.since_before_s, 1.0)
        return np.asarray(now + share * (before - now) - self.measured_c)

    def slopes(self, readings_c: FloatArray, tangents: FloatArray, lag_s: float) -> FloatArray:
        """Whitened derivatives (n, q + 1) of the errors along q directions and by the lag.

        From the twin's readings (rows,) and their derivatives (rows, q).
        """
        along = np.empty((tangents.shape[1] + 1, self.index.size))
        if not self._rows_are_long:
            low, part = self._earlier(np.array([lag_s]))
            along[:-1] = (tangents[low] * (1.0 - part[:, None])).T
            along[:-1] += (tangents[low + 1] * part[:, None]).T
            rise = readings_c[low + 1] - readings_c[low]
            moves = self.time_s[self.index] - lag_s > self.time_s[0]
            along[-1] = np.where(moves, -rise / (self.time_s[low + 1] - self.time_s[low]), 0.0)
            errors = readings_c[low] + part * rise - self.measured_c
            return np.asarray(self.whitening.slopes(errors, along).T)
        before = np.maximum(self.index - 1, 0)
        share = np.minimum(lag_s / self.since_before_s, 1.0)
        along[:-1] = (tangents[self.index] * (1.0 - share[:, None])).T
        along[:-1] += (tangents[before] * share[:, None]).T
        difference = readings_c[before] - readings_c[self.index]
        along[-1] = np.where(share < 1.0, difference / self.since_before_s, 0.0)
        errors = readings_c[self.index] + share * difference - self.measured_c
        return np.asarray(self.whitening.slopes(errors, along).T)


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """One window prepared for simulation.

    ``unknown`` says which of the problem's unknowns hold the initial state's coordinates: one per
    node, or a single common deviation from ambient for a window that began at standstill.
    """

    profile: OperatingProfile
    revolutions: float
    initial_c: FloatArray
    initial_factor: FloatArray
    unknown: slice
    channels: tuple[_Channel, ...]
    residuals: slice


class IdentificationProblem:
    """Residuals, costs and derivatives of a model on a data set.

    `guess_z` (p,) parameters at which initial states are estimated from the first measurements of
    windows that began warm; the prior's centre by default. `loss`: of the measurements. With a
    robust one, residuals are such that their squares are the loss. `cost`: what searches make
    small. `prior`: of the parameters; the literature's by default.

    Attributes: `parameter_count`, `unknown_count`: p, and p plus one for the sensor lag plus the
    coordinates of unknown initial states; `evaluations`: simulations of the whole data set so far;
    one with its derivatives counts as one.
    """

    def __init__(
        self,
        model: ThermalModel,
        data: IdentificationData,
        guess_z: FloatArray | None = None,
        loss: Loss = "linear",
        cost: Cost = SUM_OF_SQUARES,
        prior: NormalPrior | None = None,
    ) -> None:
        self.cost = cost
        self.prior = literature_prior(model.parameters.size) if prior is None else prior
        self._whitener = self.prior.whitener
        self.model = model
        self.data = data
        self.parameter_count = model.parameters.size
        self.evaluations = 0
        guess = self.prior.mean if guess_z is None else guess_z
        values = model.parameters.values_from_z(guess)
        spans: list[_Span] = []
        unknown, residual = self.parameter_count + 1, 0
        for window in data.windows:
            span = _prepare(model, window, values, unknown, residual, loss)
            spans.append(span)
            unknown, residual = span.unknown.stop, span.residuals.stop
        self._spans = tuple(spans)
        self.unknown_count = unknown
        self.measurement_count = residual
        limit = np.full(unknown - self.parameter_count - 1, _INITIAL_STATE_LIMIT)
        lag = np.array([-SENSOR_LAG_S, _LONGEST_LAG_S - SENSOR_LAG_S]) / _LAG_SPREAD_S
        self.lower: FloatArray = np.concatenate((model.parameters.z_lower, lag[:1], -limit))
        self.upper: FloatArray = np.concatenate((model.parameters.z_upper, lag[1:], limit))
        self._nuisance_sensitivity: FloatArray | None = None

    # ------------------------------------------------------------------ residuals
    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Whitened residuals (B, m + d) of candidates (B, d): m measurements, then priors.

        NaN throughout where a simulation failed.
        """
        batch = np.atleast_2d(unknowns)
        self.evaluations += len(batch)
        measured = np.empty((len(batch), self.measurement_count))
        for span in self._spans:
            measured[:, span.residuals] = self._whitened(span, batch)
        measured[~np.all(np.isfinite(measured), axis=1)] = np.nan
        p = self.parameter_count
        known = (batch[:, :p] - self.prior.mean) @ self._whitener.T
        return np.concatenate((measured, known, batch[:, p:]), axis=1)

    def _temperatures(self, span: _Span, batch: FloatArray) -> FloatArray:
        values = self.model.parameters.values_from_z(batch[:, : self.parameter_count])
        initial = span.initial_c + batch[:, span.unknown] @ span.initial_factor.T
        return simulate_batch(self.model, values, span.profile, initial, span.revolutions)

    def _whitened(self, span: _Span, batch: FloatArray) -> FloatArray:
        temperatures = self._temperatures(span, batch)
        lag_s = self._lag_s(batch)
        parts = [
            channel.whitening.apply(channel.errors_c(temperatures, lag_s))
            for channel in span.channels
        ]
        return np.concatenate(parts, axis=1)

    def lag_s(self, unknowns: FloatArray) -> float:
        """Lag of the temperature sensors in s at ``unknowns`` (d,)."""
        return float(self._lag_s(unknowns[None])[0, 0])

    def _lag_s(self, batch: FloatArray) -> FloatArray:
        lag_s = (
            SENSOR_LAG_S + _LAG_SPREAD_S * batch[:, self.parameter_count : self.parameter_count + 1]
        )
        return np.asarray(np.clip(lag_s, 0.0, _LONGEST_LAG_S))

    def jacobian(self, unknowns: FloatArray) -> FloatArray:
        """Derivatives (m + d, d) of `residuals` at (d,), from one simulation per window.

        At a bound the derivative is the one towards the inside. Zero for the measurements of a
        window whose simulation fails.
        """
        self.evaluations += 1
        d, p = self.unknown_count, self.parameter_count
        parameters = self.model.parameters
        values = parameters.values_from_z(unknowns[:p])
        inside = (unknowns >= self.lower) & (unknowns <= self.upper)
        by_z = np.where(inside[:p], parameters.slopes_by_z(unknowns[:p]), 0.0)
        lag_s = self.lag_s(unknowns)
        by_lag = _LAG_SPREAD_S if inside[p] else 0.0
        jacobian = np.zeros((self.measurement_count + d, d))
        jacobian[self.measurement_count :] = np.eye(d)
        jacobian[self.measurement_count : self.measurement_count + p, :p] = self._whitener
        for span in self._spans:
            try:
                found = simulate_sensitivities(
                    self.model,
                    values,
                    span.profile,
                    span.initial_c + span.initial_factor @ unknowns[span.unknown],
                    span.revolutions,
                    initial_directions=span.initial_factor,
                    outputs=np.array([channel.row for channel in span.channels]),
                )
            except SimulationError:
                continue
            first = span.residuals.start
            for number, channel in enumerate(span.channels):
                slopes = channel.slopes(
                    found.temperatures_c[:, number],
                    np.concatenate(
                        (found.by_value[:, number] * by_z, found.by_initial[:, number]), axis=1
                    ),
                    lag_s,
                )
                rows = slice(first, first + channel.index.size)
                jacobian[rows, :p] = slopes[:, :p]
                jacobian[rows, p] = slopes[:, -1] * by_lag
                jacobian[rows, span.unknown] = slopes[:, p:-1]
                first = rows.stop
        return jacobian

    # ------------------------------------------------------------------ for a global search
    def costs(self, z: FloatArray) -> FloatArray:
        """Costs (B,) of parameters (B, p), other unknowns eliminated; infinite if one fails.

        Lag and initial states are eliminated by linear regression with their sensitivities at the
        prior's centre, priors included, so that a candidate is not blamed for them.
        """
        batch = np.zeros((len(z), self.unknown_count))
        batch[:, : self.parameter_count] = z
        costs = self.cost.without_nuisance(self.residuals(batch), self._nuisance())
        return failed_as_infinite(costs)

    def reduced_residuals(self, z: FloatArray) -> FloatArray:
        """Residuals (B, m + d) whose sums of squares are `costs`, nuisance unknowns at their best.

        Of parameters (B, p); the m measurements first. NaN where a simulation failed.
        """
        p, m = self.parameter_count, self.measurement_count
        batch = np.zeros((len(z), self.unknown_count))
        batch[:, :p] = z
        residuals = self.residuals(batch)
        sensitivity = self._nuisance()
        information = np.eye(sensitivity.shape[1]) + sensitivity.T @ sensitivity
        nuisance = -np.linalg.solve(information, (residuals[:, :m] @ sensitivity).T).T
        residuals[:, :m] += nuisance @ sensitivity.T
        residuals[:, m + p :] = nuisance
        return residuals

    def with_nuisance(self, z: FloatArray) -> FloatArray:
        """Unknowns (d,) with the given parameters, lag and initial states linearly regressed."""
        unknowns = np.zeros(self.unknown_count)
        unknowns[: self.parameter_count] = z
        measured = self.residuals(unknowns)[0, : self.measurement_count]
        sensitivity = self._nuisance()
        information = np.eye(sensitivity.shape[1]) + sensitivity.T @ sensitivity
        step = -np.linalg.solve(information, sensitivity.T @ measured)
        if np.all(np.isfinite(step)):
            unknowns[self.parameter_count :] = step
        return np.clip(unknowns, self.lower, self.upper)

    def _nuisance(self) -> FloatArray:
        """Sensitivities (m, d - p) of the measurements to lag and initial states."""
        if self._nuisance_sensitivity is None:
            jacobian = self.jacobian(np.clip(np.zeros(self.unknown_count), self.lower, self.upper))
            self._nuisance_sensitivity = jacobian[: self.measurement_count, self.parameter_count :]
        return self._nuisance_sensitivity

    # ------------------------------------------------------------------ reports
    def errors_c(self, unknowns: FloatArray) -> list[dict[str, FloatArray]]:
        """Twin minus measurement in K, per window and sensor, at the sensors' good rows."""
        batch = np.atleast_2d(unknowns)
        errors = []
        for span in self._spans:
            temperatures, lag_s = self._temperatures(span, batch), self._lag_s(batch)
            errors.append(
                {
                    channel.name: channel.errors_c(temperatures, lag_s)[0]
                    for channel in span.channels
                }
            )
        return errors

    def rms_k(self, unknowns: FloatArray) -> dict[str, float]:
        """Root mean square error of every sensor over all windows, in K.

        With a robust loss, rows count with the weight that it gives them.
        """
        squares: dict[str, list[FloatArray]] = {}
        weights: dict[str, list[FloatArray]] = {}
        for span, errors in zip(self._spans, self.errors_c(unknowns), strict=True):
            for channel in span.channels:
                values = errors[channel.name]
                squares.setdefault(channel.name, []).append(values**2)
                weights.setdefault(channel.name, []).append(channel.whitening.weights(values))
        return {
            name: float(
                np.sqrt(np.average(np.concatenate(parts), weights=np.concatenate(weights[name])))
            )
            for name, parts in squares.items()
        }

    def whitened(self, unknowns: FloatArray) -> list[dict[str, FloatArray]]:
        """Whitened residuals per window and sensor; independent N(0, 1) for a perfect model."""
        return [
            {
                channel.name: channel.whitening.apply(errors[channel.name])
                for channel in span.channels
            }
            for span, errors in zip(self._spans, self.errors_c(unknowns), strict=True)
        ]


def profile_of(minutes: MinuteData) -> OperatingProfile:
    """Operating profile of the good rows; noise within an operating point is averaged out."""
    rows = minutes.take(minutes.good)
    return hold_operating_point(
        OperatingProfile(
            rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c, rows.input_table()
        )
    )


def first_measurements(minutes: MinuteData) -> Mapping[str, float]:
    """Temperatures of the first good row at which every sensor's first value is near in time."""
    rows = minutes.take(minutes.good)
    first = {}
    for name, values in rows.temperatures_c.items():
        known = np.flatnonzero(np.isfinite(values[:3]))
        if known.size:
            first[name] = float(values[known[0]])
    return first


def _prepare(
    model: ThermalModel,
    window: IdentificationWindow,
    values: FloatArray,
    unknown: int,
    residual: int,
    loss: Loss,
) -> _Span:
    rows = window.minutes.take(window.minutes.good)
    profile = profile_of(window.minutes)
    channels = []
    start = residual
    errors = reading_errors(model, rows.temperatures_c)
    for name, measured in rows.temperatures_c.items():
        index = np.flatnonzero(np.isfinite(measured))
        if index.size:
            channels.append(
                _Channel(
                    name,
                    model.sensor_row(name),
                    index,
                    measured[index],
                    whitening(rows.time_s[index], *astuple(errors[name]), loss=loss),
                    np.diff(rows.time_s, prepend=rows.time_s[0] - 60.0)[index],
                    rows.time_s,
                )
            )
            residual += index.size
    nodes = len(model.node_names)
    if window.at_rest:
        initial_c = np.full(nodes, profile.ambient_c[0])
        factor = np.full((nodes, 1), _REST_SPREAD_K)
    else:
        initial_c, covariance = initial_state(
            model,
            values,
            dict(first_measurements(window.minutes)),
            float(profile.ambient_c[0]),
            float(profile.speed_rpm[0]),
            float(profile.load_n[0]),
            False,
            inputs=profile.inputs[0],
        )
        factor = np.linalg.cholesky(covariance + 1e-9 * np.eye(nodes))
    return _Span(
        profile,
        float(window.revolutions),
        initial_c,
        factor,
        slice(unknown, unknown + factor.shape[1]),
        tuple(channels),
        slice(start, residual),
    )
