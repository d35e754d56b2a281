"""A service that polls a device ten times a second, and the device's own count of the polls."""

import contextlib
import http.client
import json
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx2
from faults.hall import Peer
from faults.peers import State
from patience import patience
from processes import Station, free_port, wait_until
from site_files import OBSERVE, asset_text, write_site

from adapters.samples import Sample
from bearing_twin_laboratory.benchmarks.attackers import (
    ASSET,
    OPCUA_PORT,
    PUSHED,
    PUSHED_ASSET,
    begin_attack,
)
from service.domain.roles import Role

POLLS_PER_S = 10.0
STARTED_S = 180.0
ROWS_PER_CHANNEL = 30_000
#: Open files that the service may have; what systemd and Docker give where nothing is set.
FILES = 1024

_OPCUA = """\
[opcua]
enabled = true
endpoint = "opc.tcp://127.0.0.1:{opcua_port}/"

[[sources]]
name = "plc"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {modbus_port}
poll_interval_s = 0.1
timeout_s = 2.0
"""
_CHANNELS = """\
speed_rpm = { source = "plc", register = 0, kind = "input", scale = 2.5 }
t_inner_ring_c = { source = "plc", register = 0, kind = "input", scale = 0.1 }
t_outer_ring_c = { source = "plc", register = 1, kind = "input", scale = 0.1 }
ambient_c = { source = "plc", register = 2, kind = "input", scale = 0.1 }
load_n = { source = "plc", register = 4, kind = "input", type = "uint32", scale = 0.001, \
offset = 3000 }
"""


@dataclass
class Course:
    """What became of acquisition while something went on, and how the service answered others."""

    polls: int
    seconds: float
    livez_s: list[float] = field(default_factory=list)
    rss_mib: float = 0.0
    answers: dict[str, int] = field(default_factory=dict)

    @property
    def skipped(self) -> float:
        """Share of the polls that were due and did not come."""
        return max(1.0 - self.polls / (POLLS_PER_S * self.seconds), 0.0)

    def __str__(self) -> str:
        livez = sorted(self.livez_s) or [float("nan")]
        return (
            f"polls {self.polls} in {self.seconds:.1f} s, skipped {self.skipped:.1%}, "
            f"/livez p50 {1000 * livez[len(livez) // 2]:.0f} ms max {1000 * livez[-1]:.0f} ms, "
            f"rss {self.rss_mib:.0f} MiB, "
            f"{self.answers}"
        )


def metric_in(text: str, name: str) -> float:
    """A metric by its name and labels, as Prometheus writes them."""
    start = f"bearing_twin_{name} "
    return next(float(line[len(start) :]) for line in text.splitlines() if line.startswith(start))


class Stand(Station):
    """The service, its device, and whoever disturbs."""

    def __init__(self, folder: Path) -> None:
        modbus_port, self.opcua_port = free_port(), free_port()
        text = _OPCUA.format(opcua_port=self.opcua_port, modbus_port=modbus_port)
        text += asset_text(ASSET, _CHANNELS, OBSERVE)
        text += asset_text(PUSHED_ASSET, PUSHED, OBSERVE)
        super().__init__(folder, *write_site(folder, text))
        self.state = State(folder / "modbus")
        self.device = Peer("modbus", modbus_port, str(folder / "modbus"))

    def close(self) -> None:
        super().close()
        self.device.kill()

    @contextmanager
    def running(self) -> Iterator["Stand"]:
        try:
            with self.open_store() as store:
                now_us = time.time_ns() // 1000
                for name in PUSHED:
                    store.samples.write(
                        [
                            Sample(PUSHED_ASSET, name, now_us - 40_000 * number, 60.0, 192, now_us)
                            for number in range(1, ROWS_PER_CHANNEL)
                        ]
                    )
            self.device.start()
            self.start_service("prlimit", f"--nofile={FILES}:{FILES}")
            wait_until(self._forecasts, STARTED_S, "a live forecast")
            yield self
        finally:
            self.close()

    def _forecasts(self) -> bool:
        try:
            return (
                self.client.get(f"/api/v1/assets/{ASSET}/forecast").status_code == httpx2.codes.OK
            )
        except httpx2.TransportError:
            return False

    # ------------------------------------------------------------------ watching
    def watch(self, seconds: float) -> Course:
        """Watch for so long how acquisition goes and how other callers are answered."""
        livez_s: list[float] = []
        rss: list[float] = [0.0]
        stop = threading.Event()

        def probe() -> None:
            while not stop.wait(0.2):
                began_s = time.monotonic()
                try:
                    self._get("/livez")
                except (OSError, http.client.HTTPException):
                    livez_s.append(99.0)
                else:
                    livez_s.append(time.monotonic() - began_s)
                rss.append(self._rss_mib())

        thread = threading.Thread(target=probe)
        thread.start()
        polls, began_s = self.state.sent, time.monotonic()
        time.sleep(seconds)
        polls, elapsed_s = self.state.sent - polls, time.monotonic() - began_s
        stop.set()
        thread.join()
        return Course(polls, elapsed_s, livez_s, max(rss))

    def attacked(self, name: str, role: Role, seconds: float) -> Course:
        """Watch while an attack goes on."""
        with self.attack(name, role, seconds) as attacker:
            assert attacker.stdout is not None
            assert attacker.stdout.readline() == "attacking\n"
            course = self.watch(seconds)
            out, _ = attacker.communicate(timeout=60 + seconds)
            assert attacker.returncode == 0, out
            course.answers = json.loads(out)
        return course

    @contextmanager
    def attack(self, name: str, role: Role, seconds: float) -> Iterator["subprocess.Popen[str]"]:
        there = {OPCUA_PORT: str(self.opcua_port)}
        attacker = begin_attack(name, self.port, self.key_of(role), seconds, there)
        try:
            yield attacker
        finally:
            if attacker.poll() is None:
                attacker.kill()
            attacker.wait()
            if attacker.stdout is not None:
                attacker.stdout.close()

    def _get(self, path: str) -> int:
        """Ask as somebody else does, from another address than any attacker."""
        connection = http.client.HTTPConnection(
            "127.0.0.1", self.port, timeout=patience(10), source_address=("127.0.0.2", 0)
        )
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            answer.read()
            return answer.status
        finally:
            connection.close()

    def _rss_mib(self) -> float:
        """Memory of all processes of the service; what they share counts once."""
        assert self.service is not None
        total_kib = 0
        for pid in self.service.processes():
            with contextlib.suppress(OSError):
                rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
                total_kib += int(rollup.partition("\nPss:")[2].split()[0])
        return total_kib / 1024
