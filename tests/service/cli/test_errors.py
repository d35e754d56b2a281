"""What a user can mend: exit status 2 and one line that names it."""

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from patience import patience
from processes import free_port

from service.store import lock_data_directory

pytestmark = pytest.mark.wires

PATIENCE_S = 240.0
SOURCE = """
[[sources]]
name = "drive"
driver = "can"
interface = "slcan"
channel = "socket://127.0.0.1:1"
dbc = "{dbc}"

[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
speed_rpm = {{ source = "drive", message = "{message}", signal = "Speed" }}
"""
DBC = Path(__file__).parents[3] / "adapters" / "virtual_bench" / "bench.dbc"


@dataclass
class Waiting:
    """A service that waits for a port that somebody else has."""

    process: "subprocess.Popen[str]"
    taken: int

    def postponed(self) -> str:
        """Its last line, once it has given up: it may be tried again."""
        out, error = self.process.communicate(timeout=patience(PATIENCE_S))
        assert self.process.returncode == os.EX_TEMPFAIL, error[-3000:]
        assert out == ""
        line = error.splitlines()[-1]
        assert line.startswith("bearing-twin: ")
        return line


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody else listens on."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


def test_an_unknown_scenario_lists_the_known_ones(refused: Callable[..., str]) -> None:
    line = refused("virtual-bench", "--scenario", "stairs")
    assert "'stairs'" in line
    assert "staircase, load-steps" in line


@pytest.mark.parametrize("option", ["--modbus-port", "--can-port"])
def test_a_port_of_the_bench_in_use(refused: Callable[..., str], taken: int, option: str) -> None:
    other = "--can-port" if option == "--modbus-port" else "--modbus-port"
    assert str(taken) in refused("virtual-bench", option, str(taken), other, "0")


@pytest.mark.parametrize("rate", ["0", "nan"])
def test_a_rate_that_is_none(refused: Callable[..., str], rate: str) -> None:
    assert "rate" in refused(
        "virtual-bench", "--rate", rate, "--modbus-port", "0", "--can-port", "0"
    )


def test_a_truth_file_that_cannot_be_written(refused: Callable[..., str]) -> None:
    line = refused(
        "virtual-bench", "--truth", "no/such/folder/truth.csv", "--modbus-port", "0",
        "--can-port", "0",
    )  # fmt: skip
    assert "no/such/folder/truth.csv" in line


def test_a_port_of_the_demo_in_use_is_told_at_once(
    postponed: Callable[..., str], taken: int
) -> None:
    assert str(taken) in postponed("demo", "--headless", "--port", str(taken))


@pytest.mark.parametrize("command", [("serve",), ("keys", "list")])
def test_a_configuration_that_is_no_toml(
    refused: Callable[..., str], tmp_path: Path, command: tuple[str, ...]
) -> None:
    (tmp_path / "bad.toml").write_text("[service\nport = 1")
    line = refused(*command, "-c", "bad.toml")
    assert "bad.toml: not valid TOML" in line
    assert "line 1" in line


def test_a_configuration_that_is_not_there(refused: Callable[..., str]) -> None:
    assert "gone.toml: cannot be read" in refused("serve", "-c", "nowhere/gone.toml")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('bearing = "6311"', 'bearing = "6312"', ("assets[0].bearing", "6312", "6311")),
        ('load_n = { source = "push" }', 'load_n = { source = "pull" }', ("load_n", "pull")),
        ("port =", "prot =", ("service.prot", "unknown key")),
    ],
)
def test_a_wrong_key_is_named_with_its_value(
    refused: Callable[..., str], configure: Callable[..., Path], before: str, after: str,
    words: tuple[str, ...],
) -> None:  # fmt: skip
    config = configure()
    assert before in config.read_text()
    config.write_text(config.read_text().replace(before, after, 1))
    line = refused("serve", "-c", str(config))
    for word in words:
        assert word in line


def test_a_wrong_key_in_the_environment(refused: Callable[..., str]) -> None:
    line = refused("serve", environment={"BEARING_TWIN__SERVICE__PORT": "eighty"})
    assert "service.port" in line
    assert "eighty" in line


