"""The system clock of a real service is set while an alarm is shelved, and between two runs.

`clock_set.c` stands between the service and the C library and adds seconds to the system clock.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from processes import Station, wait_until
from site_files import asset_text, write_site

from service.clock import wall_us

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

CHANNEL = "t_inner_ring_c"
HOT = {"speed_rpm": 1500.0, "load_n": 2650.0, CHANNEL: 80.0}
ALARMS = f"""
[assets.limits]
{CHANNEL} = {{ warning = 70, alarm = 95 }}
[assets.alarms.measured_limit]
on_delay_s = 1
off_delay_s = 5
"""


class Site(Station):
    """A service that is pushed to by a gateway on the same machine."""

    def __init__(self, folder: Path) -> None:
        text = asset_text("motor-1", tuple(HOT)) + ALARMS
        super().__init__(folder, *write_site(folder, text))
        self.clock = folder / "clock-set"
        self.set_clock(0)

    def set_clock(self, by_s: int) -> None:
        self.by_us = by_s * 1_000_000
        new = self.clock.with_suffix(".new")
        new.write_text(f"{by_s}\n")
        new.replace(self.clock)

    def now_us(self) -> int:
        return wall_us() + self.by_us

    def alarm(self) -> dict[str, Any] | None:
        """The limit alarm as it is after one more push."""
        assert self.push("motor-1", **HOT).status_code == 200
        found = self.get("/api/v1/alarms", asset="motor-1")["items"]
        return next((one for one in found if one["kind"] == "measured limit"), None)

    def state(self) -> str:
        found = self.alarm()
        return "" if found is None else str(found["state"])


@pytest.fixture
def site(
    tmp_path: Path, preloaded: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Site]:
    with Site(tmp_path) as site:
        monkeypatch.setenv("LD_PRELOAD", preloaded("clock_set"))
        monkeypatch.setenv("CLOCK_SET", str(site.clock))
        yield site


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_shelving_lasts_as_long_as_it_was_to(site: Site, step_s: int) -> None:
    service = site.start_service()
    found = wait_until(site.alarm, 60, "an alarm", 0.3)
    path = f"/api/v1/alarms/{found['id']}/shelve"

    def shelve(seconds: float) -> float:
        answer = site.client.post(path, json={"duration_s": seconds, "comment": "sensor"})
        assert answer.status_code == 200, answer.text
        return time.monotonic()

    shelved_s = shelve(8)
    site.set_clock(step_s)
    while time.monotonic() < shelved_s + 6:
        assert site.state() == "SHLVD"
        time.sleep(0.3)
    wait_until(lambda: site.state() == "UNACK", 30, "the end of the shelving", 0.3)

    shelved_s = shelve(30)
    time.sleep(2.0)  # the mark for the next run is on the disk
    assert service.terminate() == 0
    site.set_clock(-step_s)
    site.start_service()
    while time.monotonic() < shelved_s + 26:
        assert site.state() == "SHLVD"
        time.sleep(0.5)
    wait_until(lambda: site.state() == "UNACK", 30, "the end of the shelving", 0.3)
