"""PT100 resistance thermometers: resistance and temperature after IEC 60751:2022.

R(t) = R0 (1 + A t + B t^2) from 0 to 850 degC; below 0 degC with the further term
R0 C (t - 100) t^3.
"""

from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

COEFFICIENT_A = 3.9083e-3
COEFFICIENT_B = -5.775e-7
COEFFICIENT_C = -4.183e-12
LOWEST_C = -200.0
HIGHEST_C = 850.0
NOMINAL_OHM = 100.0

# Resistances that end the standard's range: below, the element is short-circuited, above, a wire
# is broken (no PT100 in working order has them).
SHORT_CIRCUIT_OHM = 18.5200
WIRE_BREAK_OHM = 390.4812

_NEWTON_STEPS = 4  # from the quadratic's root the cubic term is below 1e-10 K after three


@overload
def resistance_from_temperature(temperature_c: float) -> float: ...
@overload
def resistance_from_temperature(temperature_c: ArrayLike) -> NDArray[np.float64]: ...
def resistance_from_temperature(temperature_c: ArrayLike) -> float | NDArray[np.float64]:
    """Resistance of a PT100. In ohm and degC, any shape; NaN outside -200 to 850 degC."""
    t = np.asarray(temperature_c, dtype=np.float64)
    ohm = NOMINAL_OHM * _ratio(t)
    return _plain(np.where((t >= LOWEST_C) & (t <= HIGHEST_C), ohm, np.nan))


@overload
def temperature_from_resistance(resistance_ohm: float) -> float: ...
@overload
def temperature_from_resistance(resistance_ohm: ArrayLike) -> NDArray[np.float64]: ...
def temperature_from_resistance(resistance_ohm: ArrayLike) -> float | NDArray[np.float64]:
    """Exact inverse of `resistance_from_temperature`; NaN for a short circuit or a broken wire."""
    ohm = np.asarray(resistance_ohm, dtype=np.float64)
    inside = (ohm >= SHORT_CIRCUIT_OHM) & (ohm <= WIRE_BREAK_OHM)
    ratio = np.where(inside, ohm, NOMINAL_OHM) / NOMINAL_OHM
    a, b = COEFFICIENT_A, COEFFICIENT_B
    t = (-a + np.sqrt(a * a - 4.0 * b * (1.0 - ratio))) / (2.0 * b)
    if np.any(t < 0.0):
        for _ in range(_NEWTON_STEPS):
            below = np.minimum(t, 0.0)
            slope = a + 2.0 * b * t + COEFFICIENT_C * (4.0 * below - 300.0) * below**2
            t = t - (_ratio(t) - ratio) / slope
    return _plain(np.where(inside, t, np.nan))


def fault(resistance_ohm: float) -> str | None:
    """Name the fault that a resistance in ohm gives away, or None."""
    if resistance_ohm < SHORT_CIRCUIT_OHM:
        return "short circuit"
    if resistance_ohm > WIRE_BREAK_OHM:
        return "wire break"
    return None


def _ratio(t: NDArray[np.float64]) -> NDArray[np.float64]:
    below = np.minimum(t, 0.0)
    ratio: NDArray[np.float64] = (
        1.0 + COEFFICIENT_A * t + COEFFICIENT_B * t * t + COEFFICIENT_C * (below - 100.0) * below**3
    )
    return ratio


def _plain(values: NDArray[np.float64]) -> float | NDArray[np.float64]:
    return float(values) if values.ndim == 0 else values
