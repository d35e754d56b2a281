"""Configuration: what is accepted, and how each mistake is named."""

import traceback
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from service.site.configuration import SettingsError, describe_all
from service.site.settings import Settings, load_settings
from service.site.wiring import wire

DBC = """\
VERSION ""
BS_:
BU_: Drive
BO_ 256 DriveStatus: 8 Drive
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" Drive
BO_ 257 LoadCell: 8 Drive
 SG_ RadialLoad : 0|16@1+ (0.5,0) [0|30000] "N" Drive
"""

CONFIGURATION = """\
[service]
port = 8099

[[sources]]
name = "pt100"
driver = "modbus-tcp"
host = "127.0.0.1"
port = 5020

[[sources]]
name = "drive"
driver = "can"
channel = "socket://127.0.0.1:5021"
dbc = "bench.dbc"

[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3000 }
limits = { t_inner_ring_c = { warning = 90, alarm = 105 } }
[assets.channels]
t_inner_ring_c = { source = "pt100", register = 0, kind = "input", type = "int16", scale = 0.1 }
t_outer_ring_c = { source = "pt100", register = 1, kind = "input", type = "int16", scale = 0.1 }
ambient_c = { source = "push" }
speed_rpm = { source = "drive", message = "DriveStatus", signal = "Speed" }
load_n = { source = "drive", message = "LoadCell", signal = "RadialLoad", max_age_s = 3 }
[assets.controller]
plan = { source = "pt100", register = 100, rows = 8 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bench.dbc").write_text(DBC)
    return tmp_path


def load(folder: Path, text: str) -> None:
    file = folder / "twin.toml"
    file.write_text(text)
    wire(load_settings(file))


def test_a_complete_configuration_is_wired(folder: Path) -> None:
    file = folder / "twin.toml"
    file.write_text(CONFIGURATION)
    settings = load_settings(file)
    wiring = wire(settings)
    assert settings.service.port == 8099
    assert settings.data_dir == folder / "var"
    assert [source.name for source in wiring.sources] == ["pt100", "drive"]
    assert [binding.channel for binding in wiring.sources[0].channels] == [
        "t_inner_ring_c",
        "t_outer_ring_c",
    ]
    assert len(wiring.sources[0].plans) == 1
    facts = wiring.channels["bench-1"]
    assert facts["ambient_c"].source == "push"
    assert facts["load_n"].max_age_s == 3


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("[assets.alarms]\nstandstil_rpm = 1", ["assets[0].alarms.standstil_rpm", "unknown key"]),
        (
            "[assets.alarms.measured_limit]\non_delay_s = -1",
            ["assets[0].alarms.measured_limit.on_delay_s = -1", "greater than or equal to 0"],
        ),
        (
            "[assets.alarms.sensor_fault]\npriority = 4",
            ["assets[0].alarms.sensor_fault.priority = 4", "1, 2 or 3"],
        ),
        (
            "[assets.alarms.rate_of_rise.limits]\nwarning = 9\nalarm = 8",
            ["assets[0].alarms.rate_of_rise.limits", "warning 9 must be below alarm 8"],
        ),
        (
            "[assets.alarms.forecast_limit]\nclear_probability = 0.5",
            ["assets[0].alarms.forecast_limit", "clear_probability 0.5"],
        ),
        (
            "[assets.alarms.twin_residual]\nfalse_alarms_per_1000_h = 0",
            ["twin_residual.false_alarms_per_1000_h = 0", "greater than 0"],
        ),
        (
            "[assets.alarms.above_ambient.limits]\nt_node_9_c = { warning = 50, alarm = 60 }",
            ["alarms.above_ambient.limits.t_node_9_c", "among the channels"],
        ),
    ],
)
def test_a_mistake_in_the_alarms_is_named_in_one_line(
    folder: Path, lines: str, expected: list[str]
) -> None:
    with pytest.raises(SettingsError) as error:
        load(folder, CONFIGURATION + lines)
    assert "\n" not in str(error.value)
    for part in expected:
        assert part in str(error.value)


def test_alarms_have_defaults_and_take_what_is_given(folder: Path) -> None:
    file = folder / "twin.toml"
    file.write_text(
        CONFIGURATION + "[assets.alarms.measured_limit]\nlatched = true\ndeadband_k = 2\n"
        "[assets.alarms.above_ambient.limits]\nt_inner_ring_c = { warning = 50, alarm = 60 }\n"
    )
    alarms = load_settings(file).assets[0].alarms
    assert (alarms.measured_limit.latched, alarms.measured_limit.deadband_k) == (True, 2.0)
    assert alarms.measured_limit.off_delay_s == 60.0
    assert alarms.above_ambient.limits["t_inner_ring_c"].alarm == 60.0
    assert alarms.twin_residual.priority == 3


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("port = 8099", "port = 99999", ["service.port = 99999", "65535"]),
        ("port = 8099", "prt = 1", ["service.prt", "unknown key"]),
        ('bearing = "6311"\n', "", ["assets[0].bearing", "missing"]),
        ('bearing = "6311"', 'bearing = "9999"', ["assets[0].bearing", "9999", "6311"]),
        ("speed_rpm_max = 4300", "speed_rpm_max = -1", ["low_risk.speed_rpm_max = -1"]),
        ("warning = 90", "warning = 110", ["limits.t_inner_ring_c", "110", "105"]),
        ("t_outer_ring_c = {", "t_outer_rnig_c = {", ["channels.t_outer_rnig_c", "t_outer_ring_c"]),
        ('"modbus-tcp"', '"modbus-tpc"', ["sources[0].driver", "modbus-tpc", "modbus-tcp"]),
        (
            'source = "drive", message = "Drive',
            'source = "dirve", message = "Drive',
            ["assets[0].channels.speed_rpm.source", "dirve", "drive"],
        ),
        ('signal = "Speed"', 'signal = "Sped"', ["Sped", "Speed"]),
        ('message = "LoadCell"', 'message = "LoadCel"', ["LoadCel", "LoadCell"]),
        ('dbc = "bench.dbc"', 'dbc = "no.dbc"', ["no.dbc"]),
        ("register = 1,", "register = 70000,", ["t_outer_ring_c.register = 70000"]),
        ('type = "int16"', 'type = "int17"', ["t_inner_ring_c.type", "int17", "int16"]),
        ("rows = 8", "rows = 0", ["controller.plan.rows = 0"]),
        (
            'ambient_c = { source = "push" }',
            'ambient_c = { source = "push", register = 3 }',
            ["assets[0].channels.ambient_c", "register"],
        ),
        ('name = "drive"', 'name = "pt100"', ["sources", "pt100", "twice"]),
    ],
)
def test_a_mistake_is_named_in_one_line(
    folder: Path, old: str, new: str, expected: list[str]
) -> None:
    assert old in CONFIGURATION
    with pytest.raises(ValueError, match=r".") as caught:
        load(folder, CONFIGURATION.replace(old, new, 1))
    message = str(caught.value)
    assert "\n" not in message
    for part in expected:
        assert part in message


def test_a_broken_dbc_is_named(folder: Path) -> None:
    (folder / "bench.dbc").write_text("BO_ this is no DBC")
    with pytest.raises(SettingsError, match=r"bench\.dbc"):
        load(folder, CONFIGURATION)


def test_no_toml_and_no_file(folder: Path) -> None:
    with pytest.raises(SettingsError, match="not valid TOML"):
        load(folder, "port =")
    with pytest.raises(SettingsError, match=r"absent\.toml: cannot be read"):
        load_settings(folder / "absent.toml")


def test_the_environment_wins_over_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BEARING_TWIN__SERVICE__PORT", "9001")
    monkeypatch.setenv("BEARING_TWIN__CLOCK__RATE", "60")
    monkeypatch.setenv("BEARING_TWIN__SOURCES", "[]")
    file = folder / "twin.toml"
    file.write_text(CONFIGURATION)
    settings = load_settings(file)
    assert (settings.service.port, settings.clock.rate, settings.sources) == (9001, 60, ())


def test_retention_is_years_for_what_people_did_and_may_be_for_ever(folder: Path) -> None:
    file = folder / "twin.toml"
    file.write_text(CONFIGURATION)
    retention = load_settings(file).retention
    assert (retention.raw_days, retention.journal_days, retention.audit_days) == (None, 3652, 3652)
    file.write_text(f"{CONFIGURATION}[retention]\njournal_days = 0\naudit_days = 0\n")
    retention = load_settings(file).retention
    assert (retention.journal_days, retention.audit_days) == (0, 0)
    with pytest.raises(SettingsError, match=r"retention\.audit_days = 30.*0 .* at least 366 days"):
        load(folder, f"{CONFIGURATION}[retention]\naudit_days = 30\n")


def test_ages_follow_the_kind_of_source(folder: Path) -> None:
    text = CONFIGURATION.replace(
        'host = "127.0.0.1"', 'host = "127.0.0.1"\npoll_interval_s = 30', 1
    )
    assert "max_age_s = 3" in text
    file = folder / "twin.toml"
    file.write_text(text)
    facts = wire(load_settings(file)).channels["bench-1"]
    assert {name: (one.max_age_s, one.learned_from_s) for name, one in facts.items()} == {
        "speed_rpm": (10.0, 2.0),
        "load_n": (3.0, None),
        "ambient_c": (120.0, 10.0),
        "t_inner_ring_c": (150.0, None),
        "t_outer_ring_c": (150.0, None),
    }


SECRET = "48151623"


@pytest.mark.parametrize(
    "text",
    [
        f"[mqtt]\npassword = {SECRET}",
        f"[mqtt]\npassword = [{SECRET}]",
        f'[mqtt]\npasword = "{SECRET}"',
        f'[mqtt]\nPASSWORD = "{SECRET}"',
        f'[mqtt]\nport = "{SECRET}x"\npassword = {SECRET}.5',
        f'[mqt]\npassword = "{SECRET}"',
        f'mqtt = "mqtt://user:{SECRET}@broker"',
        f'password = "{SECRET}"',
        f"[service]\ndatabase_url = {SECRET}",
        f'[service]\ndatabase_ulr = "postgresql://u:{SECRET}@h/d"',
        f'[service]\ndatabase_url = ["postgresql://u:{SECRET}@h/d"]',
        f'service = "postgresql://u:{SECRET}@h/d"',
    ],
)
def test_no_error_shows_a_password(tmp_path: Path, text: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(text)
    with pytest.raises(SettingsError) as caught:
        load_settings(path)
    shown = str(caught.value).replace(f"'{SECRET}x'", "")  # a port is no secret
    assert SECRET not in shown
    # Nor would a log that takes the causes along.
    causes = "".join(traceback.format_exception(caught.value)).replace(f"'{SECRET}x'", "")
    assert SECRET not in causes


def test_settings_are_printed_without_their_passwords(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(
        f'[service]\ndatabase_url = "postgresql://u:{SECRET}@h/d"\n[mqtt]\npassword = "{SECRET}"'
    )
    assert SECRET not in f"{load_settings(path)!r} {load_settings(path)}"


FLEET = {
    "database_url": "postgresql://twin:hidden@db/twin",
    "nats_url": "nats://hidden@bus:4222",
}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"nats_url": ""}, "fleet.nats_url: missing"),
        ({"database_url": ""}, "fleet.database_url: missing"),
        ({"nats_url": "nats://bus:4222"}, "expected a token"),
        ({"nats_url": "http://hidden@bus:4222"}, "expected nats://TOKEN@HOST:PORT"),
        ({"database_url": "sqlite:///hidden.db"}, "expected postgresql://"),
        ({"partitions": 0}, "fleet.partitions"),
    ],
)
def test_a_fleet_that_is_not_whole_is_refused(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValidationError) as refused:
        Settings(fleet=FLEET | changes)
    said = describe_all(refused.value)
    assert expected in said[0]
    assert "hidden" not in said[0]


def test_a_fleet_keeps_everything_in_its_database() -> None:
    settings = Settings(fleet=FLEET)
    assert settings.is_fleet
    assert settings.service.database_url == FLEET["database_url"]
    assert "hidden" not in repr(settings)
    assert not Settings().is_fleet
    with pytest.raises(ValidationError, match="expected 1 with"):
        Settings(fleet=FLEET, clock={"rate": 2.0})
    with pytest.raises(ValidationError, match="expected one of them"):
        Settings(fleet=FLEET, service={"database_url": "postgresql://other/db"})


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('id = "bench-1"', 'id = "bench-1"\nname = "a\\u001Bb"', r"assets[0].name = 'a\x1bb'"),
        ('id = "bench-1"', 'id = "bench-1"\ngroup = "a\\u202Eb"', r"assets[0].group = 'a\u202eb'"),
        ('id = "bench-1"', 'id = "bench-1"\nfamily = "a\\nb"', r"assets[0].family = 'a\nb'"),
        ('name = "pt100"', 'name = "pt\\u200B100"', r"sources[0].name = 'pt\u200b100'"),
    ],
)
def test_a_name_is_one_line_of_visible_characters(
    folder: Path, old: str, new: str, said: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        load(folder, CONFIGURATION.replace(old, new))
    expected = "expected one line of text, without control characters"
    assert str(caught.value) == f"{folder / 'twin.toml'}: {said}: {expected}"
