"""Machines that have no room for this or that: a service works there, or says what it lacks."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest
from processes import Station, wait_until
from site_files import asset_text, write_site
from websockets.sync.client import connect

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

VALUES = {"speed_rpm": 1500.0, "load_n": 2650.0, "t_inner_ring_c": 40.0, "ambient_c": 22.0}
WHAT_IF = {"profile": [{"duration_s": 600.0, "speed_rpm": 2000.0, "load_n": 2650.0}]}
NO_WORKER = "no worker process can be started (Read-only file system)"


@pytest.fixture
def station(tmp_path: Path) -> Iterator[Station]:
    with Station(tmp_path, *write_site(tmp_path, asset_text("motor-1", tuple(VALUES)))) as station:
        yield station


def test_without_shared_memory_machines_are_followed(
    station: Station, preloaded: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LD_PRELOAD", preloaded("no_semaphores"))
    command = [sys.executable, "-m", "service", "check", "-c", str(station.configuration)]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert f"warning: no identification and no what-if forecast: {NO_WORKER}" in checked.stderr
    service = station.start_service()
    wait_until(lambda: pushed(station), 60, "a push")
    web, cell = service.side("web"), service.side("cell")
    with connect(
        f"ws://127.0.0.1:{station.port}/api/v1/stream",
        additional_headers={"X-API-Key": station.key},
    ):
        time.sleep(2.5)  # the worker of what-ifs is begun for a client of the stream
    wait_until(lambda: NO_WORKER in forecast(station).text, 120, "a reason")
    assert forecast(station).status_code == httpx2.codes.SERVICE_UNAVAILABLE
    assert (service.side("web"), service.side("cell")) == (web, cell)
    assert service.terminate() == 0


def test_a_long_temporary_folder_is_no_place_for_sockets(
    station: Station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / ("t" * 95)
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    service = station.start_service()
    wait_until(lambda: pushed(station), 60, "a push")
    web = service.side("web")
    os.kill(web, 9)
    wait_until(lambda: service.side("web") != web and pushed(station), 60, "the web side, again")
    service.kill()
    assert not list(temporary.iterdir()), "nothing is left of a service that was killed"


def pushed(station: Station) -> bool:
    try:
        return station.push("motor-1", **VALUES).status_code == 200
    except httpx2.HTTPError:
        return False


def forecast(station: Station) -> httpx2.Response:
    assert pushed(station)
    return station.client.post("/api/v1/assets/motor-1/forecasts", json=WHAT_IF)
