"""Every sample that a gateway pushes for many assets is stored once."""

import pytest

from bearing_twin_laboratory.benchmarks.pushes import pushes

pytestmark = [pytest.mark.laboratory, pytest.mark.wires]


@pytest.mark.timeout(300)
def test_all_that_was_acknowledged_is_stored_and_many_in_a_call_are_cheaper() -> None:
    found = pushes(lambda fraction, text: None, assets=20, duration_s=3.0, settle_s=1.0)
    assert found.extra["acknowledged"] == found.extra["stored"]
    assert found.unit == "1/s"
    assert found.ratio is not None
    assert found.ratio > 2.0
    shares = {name: one for name, one in found.extra.items() if name.startswith("cpu_share")}
    assert shares["cpu_share_20_assets"] == pytest.approx(
        shares["cpu_share_of_pushes"] + shares["cpu_share_without_pushes"]  # type: ignore[operator]
    )
    assert shares["cpu_share_without_pushes"] > 0.0  # type: ignore[operator]
