"""What an asset costs, measured for a moment with few of them."""

import subprocess
import sys

import numpy as np
import pytest

from bearing_twin_laboratory.benchmarks import fleet
from bearing_twin_laboratory.benchmarks.registry import BENCHMARKS, chosen
from service.demo.fleet_configuration import CHANNELS, fleet_assets

pytestmark = pytest.mark.laboratory


def quiet(fraction: float, text: str) -> None:
    assert 0.0 <= fraction <= 1.0
    assert text


@pytest.mark.wires
@pytest.mark.timeout(600)
def test_cost_of_assets_and_no_sample_lost() -> None:
    found = fleet.assets_cpu(quiet, sizes=(2, 6), duration_s=5.0, settle_s=1.0)
    assert found.unit == "s/s"
    assert found.value > 0.0
    assert found.reference is not None
    extra = found.extra
    assert (extra["lost"], extra["doubled"]) == (0, 0)
    assert extra["assets"] == 6
    assert 0.0 < extra["cell_share"] < 1.0
    assert 0.0 < extra["forecast_age_s"] < 600.0
    assert 0.0 < extra["polled_share"] <= 1.5
    assert extra["by_size"]["6"]["sent"] > extra["by_size"]["2"]["sent"] > 0
    assert all(one["memory_bytes"] > 50e6 for one in extra["by_size"].values())


def test_the_fleet_is_a_group_of_benchmarks() -> None:
    assert chosen(["fleet", "snapshot", "assets_cpu"]) == ("assets_cpu", "snapshot")
    assert "fleet" not in BENCHMARKS


def test_slope_is_the_exponent() -> None:
    sizes = np.array([10.0, 50.0, 200.0])
    assert fleet._slope(sizes, 3.0 * sizes**1.2) == pytest.approx(1.2)
    assert fleet._slope(sizes[:1], sizes[:1]) is None


def test_lost_and_doubled_samples_are_counted_per_channel() -> None:
    """The answer that a service had no time to store at its end is not counted as lost."""
    first, second = fleet_assets(2)
    stored = {(asset, channel): 10 for asset in (first, second) for channel in CHANNELS}
    assert fleet._compared([11, 10], stored) == (0, 0)
    stored[first, CHANNELS[0]] = 7
    stored[second, CHANNELS[1]] = 12
    assert fleet._compared([11, 10], stored) == (3, 2)


@pytest.mark.wires
def test_processes_of_a_service_are_found_with_what_they_use() -> None:
    # A process of its own: this one may have services of other tests below it.
    program = "sum(range(10**7)); data = bytearray(b'1') * 20_000_000; print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = fleet.processes_of(process.pid)
        used_bytes = fleet.memory_bytes_of(process.pid)
        total, cell = fleet.processor_s_of(process.pid)
        process.kill()
    assert process.pid in found
    assert used_bytes > 10e6
    assert total > 0.0
    assert cell == 0.0
