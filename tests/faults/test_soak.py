"""A bench sixty times as fast as life, and one random fault after another."""

import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx2
import pytest
from faults.hall import PUSHED, STARTED_S, Count, Outcome, Peer, Pusher, lock_store
from processes import Site, free_port, wait_until

from service.clock import ProcessClock
from service.demo.configuration import ASSET
from service.store.opening import FILE_NAME
from service.store.records import StoredSample

pytestmark = [
    pytest.mark.wires,
    pytest.mark.timeout(0),  # as long as it is asked for
    pytest.mark.endurance,
]

RATE = 60.0
TWIN = "t_inner_ring_c.twin"
POLLED, HEARD = "t_inner_ring_c", "speed_rpm"
HOLE_WALL_S = 4.0
"""So long may pass between two samples without a fault on a machine that is busy otherwise."""


class Soak:
    """Bench, cables, service and gateway, and what was done to them."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.random = random.Random(seed)
        self.site = Site(folder, "durability", RATE, seed=seed, pushed=PUSHED)
        self.cables = {}
        text = self.site.configuration.read_text()
        for name, port in (("Modbus", self.site.modbus_port), ("CAN", self.site.can_port)):
            own = free_port()
            assert str(port) in text
            text = text.replace(str(port), str(own))
            self.cables[name] = Peer("cable", own, str(port))
        self.site.configuration.write_text(text)
        self.clock = ProcessClock.resume(RATE, folder / "data")
        self.pusher = Pusher(
            f"http://127.0.0.1:{self.site.port}", self.site.key, lambda: self.clock.now_us() / 1e6
        )
        self.faults: dict[str, Callable[[], None]] = {
            "service killed": self._kill_service,
            "service stopped": self._stop_service,
            "bench killed": self._kill_bench,
            "bench frozen": self._freeze_bench,
            "Modbus cable pulled": lambda: self._pull("Modbus"),
            "CAN cable pulled": lambda: self._pull("CAN"),
            "store locked": self._lock_store,
        }
        self.done: Counter[str] = Counter()
        self.away_us: list[tuple[int, int]] = []
        self.recoveries_s: list[float] = []
        self.slow: list[str] = []

    def start(self) -> None:
        self.site.start_bench()
        for cable in self.cables.values():
            cable.start()
        self.site.start_service()

    def close(self) -> None:
        self.site.close()
        for cable in self.cables.values():
            cable.kill()

    # ------------------------------------------------------------------ faults
    def _kill_service(self) -> None:
        assert self.site.service is not None
        self.site.service.kill()
        self.site.start_service()

    def _stop_service(self) -> None:
        assert self.site.service is not None
        assert self.site.service.terminate() == 0
        self.site.start_service()

    def _kill_bench(self) -> None:
        assert self.site.bench is not None
        self.site.bench.kill()
        time.sleep(self.random.uniform(0.5, 8.0))
        self.site.start_bench()

    def _freeze_bench(self) -> None:
        assert self.site.bench is not None
        self.site.bench.process.send_signal(signal.SIGSTOP)
        time.sleep(self.random.uniform(1.0, 10.0))
        self.site.bench.process.send_signal(signal.SIGCONT)

    def _pull(self, cable: str) -> None:
        self.cables[cable].kill()
        time.sleep(self.random.uniform(1.0, 15.0))
        self.cables[cable].start()

    def _lock_store(self) -> None:
        release = lock_store(self.folder / "data" / FILE_NAME)
        time.sleep(self.random.uniform(1.0, 20.0))
        release()

    def strike(self) -> None:
        """Let the machine run for a while, do something to it, and wait until all is well."""
        time.sleep(self.random.uniform(2.0, 12.0))
        self.look_at_counts()
        name = self.random.choice(list(self.faults))
        began_us = self.clock.now_us()
        self.faults[name]()
        gone_s = time.monotonic()
        try:
            wait_until(self.is_well, STARTED_S, f"all is well after: {name}")
        except AssertionError as error:
            raise AssertionError(f"{error}; {self._state()}") from error
        self.recoveries_s.append(time.monotonic() - gone_s)
        if self.recoveries_s[-1] > 10.0:
            self.slow.append(f"{name} {self.recoveries_s[-1]:.1f} s")
        self.away_us.append((began_us, self.clock.now_us()))
        self.done[name] += 1

    # ------------------------------------------------------------------ looking
    def _state(self) -> Any:
        with suppress(httpx2.TransportError):
            return self.site.client.get("/readyz").json()["checks"]
        return "the service does not answer"

    def is_well(self) -> bool:
        try:
            if self.site.client.get("/readyz").json()["status"] != "ready":
                return False
            before, acknowledged = self.site.tags(), len(self.pusher.acknowledged)
            if before[TWIN]["value"] is None:
                return False
            wait_until(
                lambda: (
                    all(
                        now[name]["time"] > before[name]["time"] and now[name]["quality"] >= 192
                        for now in [self.site.tags()]
                        for name in (POLLED, HEARD, TWIN)
                    )
                    and len(self.pusher.acknowledged) > acknowledged
                ),
                5,
                "new samples",
            )
        except (httpx2.TransportError, AssertionError):
            return False
        return True

    def look_at_counts(self) -> None:
        """Whatever a service has accepted in its life so far is somewhere."""
        found: dict[str, float] = {}
        for line in self.site.client.get("/metrics").text.splitlines():
            if line.startswith(("bearing_twin_samples_", "bearing_twin_spool_samples")):
                name, value = line.rsplit(" ", 1)
                name = name.partition("{")[0].removeprefix("bearing_twin_")
                found[name] = found.get(name, 0.0) + float(value)
        assert found["samples_accepted_total"] == (
            found["samples_stored_total"]
            + found["samples_duplicate_total"]
            + found["samples_skipped_total"]
            + found["spool_samples"]
        )
        assert found["samples_skipped_total"] == 0

    def stored(self, channel: str) -> list[StoredSample]:
        with self.site.open_store() as store:
            return store.samples.read(ASSET, [channel], 0, 2**62, 10**8)

    def unexplained_holes(self, channel: str) -> list[tuple[float, float]]:
        """Spans without a sample, in wall seconds from the start, that no fault explains."""
        times = [one.time_us for one in self.stored(channel)]
        margin_us = int(2e6 * RATE)
        return [
            ((a - times[0]) / 1e6 / RATE, (b - a) / 1e6 / RATE)
            for a, b in pairwise(times)
            if b - a > HOLE_WALL_S * 1e6 * RATE
            and not any(x - margin_us <= b and a <= y + margin_us for x, y in self.away_us)
        ]


def test_an_hour_of_random_faults_loses_nothing(
    tmp_path: Path, pytestconfig: pytest.Config, tell: Callable[[Outcome], None]
) -> None:
    soak = Soak(tmp_path, seed=20261121)
    minutes = float(pytestconfig.getoption("--soak-minutes"))
    try:
        soak.start()
        with soak.pusher:
            wait_until(soak.is_well, STARTED_S, "a running twin")
            end = time.monotonic() + 60.0 * minutes
            while time.monotonic() < end:
                soak.strike()
            soak.look_at_counts()
        assert soak.site.service is not None
        assert soak.site.service.terminate() == 0
    finally:
        soak.close()
    times = [one.time_us // 1000 for one in soak.stored(PUSHED) if one.value is not None]
    acknowledged = soak.pusher.acknowledged
    stored = set(times) & set(acknowledged)
    count = Count(
        sent=len(acknowledged),
        stored=len(stored),
        duplicates=len(times) - len(set(times)),
        missing=len(set(acknowledged) - stored),
        in_order=times == sorted(times),
    )
    wires = {channel: soak.stored(channel) for channel in (POLLED, HEARD)}
    holes = {channel: soak.unexplained_holes(channel) for channel in wires}
    kinds = ", ".join(f"{name} {times} times" for name, times in sorted(soak.done.items()))
    late = f"; later than 10 s: {', '.join(soak.slow)}" if soak.slow else ""
    read = ", ".join(f"{len(rows):,} of {channel}" for channel, rows in wires.items())
    tell(
        Outcome(
            f"{minutes:g} min at {RATE:g} times the speed, {soak.done.total()} random faults",
            count,
            recoveries_s=soak.recoveries_s,
            note=f"{kinds}{late}. From the wires: {read}; holes that no fault explains: "
            f"{sum(map(len, holes.values()))}",
        )
    )
    assert count.missing == count.duplicates == 0
    assert count.in_order
    assert len(times) - len(acknowledged) <= 5, "at most the last push was not acknowledged"
    assert holes == {POLLED: [], HEARD: []}
    for rows in wires.values():
        stamps = [one.time_us for one in rows]
        assert stamps == sorted(set(stamps)), "each once, in order"
        assert all((one.value is None) == (one.quality < 64) for one in rows)
