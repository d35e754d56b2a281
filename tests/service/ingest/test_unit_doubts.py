"""What a check of a configuration says of values that may be in another unit."""

from pathlib import Path

from adapters.samples import Quality
from service.ingest.probing import Probe, ProbedChannel, unit_doubts
from service.site.settings import load_settings

SITE = """
[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
[assets.channels]
speed_rpm = { source = "push" }
load_n = { source = "push" }
ambient_c = { source = "push" }
t_inner_ring_c = { source = "push" }
"""


def doubts(folder: Path, quality: int = Quality.GOOD, **values: float) -> list[str]:
    file = folder / "site.toml"
    file.write_text(SITE)
    channels = [
        ProbedChannel("bench-1", name, "plc", value, quality, 0.1, "")
        for name, value in values.items()
    ]
    return unit_doubts(load_settings(file), Probe([], channels, []))


def test_good_values_of_a_machine_are_doubted_by_its_bearing(tmp_path: Path) -> None:
    assert doubts(tmp_path, speed_rpm=1500.0, load_n=2650.0, ambient_c=23.0) == []
    assert doubts(tmp_path, speed_rpm=1500.0, load_n=2.65, ambient_c=73.4) == [
        "asset bench-1: load_n: 2.65 at 1500 rpm; expected 45 N or more, 0.1 % of the static load "
        "rating; kN?",
        "asset bench-1: ambient_c: 73.4; expected -60 to 60 °C; °F?",
    ]


def test_what_is_not_good_has_its_own_word(tmp_path: Path) -> None:
    assert doubts(tmp_path, Quality.SENSOR_FAILURE, speed_rpm=1500.0, load_n=2.65) == []
    assert unit_doubts(None, Probe([], [], [])) == []
