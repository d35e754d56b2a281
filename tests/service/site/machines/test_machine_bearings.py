"""Bearings in the configuration: by designation, by dimensions, by name, from a file."""

from pathlib import Path

import pytest
from site_files import asset_text

from service.site.configuration import SettingsError
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from service.site.settings import load_settings
from twin_core.bearings import UnknownBearingError, bearing

ASSET = asset_text("bench-1", ["t_inner_ring_c"])
TABLE = '{ designation = "6208-custom", bore_mm = 40, outer_mm = 80, width_mm = 18 }'
DETAILS = """
bore_mm = 40
outer_mm = 80
width_mm = 18
ball_count = 9
ball_diameter_mm = 12.0
inner_shoulder_mm = 52.6
outer_shoulder_mm = 69.8
static_load_rating_n = 19000
cage_kg = 0.08
"""


def configured(folder: Path, given: str, more: str = "") -> Machine:
    file = folder / "twin.toml"
    file.write_text(more + ASSET.replace('"6311"', given))
    asset = load_settings(file).assets[0]
    return Machine(asset.model, asset.bearing, asset.network)


def test_a_designation_of_the_catalogue(tmp_path: Path) -> None:
    machine = configured(tmp_path, '"6016"')
    assert machine.bearing is not None
    assert machine.bearing.bearing() == bearing("6016")


def test_dimensions_alone_are_enough(tmp_path: Path) -> None:
    machine = configured(tmp_path, TABLE)
    assert machine.bearing is not None
    part = machine.bearing.bearing()
    assert (part.designation, part.bore_mm, part.outer_mm) == ("6208-custom", 40.0, 80.0)
    assert part.ball_diameter_mm == pytest.approx(12.4)
    model = machine.build()
    assert model.machine == "6208-custom"
    assert model.sensor_names == ("t_inner_ring_c", "t_outer_ring_c")


def test_what_is_given_is_not_estimated(tmp_path: Path) -> None:
    machine = configured(tmp_path, '"spindle"', f'[bearings."spindle"]{DETAILS}')
    assert machine.bearing is not None
    part = machine.bearing.bearing()
    assert part.designation == "spindle"
    assert (part.ball_count, part.ball_diameter_mm, part.cage_kg) == (9, 12.0, 0.08)
    assert (part.inner_shoulder_mm, part.outer_shoulder_mm) == (52.6, 69.8)
    assert part.static_load_rating_n == 19000.0


def test_a_file_of_dimensions(tmp_path: Path) -> None:
    file = tmp_path / "6208.toml"
    file.write_text(DETAILS)
    part = named_bearing(str(file), {})
    assert part.name == "6208"
    assert part.ball_count == 9


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("6311", "expected"),
        ("{ bore_mm = 40, outer_mm = 80 }", "assets[0].bearing.width_mm: missing"),
        ("{ bore_mm = 90, outer_mm = 80, width_mm = 18 }", "bore_mm is 90.0 and outer_mm 80.0"),
        ("{ bore_mm = -1, outer_mm = 80, width_mm = 18 }", "assets[0].bearing.bore_mm = -1"),
        ("{ bore_mm = 40, outer_mm = 80, width_mm = 18, balls = 8 }", "bearing.balls"),
        ("{ bore_mm = 40, outer_mm = 80, width_mm = 18, ball_count = 30 }", "ball_count is 30"),
        (
            "{ bore_mm = 40, outer_mm = 80, width_mm = 18, ball_diameter_mm = 25 }",
            "ball_diameter_mm is 25.0, expected > 0 and less than the section 20.0",
        ),
        ('"6208-custom"', "unknown bearing '6208-custom', expected one of 6016, 6311"),
    ],
)
def test_a_mistake_is_named_in_one_line(tmp_path: Path, given: str, expected: str) -> None:
    with pytest.raises(SettingsError) as caught:
        configured(tmp_path, given)
    assert expected in str(caught.value)
    assert "assets[0].bearing" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mistake_in_the_table_of_bearings_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"bearings\.spindle\.bore_mm = 0"):
        configured(tmp_path, '"6311"', f'[bearings."spindle"]{DETAILS.replace("40", "0", 1)}')


def test_mistakes_in_a_file_are_named(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text("bore_mm = 40\nouter_mm = 80\n")
    with pytest.raises(SettingsError, match=r"own\.toml: width_mm: missing"):
        named_bearing(str(file), {})
    with pytest.raises(SettingsError, match=r"absent\.toml: cannot be read"):
        named_bearing(str(tmp_path / "absent.toml"), {})
    with pytest.raises(UnknownBearingError, match="6999"):
        named_bearing("6999", {})
