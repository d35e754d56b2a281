"""The benchmarks of the web side, each run for a moment at one site."""

import pytest

from bearing_twin_laboratory.benchmarks import clients, web
from bearing_twin_laboratory.benchmarks.site import site

from .measured import positive, quiet

pytestmark = pytest.mark.laboratory


@pytest.mark.wires
@pytest.mark.timeout(600)
async def test_snapshot_what_if_and_stream_under_load() -> None:
    async with site() as here:
        found = await web.snapshot_at(here, quiet, 2.0, rounds=1)
        positive(found)
        assert found.unit == "1/s"
        assert found.extra["p99_ratio"] == pytest.approx(
            found.extra["p99_s"] / found.extra["idle_p99_s"]
        )
        found = await web.what_if_at(here, quiet, 2.0)
        positive(found)
        assert found.extra["p50_s"] <= found.value <= found.extra["p99_s"]
        assert found.extra["requests"] > 0
        found = await web.websocket_at(here, quiet, 3.0, listeners=20, stalled=2)
        positive(found)
        assert found.value == found.extra["p99_s"]
        assert found.extra["fewest_per_client"] > 0
        assert found.extra["memory_growth_mib"] < 100


def test_a_quantile_is_one_of_the_values() -> None:
    values = [float(number) for number in range(100, 0, -1)]
    assert clients.quantile(values, 0.5) == 50.0
    assert clients.quantile(values, 0.99) == 99.0
    assert clients.quantile([7.0], 0.01) == 7.0
