"""``bearing-twin check`` without any wire: everything wrong at once, and what is missing."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from service.domain.channels import CHANNEL_NEEDS
from service.site.examination import examine
from service.store import Store

from .conftest import ASSET

pytestmark = pytest.mark.wires

Cli = Callable[..., "subprocess.CompletedProcess[str]"]
DOCS = Path(__file__).parents[3] / "docs"

# One mistake in each place that has a checker of its own.
WRONG = """
[[sources]]
name = "pt100"
driver = "modbus-tcp"
host = "127.0.0.1"
prt = 5020
timeout_s = 0

[[sources]]
name = "bus"
driver = "cam"

[[assets]]
id = "motor-1"
bearing = "6208"
low_risk = { speed_rpm_max = -1, load_n_max = 3400 }
[assets.channels]
speed_rpm = { source = "bsu", message = "A", signal = "B" }
load_n = { source = "push", register = 3 }
ambient_c = { source = "bus", message = "A", signal = "B" }
t_inner_ring_c = { source = "file", column = "t_innr" }

[[assets]]
id = "gear-1"
network = "gear.toml"
low_risk = { speed_rpm_max = 100, load_n_max = 3400 }
[assets.channels]
speed_rpm = { source = "push" }

[[sources]]
name = "file"
driver = "replay"
file = "data.csv"
"""
NETWORK = """
[parameters]
film = { unit = "W/K", centre = 6.0, spread = 0.3 }
[nodes]
t_housing_c = { capacity_j_k = -1 }
[[edges]]
between = ["t_housing_c", "ambient"]
kind = "fim"
[source]
kind = "linear"
shares = [{ node = "t_housing_c" }]
[sensors]
t_housing_c = "t_housing_c"
"""
EXPECTED = (
    "service.prot",
    "sources[0]: unknown key 'prt'; did you mean 'port'?",
    "sources[0].timeout_s = 0",
    "sources[1].driver = 'cam'",
    "(or give its dimensions bore_mm, outer_mm, width_mm)",
    "assets[0].low_risk.speed_rpm_max = -1",
    "assets[0].channels.speed_rpm.source = 'bsu'",
    "assets[0].channels.load_n: unknown key 'register'",
    "channel motor-1/t_inner_ring_c: column 't_innr'",
    "gear.toml: nodes.t_housing_c.capacity_j_k",
    "gear.toml: edges[0].kind = 'fim'",
)


@pytest.fixture
def wrong(configure: Callable[..., Path], tmp_path: Path) -> Path:
    (tmp_path / "gear.toml").write_text(NETWORK)
    (tmp_path / "data.csv").write_text("time_s,t_inner\n0,20\n1,20\n")
    config = configure(WRONG)
    config.write_text(config.read_text().replace("port =", "prot =", 1))
    return config


@pytest.mark.parametrize("command", ["check", "serve"])
def test_everything_wrong_is_named_at_once_with_the_file(
    cli: Cli, wrong: Path, command: str
) -> None:
    ended = cli(command, "-c", str(wrong))
    assert ended.returncode == 2
    lines = [line for line in ended.stderr.splitlines() if ": warning: " not in line]
    for line in lines:
        assert line.startswith(f"bearing-twin: {wrong}: ")
    for words in EXPECTED:
        assert [words in line for line in lines].count(True) == 1, (words, lines)
    # Nothing is said of the channel whose source has the error.
    assert len(lines) == len(EXPECTED)


def test_errors_come_in_json_too(cli: Cli, wrong: Path) -> None:
    ended = cli("check", "-c", str(wrong), "--json")
    assert ended.returncode == 2
    document = json.loads(ended.stdout)
    assert set(document) == {"file", "ok", "errors", "warnings", "sources", "channels", "plans"}
    assert (document["file"], document["ok"]) == (str(wrong), False)
    assert len(document["errors"]) == len(EXPECTED)


def test_what_only_gets_pushes_is_right_and_waits(cli: Cli, configure: Callable[..., Path]) -> None:
    ended = cli("check", "-c", str(configure()), "--json")
    assert (ended.returncode, ended.stderr) == (0, "")
    document = json.loads(ended.stdout)
    assert (document["ok"], document["errors"], document["warnings"]) == (True, [], [])
    (speed,) = (one for one in document["channels"] if one["channel"] == "speed_rpm")
    assert speed == {
        "asset": "motor-1", "channel": "speed_rpm", "source": "push", "value": None, "unit": "rpm",
        "quality": None, "age_s": None, "detail": "waits for pushes",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ("ambient_c", "recommended channel ambient_c is missing: ambient is assumed"),
        ("load_n", "required channel load_n is missing"),
        ("t_inner_ring_c", "required channel a temperature is missing"),
    ],
)
def test_a_missing_channel_is_a_warning(
    cli: Cli, configure: Callable[..., Path], channel: str, words: str
) -> None:
    ended = cli("check", "-c", str(configure(ASSET.replace(f"{channel} =", "t_node_9_c =", 1))))
    if channel == "t_inner_ring_c":
        ended = cli("check", "-c", str(configure(ASSET.replace(f"{channel} =", "# ", 1))))
    assert ended.returncode == 0
    (line,) = ended.stderr.splitlines()
    assert "warning: " in line
    assert words in line


def test_a_variable_that_is_no_json_is_named(refused: Callable[..., str]) -> None:
    line = refused("serve", environment={"BEARING_TWIN__SOURCES": "[{"})
    assert "BEARING_TWIN__SOURCES: expected JSON text" in line
    assert "JSON" in line


def test_files_of_the_web_side_are_checked(cli: Cli, configure: Callable[..., Path]) -> None:
    config = configure(f'[tls]\ncertificate = "no.pem"\nkey = "no.key"\n{ASSET}')
    ended = cli("check", "-c", str(config))
    assert ended.returncode == 2
    assert "no.pem" in ended.stderr


def test_the_environment_is_checked_beside_a_wrong_file(
    configure: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configure(ASSET, service="spool_mib = 0")
    monkeypatch.setenv("BEARING_TWIN__SOURCES", '[{"name": "x", "driver": "none"}]')
    errors = examine(config).errors
    assert len(errors) == 2
    assert "service.spool_mib = 0" in errors[0]
    assert "sources[0].driver = 'none'" in errors[1]


def test_the_documentation_has_the_table_of_channels() -> None:
    page = (DOCS / "connect" / "configuration.md").read_text()
    for one in CHANNEL_NEEDS:
        assert f"| `{one.channel}` | {one.need} | {one.without} |" in page, one


TEMPLATE = """
[[templates]]
name = "axle"
bearing = "6311"
group = "Line {line} {depot}"
low_risk = { speed_rpm_max = 900, load_n_max = 4000 }
[templates.channels]
t_outer_ring_c = { source = "push" }
ambient_c = { source = "push" }
speed_rpm = { source = "push" }
load_n = { source = "push" }
"""


def test_assets_in_the_store_are_checked_too(
    cli: Cli, configure: Callable[..., Path], tmp_path: Path
) -> None:
    file = configure(TEMPLATE)
    fits = cli("check", "-c", str(file))
    assert fits.returncode == 0, fits.stderr
    with Store.open("", tmp_path / "data") as store:
        table = {"template": "axle", "values": {"line": 7}}
        store.assets.change({f"axle-{number}": table for number in range(12)}, 1)
    found = cli("check", "--json", "-c", str(file))
    assert found.returncode == 2
    (error,) = json.loads(found.stdout)["errors"]
    assert "assets in the store: values.depot: missing; template 'axle' asks for it" in error
    assert "(12 of 12: axle-0, axle-1, axle-10, axle-11, axle-2 and 7 more)" in error


def test_it_says_when_it_did_not_look_into_the_store(
    cli: Cli, configure: Callable[..., Path], tmp_path: Path
) -> None:
    file = configure(TEMPLATE)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "bearing-twin.db").write_bytes(b"no database" * 1000)
    found = cli("check", "-c", str(file))
    assert "warning: " in found.stderr
    assert "the assets in the store were not checked: " in found.stderr
