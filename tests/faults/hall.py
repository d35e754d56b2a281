"""A test hall under load: numbered devices, a service, and an outside count of what was sent."""

import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import httpx2
from faults.peers import State
from patience import patience
from processes import Command, Station, free_port, wait_until
from site_files import OBSERVE, asset_text, write_site

from service.clock import ProcessClock
from service.demo.configuration import ASSET

MODBUS, CAN, PUSHED = "load_n", "speed_rpm", "t_node_1_c"
WAYS = {"Modbus": MODBUS, "CAN": CAN, "push": PUSHED}
BASE = 3000.0  # value = BASE + number / 1000
BACK_S = 10.0
"""Wall seconds in which all is well again once the cause has gone."""
STARTED_S = 180.0
PATIENCE = 12.0
"""A machine that other programs keep busy is given so many times that, and the table tells."""

_WIRES = """\
[[sources]]
name = "pt100"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {modbus_port}
poll_interval_s = 0.05
timeout_s = 0.5

[[sources]]
name = "drive"
driver = "can"
interface = "slcan"
channel = "socket://127.0.0.1:{can_port}"
sleep_after_open = 0.1
dbc = "numbers.dbc"
"""
_CHANNELS = f"""\
t_inner_ring_c = {{ source = "pt100", register = 0, kind = "input", scale = 0.1, \
flat_line_s = 2.0 }}
t_outer_ring_c = {{ source = "pt100", register = 1, kind = "input", scale = 0.1 }}
ambient_c = {{ source = "pt100", register = 2, kind = "input", scale = 0.1 }}
{MODBUS} = {{ source = "pt100", register = 4, kind = "input", type = "uint32", scale = 0.001, \
offset = {BASE} }}
{CAN} = {{ source = "drive", message = "Numbers", signal = "Number" }}
{PUSHED} = {{ source = "push" }}
"""
_DBC = """\
VERSION ""
BU_: Peer
BO_ 288 Numbers: 8 Peer
 SG_ Number : 0|32@1+ (0.001,3000) [0|4000000] "rpm" Peer
"""


class SteppedClock(ProcessClock):
    """A system clock that an administrator sets."""

    step_us = 0

    def now_us(self) -> int:
        return super().now_us() + self.step_us


