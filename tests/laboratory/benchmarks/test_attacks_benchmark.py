"""All attackers at once, for a moment."""

import pytest

from bearing_twin_laboratory.benchmarks import attacks

pytestmark = pytest.mark.laboratory


@pytest.mark.wires
@pytest.mark.timeout(600)
def test_all_attackers_are_at_work_and_polls_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attacks, "_ROWS_PER_CHANNEL", 1000)
    found = attacks.attacks(lambda share, what: None, benches=2, duration_s=3.0)
    assert found.value < 1.0, "polls go on"
    assert found.reference is not None
    assert found.reference < 1.0, "without attacks the benches are polled"
    assert found.extra["memory_bytes"] > 50e6
