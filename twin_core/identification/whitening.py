"""Residuals of one sensor turned into independent ones of unit variance, in linear time.

What is left between a twin and a sensor is white noise, a slow deviation that fades within half an
hour (what the network cannot express), and a constant offset of the sensor:

    cov(t, t') = white^2 [t = t'] + slow^2 exp(-|t - t'| / tau) + offset^2

A Kalman filter with the state (slow deviation, offset) has these residuals as measurements; its
scaled innovations are the residuals multiplied by the inverse Cholesky factor of the covariance.
Gains depend on the times only, so they are computed once; irregular times need no special care.

A robust loss keeps outliers from bending a fit. An outlier must not pass for a slow deviation
either, which the filter would then see in all that follows: it enters the filter's state with the
weight that the loss gives it (a robustified Kalman filter). What comes out has the loss as its
square, so that least squares on it minimise the loss.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation.compiling import compiled

FloatArray = NDArray[np.float64]

WHITE_K = 0.15
SLOW_K = 0.30
SLOW_S = 1800.0
OFFSET_K = 0.10

Loss = Literal["linear", "soft_l1", "huber", "cauchy"]
"""What a squared residual costs, as in `scipy.optimize.least_squares`: itself, or less beyond
`LOSS_SCALE` standard deviations."""
LOSS_SCALE = 2.0
_LINEAR, _SOFT_L1, _HUBER = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """Gains of the whitening filter for one sensor at given times."""

    #: (n,) what is left of the slow deviation since the time before; 0 at the first.
    decay: FloatArray
    gain: FloatArray  # (n, 2) Kalman gains of slow deviation and offset
    scale: FloatArray  # (n,) one over the standard deviation of each innovation
    loss: Loss = "linear"  # of the whitened residuals

    def apply(self, residuals: FloatArray) -> FloatArray:
        """Whiten residuals (..., n) in K; the result has the same shape."""
        flat = np.ascontiguousarray(residuals, np.float64).reshape(-1, self.scale.size)
        white = np.empty_like(flat)
        _filter(flat, self.decay, self.gain, self.scale, self._kind, white)
        return white.reshape(residuals.shape)

    def slopes(self, residuals: FloatArray, tangents: FloatArray) -> FloatArray:
        """Derivatives (q, n) of `apply` at residuals (n,) along q directions (q, n)."""
        state, out = self._weights(residuals)
        slopes = np.empty(tangents.shape)
        flat = np.ascontiguousarray(tangents, np.float64)
        _filter_tangents(flat, self.decay, self.gain, self.scale, state, out, slopes)
        return slopes

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Weights (n,) from 0 to 1 that the loss gives to residuals (n,)."""
        white = self.apply(residuals)
        if self.loss == "linear":
            return np.ones_like(white)
        return np.asarray(self._weights(residuals)[1] ** 2)

    def _weights(self, residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How changes of each innovation go into the filter's state and into the result."""
        state, out = np.empty(self.scale.size), np.empty(self.scale.size)
        flat = np.ascontiguousarray(residuals, np.float64)
        _filter_weights(flat, self.decay, self.gain, self.scale, self._kind, state, out)
        return state, out

    @property
    def _kind(self) -> int:
        return get_args(Loss).index(self.loss)


def whitening(
    time_s: FloatArray,
    white_k: float = WHITE_K,
    slow_k: float = SLOW_K,
    slow_s: float = SLOW_S,
    offset_k: float = OFFSET_K,
    *,
    loss: Loss = "linear",
) -> Whitening:
    """Compute the whitening filter for the times of a sensor's good values.

    `time_s` (n,) ascending times in s; `white_k`, `slow_k`, `offset_k`: standard deviations in K;
    `slow_s`: correlation time of the slow deviation in s. Raises `ValueError` if the loss is
    unknown.
    """
    if loss not in get_args(Loss):
        raise ValueError(f"loss is {loss!r}, expected one of {', '.join(get_args(Loss))}")
    n = time_s.size
    decay = np.zeros(n)
    decay[1:] = np.exp(-np.diff(time_s) / slow_s)
    gain = np.empty((n, 2))
    scale = np.empty(n)
    slow, cross, offset = slow_k**2, 0.0, offset_k**2
    for row in range(n):
        if row:
            slow = decay[row] ** 2 * slow + (1.0 - decay[row] ** 2) * slow_k**2
            cross *= decay[row]
        variance = slow + 2.0 * cross + offset + white_k**2
        to_slow, to_offset = slow + cross, cross + offset
        gain[row] = to_slow / variance, to_offset / variance
        scale[row] = 1.0 / math.sqrt(variance)
        slow -= to_slow**2 / variance
        cross -= to_slow * to_offset / variance
        offset -= to_offset**2 / variance
    return Whitening(decay, gain, scale, loss)


@compiled
def _robust(white: float, kind: int) -> tuple[float, float, float]:
    """Loss of a white residual, its first and second derivative by the residual's square."""
    square = white * white
    if kind == _LINEAR:
        return square, 1.0, 0.0
    scale = LOSS_SCALE * LOSS_SCALE
    relative = square / scale
    if kind == _HUBER:
        if relative <= 1.0:
            return square, 1.0, 0.0
        root = math.sqrt(relative)
        return scale * (2.0 * root - 1.0), 1.0 / root, -0.5 / (root * relative * scale)
    if kind == _SOFT_L1:
        root = math.sqrt(1.0 + relative)
        return 2.0 * square / (root + 1.0), 1.0 / root, -0.5 / (root**3 * scale)
    slope = 1.0 / (1.0 + relative)
    return scale * math.log1p(relative), slope, -slope * slope / scale


@compiled
def _filter(
    residuals: FloatArray,
    decay: FloatArray,
    gain: FloatArray,
    scale: FloatArray,
    kind: int,
    out: FloatArray,
) -> None:
    for member in range(residuals.shape[0]):
        slow = 0.0
        offset = 0.0
        for row in range(residuals.shape[1]):
            slow *= decay[row]
            innovation = residuals[member, row] - slow - offset
            out[member, row] = scale[row] * innovation
            if kind != _LINEAR:
                loss, weight, _ = _robust(out[member, row], kind)
                out[member, row] = math.copysign(math.sqrt(loss), innovation)
                innovation *= weight
            slow += gain[row, 0] * innovation
            offset += gain[row, 1] * innovation


@compiled
def _filter_weights(
    residuals: FloatArray,
    decay: FloatArray,
    gain: FloatArray,
    scale: FloatArray,
    kind: int,
    state: FloatArray,
    out: FloatArray,
) -> None:
    slow = 0.0
    offset = 0.0
    for row in range(residuals.size):
        slow *= decay[row]
        innovation = residuals[row] - slow - offset
        white = scale[row] * innovation
        loss, slope, bend = _robust(white, kind)
        state[row] = slope + 2.0 * bend * white * white
        out[row] = slope * abs(white) / math.sqrt(loss) if loss > 0.0 else 1.0
        slow += gain[row, 0] * slope * innovation
        offset += gain[row, 1] * slope * innovation


@compiled
def _filter_tangents(
    tangents: FloatArray,
    decay: FloatArray,
    gain: FloatArray,
    scale: FloatArray,
    state: FloatArray,
    weight: FloatArray,
    out: FloatArray,
) -> None:
    for member in range(tangents.shape[0]):
        slow = 0.0
        offset = 0.0
        for row in range(tangents.shape[1]):
            slow *= decay[row]
            innovation = tangents[member, row] - slow - offset
            out[member, row] = weight[row] * scale[row] * innovation
            slow += gain[row, 0] * state[row] * innovation
            offset += gain[row, 1] * state[row] * innovation