class Peer:
    """A device in a process of its own."""

    def __init__(self, kind: str, port: int, other: str) -> None:
        self._arguments = [kind, str(port), other]
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        script = Path(__file__).with_name("peers.py")
        self.process = subprocess.Popen(
            [sys.executable, str(script), *self._arguments], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "listening\n"

    def send_signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            if self.process.stdout is not None:
                self.process.stdout.close()
            self.process = None


class Pusher:
    """Pushes samples one after another and counts, outside the service, what it acknowledged."""

    def __init__(self, address: str, key: str, now_s: Callable[[], float] = time.time) -> None:
        self._now_s = now_s
        self.acknowledged: list[int] = []  # times in ms
        self.refused = 0
        self._address, self._key = address, key
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Pusher":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        last_ms = 0
        headers = {"X-API-Key": self._key}
        with httpx2.Client(base_url=self._address, headers=headers, timeout=patience(30)) as client:
            while not self._stop.wait(0.02):
                first_ms = round(self._now_s() * 1000)
                if last_ms - 1000 < first_ms <= last_ms:  # else the clock was set back
                    first_ms = last_ms + 1
                times_ms = list(range(first_ms, first_ms + 5))
                last_ms = times_ms[-1]
                if self._send(client, times_ms):
                    self.acknowledged += times_ms

    def _send(self, client: httpx2.Client, times_ms: list[int]) -> bool:
        """Send the same until it is acknowledged, as a gateway would."""
        samples = [
            {
                "channel": PUSHED,
                "time": datetime.fromtimestamp(ms / 1000, UTC).isoformat(timespec="milliseconds"),
                "value": 50.0 + ms % 7 / 10,
            }
            for ms in times_ms
        ]
        while not self._stop.is_set():
            try:
                answer = client.post(
                    f"/api/v1/assets/{ASSET}/measurements", json={"samples": samples}
                )
            except httpx2.TransportError:
                pass  # it may have been stored: the same is sent again
            else:
                if answer.status_code == httpx2.codes.OK:
                    assert answer.json()["rejected"] == []
                    return True
            self.refused += 1
            self._stop.wait(0.05)
        return False


@dataclass
class Count:
    """What became of the samples of one way in, or of all ways together."""

    sent: int = 0
    stored: int = 0
    duplicates: int = 0
    missing: int = 0
    in_order: bool = True

    def __add__(self, other: "Count") -> "Count":
        return Count(
            self.sent + other.sent,
            self.stored + other.stored,
            self.duplicates + other.duplicates,
            self.missing + other.missing,
            self.in_order and other.in_order,
        )


@dataclass
class Outcome:
    """A row of the table of faults."""

    fault: str
    count: Count = field(default_factory=Count)
    skipped: int = 0
    recoveries_s: list[float] = field(default_factory=list)
    note: str = ""


class Hall(Station):
    """Two numbered devices, a gateway that pushes, and the service that takes it all in."""

    def __init__(
        self, folder: Path, service_keys: str = "", now_s: Callable[[], float] = time.time
    ) -> None:
        modbus_port, can_port = free_port(), free_port()
        wires = _WIRES.format(modbus_port=modbus_port, can_port=can_port)
        text = wires + asset_text(ASSET, _CHANNELS, OBSERVE)
        (folder / "numbers.dbc").write_text(_DBC)
        super().__init__(folder, *write_site(folder, text, service_keys))
        self.states = {"modbus": State(folder / "modbus"), "can": State(folder / "can")}
        self.modbus = Peer("modbus", modbus_port, str(folder / "modbus"))
        self.can = Peer("can", can_port, str(folder / "can"))
        self.pusher = Pusher(self.address, self.key, now_s)
        self._began: dict[str, int] = {}

    def close(self) -> None:
        super().close()
        self.modbus.kill()
        self.can.kill()

    @contextmanager
    def running(self) -> Iterator["Hall"]:
        try:
            self.modbus.start()
            self.can.start()
            self.start_service()
            with self.pusher:
                wait_until(self.is_well, STARTED_S, "a running twin, pushes and both wires")
                yield self
        finally:
            self.close()

    # ------------------------------------------------------------------ how it is
    def checks(self) -> dict[str, str]:
        answer = self.client.get("/readyz").json()
        found = {one["name"]: one["status"] for one in answer["checks"]}
        return found | {"all": answer["status"]}

    def details(self) -> dict[str, str]:
        return {one["name"]: one["detail"] for one in self.client.get("/readyz").json()["checks"]}

    def metrics(self) -> dict[str, float]:
        """Sums of the metrics over their labels."""
        found: dict[str, float] = {}
        for line in self.client.get("/metrics").text.splitlines():
            if line.startswith("bearing_twin_"):
                name, value = line.rsplit(" ", 1)
                name = name.partition("{")[0].removeprefix("bearing_twin_")
                found[name] = found.get(name, 0.0) + float(value)
        return found

    def metrics_by_label(self, name: str) -> dict[str, float]:
        """Values of one metric by its labels, as Prometheus writes them."""
        start = f"bearing_twin_{name}{{"
        lines = self.client.get("/metrics").text.splitlines()
        found = (line[len(start) :].split("} ") for line in lines if line.startswith(start))
        return {labels: float(value) for labels, value in found}

    def is_well(self) -> bool:
        """Ready, nothing waits on the disk, and all ways bring new samples to a running twin."""
        try:
            if self.checks()["all"] != "ready" or self.metrics()["spool_bytes"] > 0:
                return False
            before, acknowledged = self.tags(), len(self.pusher.acknowledged)
            twin = "t_node_7_c.twin"
            wait_until(
                lambda: (
                    all(
                        now[name]["time"] > before[name]["time"] and now[name]["quality"] >= 192
                        for now in [self.tags()]
                        for name in (MODBUS, CAN, "t_inner_ring_c")
                    )
                    and before[twin]["value"] is not None
                    and len(self.pusher.acknowledged) > acknowledged
                ),
                5,
                "new samples",
            )
        except (httpx2.TransportError, AssertionError):
            return False
        return True

    # ------------------------------------------------------------------ counting
    def begin(self) -> None:
        """Count from here."""
        self._began = {
            "Modbus": self.states["modbus"].sent,
            "CAN": self.states["can"].sent,
            "push": len(self.pusher.acknowledged),
        }

    def recover(self) -> float:
        """Wait until all is well again; wall seconds that it took."""
        gone = time.monotonic()
        wait_until(self.is_well, PATIENCE * BACK_S, "all is well again")
        return time.monotonic() - gone

    def counts(self) -> Mapping[str, Count]:
        """What was sent since `begin` against what is stored, by way in."""
        sent: dict[str, set[int]] = {
            "Modbus": set(range(self._began["Modbus"] + 1, self.states["modbus"].sent + 1)),
            "CAN": set(range(self._began["CAN"] + 1, self.states["can"].sent + 1)),
            "push": set(self.pusher.acknowledged[self._began["push"] :]),
        }
        time.sleep(1.5)  # a sample waits in memory for half a second
        return {way: self._count(way, numbers) for way, numbers in sent.items()}

    def stretches_in_order(self) -> bool:
        """Whether the numbers ascend between any two leaps of the clock."""
        with self.open_store() as store:
            return all(
                after.value > before.value
                for channel in (MODBUS, CAN)
                for before, after in pairwise(
                    one
                    for one in store.samples.read(ASSET, [channel], 0, 2**62, 10**7)
                    if one.value is not None and one.quality >= 192
                )
                if after.time_us - before.time_us < 1_000_000_000
            )

    def _count(self, way: str, sent: set[int]) -> Count:
        with self.open_store() as store:
            rows = store.samples.read(ASSET, [WAYS[way]], 0, 2**62, 10**7)
        if way == "push":
            numbers = [one.time_us // 1000 for one in rows]
        else:
            numbers = [
                round((one.value - BASE) * 1000)
                for one in rows
                if one.value is not None and one.quality >= 192
            ]
        wanted = [number for number in numbers if number in sent]
        if way != "push":
            assert 0 < min(numbers) <= max(numbers) < 10**8, "nobody ever sent such a number"
        return Count(
            sent=len(sent),
            stored=len(set(wanted)),
            duplicates=len(wanted) - len(set(wanted)),
            missing=len(sent) - len(set(wanted)),
            in_order=wanted == sorted(wanted),
        )


def lock_store(file: Path) -> Callable[[], None]:
    """Take the right to write away from everybody; returns what gives it back."""
    intruder = sqlite3.connect(
        file, isolation_level=None, check_same_thread=False, timeout=patience(30)
    )
    intruder.execute("BEGIN EXCLUSIVE")

    def release() -> None:
        intruder.execute("ROLLBACK")
        intruder.close()

    return release


__all__ = ["Command", "Count", "Hall", "Outcome", "Peer", "lock_store"]
