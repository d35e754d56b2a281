"""The benchmark of many estimates compares the same machines."""

import pytest

from bearing_twin_laboratory.benchmarks import twins


def test_machines_advanced_together_are_those_advanced_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(twins, "MACHINES", 200)
    monkeypatch.setattr(twins, "ALONE", 5)
    found = twins.twins_10000(lambda share, what: None)
    assert found.ratio is not None
    assert 0.0 < found.ratio < 1.0
    greatest_k = found.extra["greatest_difference_k"]
    assert isinstance(greatest_k, float)
    assert greatest_k < 1e-9
