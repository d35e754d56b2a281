"""What a machine cannot do is not believed, whatever quality it comes with."""

from pathlib import Path
from typing import Any

import pytest
from prometheus_client import CollectorRegistry

from adapters.samples import Quality, Sample
from service.ingest import QualityChecks
from service.site.asset_section import AssetSection
from service.site.machines.operating_ranges import operating_ranges, refused_beyond
from service.site.settings import load_settings
from service.site.wiring import wire

NOW_US = 1_763_700_000_000_000
SITE = """
[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
[assets.channels]
speed_rpm = { source = "push" %s }
load_n = { source = "push" }
ambient_c = { source = "push" }
t_inner_ring_c = { source = "push" }
"""


def checks(folder: Path, speed: str = "") -> QualityChecks:
    file = folder / "site.toml"
    file.write_text(SITE % speed)
    return QualityChecks(wire(load_settings(file)).check_limits, CollectorRegistry())


def quality(found: QualityChecks, channel: str, value: float) -> int:
    (judged,) = found.judge([Sample("bench-1", channel, NOW_US, value, Quality.GOOD, NOW_US)])
    return judged.quality


@pytest.mark.parametrize(
    ("channel", "plausible", "impossible"),
    [
        ("speed_rpm", (0.0, 6200.0, 12_000.0, -3000.0), (1e9, -1e9, 1e308, 23_000.0)),
        ("load_n", (0.0, 5500.0, 45_000.0, -100.0), (1e308, 91_000.0, -2650.0)),
        ("t_inner_ring_c", (-20.0, 250.0), (1e300, 601.0, -81.0)),
        ("ambient_c", (-40.0, 23.0, 80.0), (1e9, 101.0, -61.0)),
    ],
)
def test_impossible_inputs_are_not_good(
    tmp_path: Path, channel: str, plausible: tuple[float, ...], impossible: tuple[float, ...]
) -> None:
    for value in plausible:
        assert quality(checks(tmp_path), channel, value) == Quality.GOOD, value
    for value in impossible:
        assert quality(checks(tmp_path), channel, value) == Quality.EU_EXCEEDED, value


def test_a_configured_range_counts_up_to_half_as_much_again(tmp_path: Path) -> None:
    wide = checks(tmp_path, ", valid_range = [0, 1e12]")
    assert quality(wide, "speed_rpm", 30_000.0) == Quality.GOOD
    assert quality(wide, "speed_rpm", 1e9) == Quality.EU_EXCEEDED
    narrow = checks(tmp_path, ", valid_range = [0, 5000]")
    assert quality(narrow, "speed_rpm", 6200.0) == Quality.EU_EXCEEDED


def test_ranges_follow_the_bearing() -> None:
    def section(bearing: Any) -> Any:
        low_risk = {"speed_rpm_max": 1.0, "load_n_max": 1.0}
        document = {"id": "a", "bearing": bearing, "low_risk": low_risk, "channels": {}}
        return AssetSection.model_validate(document).bearing

    small = operating_ranges(section({"bore_mm": 8, "outer_mm": 22, "width_mm": 7}))
    large = operating_ranges(section("6016"))
    assert small["speed_rpm"][1] > 100_000 > 25_000 > large["speed_rpm"][1] > 10_000
    assert small["load_n"][1] < 5000 < 50_000 < large["load_n"][1]
    assert operating_ranges(None)["speed_rpm"][1] < 1e6
    low, high = refused_beyond(large)["speed_rpm"]
    assert (low, high) == pytest.approx((-1.5 * large["speed_rpm"][1], 1.5 * large["speed_rpm"][1]))
