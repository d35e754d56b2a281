"""The store goes away in the middle of a run, and the service is killed: nothing is lost."""

import random
import sqlite3
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import httpx2
import pytest
from postgresql import running_postgresql
from processes import Site, wait_until

from service.demo.configuration import ASSET
from service.store.opening import FILE_NAME

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

RATE = 10.0
PUSHED = "t_node_1_c"
MEASURED = "t_inner_ring_c"
BACK_S = 10.0
"""Wall seconds in which all is well again once the cause has gone; a busy machine has more."""


class Pusher:
    """Pushes samples one after another and counts, outside the service, what it acknowledged."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.acknowledged: list[int] = []
        self.refused = 0
        self._number = 0
        self._began = datetime.now(UTC).replace(microsecond=0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Pusher":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        with httpx2.Client(
            base_url=self.site.client.base_url, headers={"X-API-Key": self.site.key}, timeout=30
        ) as client:
            while not self._stop.wait(0.02):
                time_ms = self._number
                moment = self._began + timedelta(milliseconds=time_ms)
                body = {
                    "samples": [
                        {
                            "channel": PUSHED,
                            "time": moment.isoformat(timespec="milliseconds"),
                            "value": 20.0 + time_ms % 50 / 10,
                        }
                    ]
                }
                try:
                    answer = client.post(f"/api/v1/assets/{ASSET}/measurements", json=body)
                except httpx2.TransportError:
                    self.refused += 1  # it may have been stored: the same is sent again
                    continue
                if answer.status_code == httpx2.codes.OK:
                    assert answer.json()["rejected"] == []
                    self.acknowledged.append(round(moment.timestamp() * 1000))
                    self._number += 1
                else:
                    self.refused += 1


def pushed_times_ms(site: Site) -> list[int]:
    with site.open_store() as store:
        return [one.time_us // 1000 for one in store.read_samples(ASSET, [PUSHED], 0, 2**62, 10**6)]


def metrics(site: Site) -> dict[str, float]:
    lines = site.client.get("/metrics").text.splitlines()
    found: dict[str, float] = {}
    for line in lines:
        if line.startswith("bearing_twin_s"):
            name, value = line.rsplit(" ", 1)
            name = name.partition("{")[0].removeprefix("bearing_twin_")
            found[name] = found.get(name, 0.0) + float(value)
    return found


def store_status(site: Site) -> str:
    checks = site.client.get("/readyz").json()["checks"]
    return next(str(one["status"]) for one in checks if one["name"] == "store")


def spool_is_empty(site: Site) -> bool:
    return metrics(site)["spool_bytes"] == 0


@contextmanager
def running(site: Site) -> Iterator[Pusher]:
    try:
        site.start_bench()
        site.start_service()
        wait_until(lambda: site.tag("t_node_7_c.twin"), 30, "a running twin")
        with Pusher(site) as pusher:
            wait_until(lambda: len(pusher.acknowledged) > 20, 20, "pushes")
            yield pusher
    finally:
        site.close()


def survive(site: Site, go_away: Callable[[], None], come_back: Callable[[], None]) -> None:
    """Take the store away for some seconds; polling, twin and pushes go on, nothing is lost."""
    with running(site) as pusher:
        go_away()
        gone = time.monotonic()
        wait_until(lambda: store_status(site) == "degraded", 20, "the outage is noticed")
        wait_until(lambda: metrics(site)["spool_bytes"] > 0, 20, "the spool takes samples")
        pushed = len(pusher.acknowledged)
        twin_time = site.tags()["t_node_7_c.twin"]["time"]
        wait_until(lambda: len(pusher.acknowledged) > pushed + 2, 30, "pushes during the outage")
        time.sleep(max(0.0, gone + 6 - time.monotonic()))
        tags = site.tags()
        assert tags["t_node_7_c.twin"]["time"] > twin_time, "the twin goes on"
        assert tags[MEASURED]["quality"] >= 192, "polling goes on"
        come_back()
        back = time.monotonic()
        wait_until(lambda: store_status(site) == "ok", 3 * BACK_S, "the store is back")
        wait_until(lambda: spool_is_empty(site), 3 * BACK_S, "the spool is empty")
        assert time.monotonic() - back < 3 * BACK_S
        pushed = len(pusher.acknowledged)
        wait_until(lambda: len(pusher.acknowledged) > pushed, 20, "pushes after the outage")
        counts = metrics(site)
    assert counts["samples_skipped_total"] == 0
    assert counts["samples_accepted_total"] == pytest.approx(
        counts["samples_stored_total"]
        + counts["samples_duplicate_total"]
        + counts["spool_samples"],
    )
    assert pushed_times_ms(site) == pusher.acknowledged, "each once, in order"
    with site.open_store() as store:
        times = [one.time_us for one in store.read_samples(ASSET, [MEASURED], 0, 2**62, 10**6)]
    # One poll per process second, also while the store was away.
    longest_s = max(b - a for a, b in pairwise(times)) / 1e6
    assert longest_s < 3 * RATE, "no hole where the store was away"


def test_a_postgresql_server_is_stopped_and_started_again(tmp_path: Path) -> None:
    with running_postgresql() as server:
        url = server.database()
        site = Site(
            tmp_path, "staircase", RATE, service_keys=f'database_url = "{url}"', pushed=PUSHED
        )
        survive(site, server.stop, server.start)


def test_another_program_locks_the_store(tmp_path: Path) -> None:
    site = Site(tmp_path, "staircase", RATE, pushed=PUSHED)
    with closing(
        sqlite3.connect(
            tmp_path / "data" / FILE_NAME, isolation_level=None, check_same_thread=False
        )
    ) as intruder:
        survive(
            site,
            lambda: intruder.execute("BEGIN EXCLUSIVE") and None,
            lambda: intruder.execute("ROLLBACK") and None,
        )


@contextmanager
def small_disk(folder: Path, mib: int) -> Iterator[None]:
    """Mount a file system of its own, as only root may."""
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={mib}m", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    if mount.returncode != 0:
        pytest.skip(f"no right to mount a small disk: {mount.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_the_disk_of_the_store_is_full(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    filler = disk / "filler"
    with small_disk(disk, 64):
        site = Site(
            tmp_path,
            "staircase",
            RATE,
            # The spool lies on another disk.
            service_keys=f'database_url = "sqlite:///{disk / FILE_NAME}"',
            pushed=PUSHED,
        )

        def fill() -> None:
            with filler.open("wb", buffering=0) as file, suppress(OSError):
                while True:
                    file.write(bytes(4096))

        survive(site, fill, filler.unlink)


def test_kill_9_at_random_moments_costs_nothing_that_was_acknowledged(tmp_path: Path) -> None:
    site = Site(tmp_path, "staircase", RATE, pushed=PUSHED)
    moment = random.Random(5)
    with running(site) as pusher:
        for _ in range(4):
            wait_until(lambda: site.tags()["t_node_7_c.twin"]["quality"] >= 192, 30, "the twin")
            time.sleep(moment.uniform(0.2, 1.5))
            assert site.service is not None
            site.service.kill()
            site.start_service()
        wait_until(lambda: site.tags()["t_node_7_c.twin"]["quality"] >= 192, 30, "the twin")
        pushed = len(pusher.acknowledged)
        wait_until(lambda: len(pusher.acknowledged) > pushed, 20, "pushes at the end")
    assert pusher.refused > 0
    times = pushed_times_ms(site)
    assert len(times) == len(set(times))
    assert set(pusher.acknowledged) <= set(times)
    assert len(times) <= len(pusher.acknowledged) + pusher.refused


def test_sigterm_under_load_stores_all_that_was_accepted(tmp_path: Path) -> None:
    site = Site(tmp_path, "staircase", RATE, pushed=PUSHED)
    with running(site) as pusher:
        assert site.service is not None
        assert site.service.terminate() == 0
    assert set(pusher.acknowledged) <= set(pushed_times_ms(site))
