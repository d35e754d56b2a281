import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.pt100 import fault, resistance_from_temperature, temperature_from_resistance

# IEC 60751:2022, ohm at degC
TABLE = {
    -200: 18.5201,
    -100: 60.2558,
    -50: 80.3063,
    0: 100.0,
    20: 107.7935,
    25: 109.7347,
    50: 119.3971,
    90: 134.7069,
    100: 138.5055,
    120: 146.0680,
    150: 157.3251,
    200: 175.8560,
    400: 247.0920,
    600: 313.7080,
    850: 390.4811,
}


def test_agrees_with_the_standard_in_both_directions() -> None:
    temperatures = np.array(list(TABLE), dtype=float)
    resistances = np.array(list(TABLE.values()))
    np.testing.assert_allclose(resistance_from_temperature(temperatures), resistances, atol=5.1e-5)
    np.testing.assert_allclose(temperature_from_resistance(resistances), temperatures, atol=2e-4)


@given(st.floats(-200.0, 850.0))
def test_the_two_directions_are_inverse(temperature_c: float) -> None:
    back = temperature_from_resistance(resistance_from_temperature(temperature_c))
    assert isinstance(back, float)
    assert back == pytest.approx(temperature_c, abs=1e-9)


def test_faults_have_no_temperature() -> None:
    assert np.isnan(temperature_from_resistance([0.0, 18.4, 391.0, 1e6, np.nan])).all()
    assert np.isnan(resistance_from_temperature([-200.5, 851.0])).all()
    assert fault(2.0) == "short circuit"
    assert fault(500.0) == "wire break"
    assert fault(138.5) is None
