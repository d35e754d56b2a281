"""``bearing-twin check`` against a real Modbus server and a real CAN adapter."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from patience import patience
from processes import free_port

pytestmark = pytest.mark.wires
DBC = Path(__file__).parents[2] / "adapters" / "bench.dbc"

CONFIGURATION = """
[service]
port = {web}

[[sources]]
name = "pt100"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {modbus}

[[sources]]
name = "drive"
driver = "can"
interface = "slcan"
channel = "socket://127.0.0.1:{can}"
dbc = "{dbc}"

[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
t_inner_ring_c = {{ source = "pt100", register = 0, kind = "input", scale = 0.1 }}
t_outer_ring_c = {{ source = "pt100", register = 1, kind = "input", scale = 0.1 }}
speed_rpm = {{ source = "drive", message = "DriveStatus", signal = "Speed" }}
load_n = {{ source = "drive", message = "LoadCell", signal = "RadialLoad" }}
ambient_c = {{ source = "push" }}
"""


@pytest.fixture
def ports() -> dict[str, int]:
    return {"web": free_port(), "modbus": free_port(), "can": free_port()}


@pytest.fixture
def check(tmp_path: Path, ports: dict[str, int]) -> Callable[..., Any]:
    """Run the command on a changed configuration; returns exit status, document and errors."""

    def run(**changed: str) -> tuple[int, Any, str]:
        text = CONFIGURATION.format(**ports, dbc=DBC)
        for old, new in (pair.split(" -> ") for pair in changed.values()):
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "site.toml").write_text(text)
        ended = subprocess.run(
            [sys.executable, "-m", "service", "check", "-c", "site.toml", "--json"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=patience(120),
            check=False,
        )
        document = json.loads(ended.stdout)
        document["by"] = {one["channel"]: one for one in document["channels"]}
        return ended.returncode, document, ended.stderr

    return run


@pytest.fixture
def small_plant(ports: dict[str, int], peer: Callable[..., Any]) -> None:
    """With a device that has 50 registers of each kind."""
    peer("pymodbus_server.py", ports["modbus"]).start()
    peer("slcan_adapter.py", ports["can"], 0.05).start()


@pytest.fixture
def plant(ports: dict[str, int], peer: Callable[..., Any]) -> None:
    peer("pymodbustcp_server.py", ports["modbus"]).start()
    peer("slcan_adapter.py", ports["can"], 0.05).start()


@pytest.mark.usefixtures("plant")
def test_live_values_of_every_source(check: Callable[..., Any]) -> None:
    status, document, errors = check()
    assert (status, errors, document["ok"]) == (0, "", True)
    assert [(one["name"], one["up"], one["detail"]) for one in document["sources"]] == [
        ("pt100", True, "ok"),
        ("drive", True, "ok"),
    ]
    by = document["by"]
    assert by["t_inner_ring_c"]["value"] == pytest.approx(21.5)
    assert by["load_n"]["value"] == pytest.approx(2650.0)
    assert 1000.0 <= by["speed_rpm"]["value"] <= 8000.0
    for name in ("t_inner_ring_c", "load_n", "speed_rpm"):
        assert by[name]["quality"] == 192
        assert 0.0 <= by[name]["age_s"] < 60.0
    assert by["t_inner_ring_c"]["unit"] == "°C"
    assert by["ambient_c"]["detail"] == "waits for pushes"


@pytest.mark.usefixtures("small_plant")
@pytest.mark.parametrize(
    ("place", "hint"),
    [
        ('register = 30001, kind = "input"', "try register = 0"),
        ("register = 30001", 'try register = 0, kind = "input"'),
    ],
)
def test_a_register_as_a_data_sheet_counts(
    check: Callable[..., Any], place: str, hint: str
) -> None:
    status, document, errors = check(a=f'register = 0, kind = "input" -> {place}')
    assert status == 2
    (line,) = errors.splitlines()
    assert "channel bench-1/t_inner_ring_c (source 'pt100'): register 30001" in line
    assert line.endswith(f"illegal data address; data sheets count from 30001: {hint}")
    assert document["by"]["t_inner_ring_c"]["value"] is None
    assert document["by"]["t_outer_ring_c"]["quality"] == 192, "the others are read all the same"


def test_six_digits_are_named_before_anything_is_read(check: Callable[..., Any]) -> None:
    status, _, errors = check(a="register = 1, -> register = 300002,")
    assert status == 2
    assert "t_outer_ring_c.register = 300002: expected 0 to 65535" in errors
    assert 'data sheets count from 300001: try register = 1, kind = "input"' in errors


def test_what_does_not_answer_is_one_line_per_source(
    check: Callable[..., Any], ports: dict[str, int]
) -> None:
    status, document, errors = check()
    assert status == 2
    modbus, can = errors.splitlines()
    assert f"source 'pt100': cannot connect to 127.0.0.1:{ports['modbus']}" in modbus
    assert f"source 'drive': cannot open socket://127.0.0.1:{ports['can']}" in can
    assert [one["up"] for one in document["sources"]] == [False, False]
    assert document["by"]["t_inner_ring_c"]["age_s"] is None


@pytest.mark.usefixtures("plant")
def test_right_sources_are_read_beside_a_wrong_one(check: Callable[..., Any]) -> None:
    status, document, errors = check(a='"LoadCell" -> "LoadCel"')
    assert status == 2
    (line,) = errors.splitlines()
    assert "site.toml: channel bench-1/load_n: message 'LoadCel' is not in" in line
    assert "load_n" not in document["by"]
    assert document["by"]["speed_rpm"]["quality"] == 192
    assert document["by"]["t_inner_ring_c"]["quality"] == 192


@pytest.mark.parametrize(
    ("senders", "quality"), [(("00", "2A"), 192), (("2A", "2B"), 64), (("2A",), 192)]
)
def test_the_senders_of_a_group_are_named(
    check: Callable[..., Any],
    ports: dict[str, int],
    peer: Callable[..., Any],
    senders: Sequence[str],
    quality: int,
) -> None:
    peer("pymodbus_server.py", ports["modbus"]).start()
    adapter = peer("slcan_adapter.py", ports["can"], 0.05)
    adapter.start()
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(0.05):
            for number, sender in enumerate(senders):
                adapter.tell(f"line T18FEF0{sender}8{0x64 + number:02X}" + "FF" * 7)

    sending = threading.Thread(target=send)
    sending.start()
    try:
        status, document, errors = check(
            a='message = "LoadCell", signal = "RadialLoad" -> '
            'message = "EngineTemperature", signal = "Oil", unit = "N"'
        )
    finally:
        ended.set()
        sending.join()
    assert document["by"]["load_n"]["quality"] == quality
    assert status == (0 if quality == 192 else 2)
    assert ("EngineTemperature has several senders" in errors) == (senders == ("00", "2A"))
    assert ("load_n (source 'drive'): has several senders" in errors) == (quality != 192)
    if quality == 192:
        assert document["by"]["load_n"]["value"] == 60.0


@pytest.mark.thorough
@pytest.mark.usefixtures("plant")
def test_a_message_that_never_comes_is_named_within_the_limit(check: Callable[..., Any]) -> None:
    status, document, errors = check(
        a='message = "LoadCell", signal = "RadialLoad" -> '
        'message = "Pages", signal = "Warm", unit = "N"'
    )
    assert status == 2
    assert len(errors.splitlines()) == 1, errors
    assert "channel bench-1/load_n (source 'drive'): no value within 10 s" in errors
    assert document["by"]["speed_rpm"]["quality"] == 192
