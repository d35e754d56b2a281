"""However a service is asked to end, it ends cleanly: by the terminal, in the first seconds."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from patience import patience
from processes import Station, wait_until
from site_files import asset_text, write_site

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

VALUES = {"speed_rpm": 1500.0, "load_n": 2650.0, "t_inner_ring_c": 40.0}


@pytest.fixture(autouse=True)
def in_a_terminal() -> Iterator[None]:
    """Who runs the tests under nohup hands it on."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def station(tmp_path: Path) -> Iterator[Station]:
    with Station(tmp_path, *write_site(tmp_path, asset_text("motor-1", tuple(VALUES)))) as station:
        yield station


def test_a_terminal_that_is_closed_ends_all_processes_in_their_order(station: Station) -> None:
    service = station.start_service()
    assert station.push("motor-1", **VALUES).status_code == 200
    os.killpg(service.process.pid, signal.SIGHUP)
    assert service.process.wait(60) == 0
    assert "side_died" not in service.log.read_text()


def test_a_service_that_is_to_outlive_its_terminal_does(station: Station) -> None:
    service = station.start_service("nohup")
    os.killpg(service.process.pid, signal.SIGHUP)
    time.sleep(1.0)
    wait_until(lambda: station.push("motor-1", **VALUES).status_code == 200, 30, "a push")
    assert service.terminate() == 0
    assert "side_died" not in service.log.read_text()


@pytest.mark.parametrize("after_s", [0.5, 1.0, 1.5, 2.0, 3.0])
def test_ctrl_c_in_the_first_seconds_leaves_no_traceback(station: Station, after_s: float) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "service", "serve", "-c", str(station.configuration)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=patience(60))
    assert "Traceback" not in said
    assert process.returncode in (0, -signal.SIGINT, 130)