def test_a_dbc_that_is_not_there(
    refused: Callable[..., str], configure: Callable[..., Path]
) -> None:
    config = configure(SOURCE.format(dbc="gone.dbc", message="DriveStatus"))
    line = refused("serve", "-c", str(config))
    assert "gone.dbc" in line
    assert "dbc" in line.lower()


def test_a_message_that_the_dbc_does_not_have(
    refused: Callable[..., str], configure: Callable[..., Path]
) -> None:
    config = configure(SOURCE.format(dbc=DBC, message="DriveState"))
    line = refused("serve", "-c", str(config))
    assert "DriveState" in line
    assert "DriveStatus" in line, "it says what was probably meant"


def test_a_data_directory_that_cannot_be_one(
    refused: Callable[..., str], configure: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "data").write_text("a file")
    assert "data" in refused("serve", "-c", str(configure()))
    assert "data" in refused("keys", "list", "-c", str(configure()))


def test_a_store_that_is_none(
    refused: Callable[..., str], configure: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "bearing-twin.db").write_text("no database, but long enough " * 100)
    line = refused("serve", "-c", str(configure()))
    assert "bearing-twin.db" in line


def test_a_service_for_others_needs_a_key(
    refused: Callable[..., str], configure: Callable[..., Path]
) -> None:
    line = refused("serve", "-c", str(configure(service='host = "0.0.0.0"')))
    assert "keys create" in line


def test_a_service_for_others_without_a_key_is_refused_before_anything_is_waited_for(
    refused: Callable[..., str], configure: Callable[..., Path], tmp_path: Path
) -> None:
    config = configure(service='host = "0.0.0.0"')
    with lock_data_directory(tmp_path / "data"):  # the cell cannot start
        assert "keys create" in refused("serve", "-c", str(config))


def test_a_role_that_there_is_not(refused: Callable[..., str]) -> None:
    line = refused("keys", "create", "--role", "root")
    assert "root" in line
    assert "viewer" in line


def test_a_key_that_there_is_not(refused: Callable[..., str]) -> None:
    assert "bt_none" in refused("keys", "revoke", "bt_none")


@pytest.fixture(scope="module", autouse=True)
def waiting(tmp_path_factory: pytest.TempPathFactory, asset: str) -> Iterator[dict[str, Waiting]]:
    """Services whose ports are taken, started at once: they wait for half a minute."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        endpoint = f"opc.tcp://127.0.0.1:{taken}/bearing-twin"
        texts = {
            "service": f"[service]\nport = {taken}\n",
            "opcua": f"[service]\nport = {free_port()}\n"
            f'[opcua]\nenabled = true\nendpoint = "{endpoint}"\n',
        }
        started = {}
        for name, text in texts.items():
            file = tmp_path_factory.mktemp(name) / "site.toml"
            file.write_text(f"{text}\n{asset}")
            process = subprocess.Popen(
                [sys.executable, "-m", "service", "serve", "-c", str(file)],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            started[name] = Waiting(process, taken)
        yield started
        for service in started.values():
            service.process.kill()
            service.process.communicate()


def test_a_port_of_the_service_in_use(waiting: dict[str, Waiting]) -> None:
    line = waiting["service"].postponed()
    assert f"service.port = {waiting['service'].taken}" in line
    assert "expected a free port" in line


def test_an_opcua_endpoint_in_use_is_named(waiting: dict[str, Waiting]) -> None:
    line = waiting["opcua"].postponed()
    endpoint = f"opc.tcp://127.0.0.1:{waiting['opcua'].taken}/bearing-twin"
    assert f"opcua.endpoint = '{endpoint}': cannot listen there (Address already in use)" in line


@pytest.mark.parametrize("command", [("grease-renewed", "bench-1"), ("alarms", "import", "x.json")])
def test_a_comment_that_is_no_line_is_refused(
    refused: Callable[..., str], tmp_path: Path, command: tuple[str, ...]
) -> None:
    (tmp_path / "x.json").write_text('{"rows": []}')
    said = refused(*command, "--comment", "a\x1b[31m")
    expected = "expected one line of text, without control characters"
    assert said == f"bearing-twin: --comment: {expected}"
