"""Templates: what many assets have in common, and how each mistake is named."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from service.site.configuration import SettingsError
from service.site.settings import Settings, load_settings
from service.site.wiring import wire

SITE = """\
[bearings.axle-box]
bore_mm = 130
outer_mm = 240
width_mm = 80

[[sources]]
name = "gateway-1"
driver = "modbus-tcp"
host = "127.0.0.1"
port = 5020

[[templates]]
name = "axle"
bearing = "axle-box"
group = "Line {line}"
low_risk = { speed_rpm_max = 900, load_n_max = 40000 }
values = { line = 7, gateway = "gateway-1" }
[templates.limits]
t_inner_ring_c = { warning = 80, alarm = 95 }
[templates.channels]
t_outer_ring_c = { source = "{gateway}", unit_id = "{unit}", register = 0, kind = "input" }
ambient_c = { source = "{gateway}", unit_id = "{unit}", register = 1, kind = "input" }
speed_rpm = { source = "push" }
load_n = { source = "push" }
"""
THREE_LINES = """
[[assets]]
id = "axle-1"
template = "axle"
values = { unit = 11 }
"""


def load(folder: Path, text: str) -> Settings:
    file = folder / "twin.toml"
    file.write_text(text)
    settings = load_settings(file)
    wire(settings)
    return settings


def error_of(folder: Path, text: str) -> str:
    with pytest.raises(SettingsError) as caught:
        load(folder, text)
    return str(caught.value)


def test_an_asset_of_three_lines_is_whole(tmp_path: Path) -> None:
    settings = load(tmp_path, SITE + THREE_LINES)
    (asset,) = settings.assets
    assert (asset.id, asset.template, asset.group) == ("axle-1", "axle", "Line 7")
    assert asset.bearing is not None
    assert (asset.bearing.designation, asset.bearing.bore_mm) == ("axle-box", 130)
    assert asset.limits["t_inner_ring_c"].alarm == 95
    # A number, not the text of one: the driver checks it as if it stood there.
    (source,) = wire(settings).sources
    assert {binding.config.unit_id for binding in source.channels} == {11}  # type: ignore[attr-defined]
    assert {binding.channel for binding in source.channels} == {"t_outer_ring_c", "ambient_c"}


def test_assets_share_what_none_of_them_gives(tmp_path: Path) -> None:
    """The defaults of the alarms alone are half of what an asset would hold."""
    first, second = load(tmp_path, SITE + THREE_LINES + THREE_LINES.replace("-1", "-2")).assets
    assert first.alarms is second.alarms
    assert first.bearing == second.bearing
    with pytest.raises(ValidationError, match="frozen"):
        first.alarms.standstill_rpm = 1.0


def test_what_an_asset_gives_itself_wins_key_by_key(tmp_path: Path) -> None:
    own = """
group = "Workshop"
[assets.channels]
load_n = { source = "push", max_age_s = 3 }
[assets.limits]
t_outer_ring_c = { warning = 60, alarm = 75 }
"""
    (asset,) = load(tmp_path, SITE + THREE_LINES + own).assets
    assert asset.group == "Workshop"
    assert asset.channels["load_n"] == {"source": "push", "max_age_s": 3}
    assert asset.channels["speed_rpm"] == {"source": "push"}
    assert set(asset.limits) == {"t_inner_ring_c", "t_outer_ring_c"}


def test_many_assets_share_one_source(tmp_path: Path) -> None:
    assets = "".join(
        f'\n[[assets]]\nid = "axle-{n}"\ntemplate = "axle"\nvalues = {{ unit = {n} }}\n'
        for n in range(1, 201)
    )
    wiring = wire(load(tmp_path, SITE + assets))
    (source,) = wiring.sources
    assert len(source.channels) == 400
    assert len(wiring.channels) == 200


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (THREE_LINES.replace("unit = 11", ""), "assets[0].values.unit: missing; template 'axle'"),
        (
            THREE_LINES.replace("unit = 11", "unit = 1, seat = 2"),
            "assets[0].values.seat: template 'axle' does not ask for it",
        ),
        (
            THREE_LINES.replace('"axle"', '"axel"'),
            "assets[0].template = 'axel': did you mean 'axle'?",
        ),
        (THREE_LINES.replace('template = "axle"', ""), "assets[0].values: expected a template"),
        (THREE_LINES.replace("{ unit = 11 }", "11"), "assets[0].values: expected a table"),
        (THREE_LINES.replace("11", '"eleven"'), "assets[0].channels.t_outer_ring_c.unit_id"),
        (THREE_LINES.replace("unit = 11", 'unit = 1, gateway = "gw"'), "source = 'gw'"),
        ('\n[[templates]]\nname = "axle"\n', "templates[1].name = 'axle': used twice"),
        ("\n[[templates]]\ngroup = 'a'\n", "templates[1].name = None: expected a name"),
        ('\n[[templates]]\nname = "a"\nid = "b"\n', "templates[1].id: unknown key"),
        ('\n[[templates]]\nname = "a"\nvalues = 3\n', "templates[1].values: expected a table"),
    ],
)
def test_each_mistake_names_its_key(tmp_path: Path, wrong: str, expected: str) -> None:
    assert expected in error_of(tmp_path, SITE + wrong)


def test_every_hole_is_named_at_once(tmp_path: Path) -> None:
    text = SITE.replace("line = 7, ", "") + THREE_LINES.replace("unit = 11", "")
    message = error_of(tmp_path, text)
    assert "values.line: missing" in message
    assert "values.unit: missing" in message


def test_an_asset_beside_the_file_is_checked_as_those_in_it(tmp_path: Path) -> None:
    settings = load(tmp_path, SITE)
    table = {"id": "axle-9", "template": "axle", "values": {"unit": 9}}
    asset = settings.asset(table, "axle-9")
    assert asset.channels["ambient_c"]["unit_id"] == 9
    with pytest.raises(SettingsError, match=r"axle-9\.low_risk\.speed_rpm_max"):
        settings.asset(table | {"low_risk": {"speed_rpm_max": -1}}, "axle-9")
