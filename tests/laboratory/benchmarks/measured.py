"""What every benchmark says and measures."""

from bearing_twin_laboratory.benchmarks.common import Measurement


def quiet(fraction: float, text: str) -> None:
    assert 0.0 <= fraction <= 1.0
    assert text


def positive(measurement: Measurement) -> None:
    assert measurement.value > 0.0
    assert measurement.reference is not None
    assert measurement.reference > 0.0
    assert measurement.compared_with
