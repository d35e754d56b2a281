"""Residuals of one sensor turned into independent ones of unit variance, in linear time.

What is left between a twin and a sensor is white noise, a slow deviation that fades within half an
hour (what the network cannot express), and a constant offset of the sensor:

    cov(t, t') = white^2 [t = t'] + slow^2 exp(-|t - t'| / tau) + offset^2

A Kalman filter with the state (slow deviation, offset) has these residuals as measurements; its
scaled innovations are the residuals multiplied by the inverse Cholesky factor of the covariance.
Gains depend on the times only, so they are computed once; irregular times need no special care.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.simulation.compiling import compiled

FloatArray = NDArray[np.float64]

WHITE_K = 0.15
SLOW_K = 0.30
SLOW_S = 1800.0
OFFSET_K = 0.10


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """Gains of the whitening filter for one sensor at given times.

    Attributes
    ----------
    decay
        (n,) what is left of the slow deviation since the time before; 0 at the first.
    gain
        (n, 2) Kalman gains of slow deviation and offset.
    scale
        (n,) one over the standard deviation of each innovation.
    """

    decay: FloatArray
    gain: FloatArray
    scale: FloatArray

    def apply(self, residuals: FloatArray) -> FloatArray:
        """Whiten residuals (..., n) in K; the result has the same shape."""
        flat = np.ascontiguousarray(residuals, np.float64).reshape(-1, self.scale.size)
        white = np.empty_like(flat)
        _filter(flat, self.decay, self.gain, self.scale, white)
        return white.reshape(residuals.shape)


def whitening(
    time_s: FloatArray,
    white_k: float = WHITE_K,
    slow_k: float = SLOW_K,
    slow_s: float = SLOW_S,
    offset_k: float = OFFSET_K,
) -> Whitening:
    """Compute the whitening filter for the times of a sensor's good values.

    Parameters
    ----------
    time_s
        (n,) ascending times in s.
    white_k, slow_k, offset_k
        Standard deviations in K.
    slow_s
        Correlation time of the slow deviation in s.
    """
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
    return Whitening(decay, gain, scale)


@compiled
def _filter(
    residuals: FloatArray, decay: FloatArray, gain: FloatArray, scale: FloatArray, out: FloatArray
) -> None:
    for member in range(residuals.shape[0]):
        slow = 0.0
        offset = 0.0
        for row in range(residuals.shape[1]):
            slow *= decay[row]
            innovation = residuals[member, row] - slow - offset
            slow += gain[row, 0] * innovation
            offset += gain[row, 1] * innovation
            out[member, row] = scale[row] * innovation
