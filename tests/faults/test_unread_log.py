"""Nobody reads what the service logs: a stuck log driver, a stopped terminal, a full disk."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest
from patience import patience
from processes import Station, wait_until
from site_files import asset_text, write_site
from unread import Unread
from websockets.sync.client import connect

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

VALUES = {"speed_rpm": 1500.0, "load_n": 2650.0, "t_inner_ring_c": 40.0}
STREAMS = 30


@pytest.fixture(params=["pipe", "terminal", "full disk"])
def station(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Station]:
    log = tmp_path / "serve.log"
    with Station(tmp_path, *write_site(tmp_path, asset_text("motor-1", tuple(VALUES)))) as station:
        if request.param == "full disk":
            log.symlink_to("/dev/full")
            yield station
            return
        unread = Unread(request.param)
        log.symlink_to(f"/proc/self/fd/{unread.near}")
        yield station
        os.close(unread.near)
        os.close(unread.far)


def test_a_service_works_and_ends_though_its_log_is_not_read(station: Station) -> None:
    service = station.start_service()
    wait_until(lambda: pushed(station), 60, "a push")
    for _ in range(STREAMS):  # each is a line of the log
        with connect(
            f"ws://127.0.0.1:{station.port}/api/v1/stream",
            additional_headers={"X-API-Key": station.key},
        ) as stream:
            stream.recv(timeout=patience(20))
    assert pushed(station)
    os.kill(service.side("web"), 9)
    wait_until(lambda: pushed(station), 60, "the web side, again")
    began_s = time.monotonic()
    assert service.terminate() == 0
    assert time.monotonic() - began_s < 20.0


def pushed(station: Station) -> bool:
    try:
        return station.push("motor-1", **VALUES).status_code == 200
    except httpx2.HTTPError:
        return False
