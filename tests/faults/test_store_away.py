"""The store goes away, the service is killed, stopped, started twice, its clock is set."""

import asyncio
import os
import random
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from faults.conftest import Extent
from faults.hall import STARTED_S, Count, Hall, Outcome, SteppedClock, lock_store
from patience import patience
from postgresql import running_postgresql
from processes import hasty, wait_until

from service.app.one_process import serve_in_one_process
from service.clock import ProcessClock
from service.site.settings import load_settings
from service.store.opening import FILE_NAME

pytestmark = [pytest.mark.wires, pytest.mark.timeout(0), pytest.mark.endurance]

Tell = Callable[[Outcome], None]
KILLED_AFTER_S = (0.2, 1.5)


def survive(
    hall: Hall,
    fault: str,
    go_away: Callable[[], None],
    come_back: Callable[[], None],
    extent: Extent,
) -> Outcome:
    """Take the store away; polling, twin and pushes go on, nothing is lost, not even once."""
    hall.begin()
    go_away()
    began = time.monotonic()
    wait_until(lambda: hall.checks()["store"] == "degraded", 60, "readiness names the store")
    wait_until(lambda: hall.metrics()["spool_bytes"] > 0, 60, "the spool takes samples")
    pushed = len(hall.pusher.acknowledged)
    wait_until(lambda: len(hall.pusher.acknowledged) > pushed + 2, 60, "pushes in the outage")
    time.sleep(max(0.0, began + extent.outage_s - time.monotonic()))
    checks = hall.checks()
    assert {checks["source:pt100"], checks["source:drive"], checks["twin:bench-1"]} == {"ok"}
    come_back()
    back_s = hall.recover()
    count = sum(hall.counts().values(), Count())
    counts = hall.metrics()
    assert counts["samples_skipped_total"] == 0
    assert counts["samples_accepted_total"] == (
        counts["samples_stored_total"] + counts["samples_duplicate_total"] + counts["spool_samples"]
    )
    assert (count.missing, count.duplicates, count.in_order) == (0, 0, True)
    return Outcome(fault, count, 0, [back_s])


def test_a_postgresql_server_is_stopped_and_started_again(
    tmp_path: Path, extent: Extent, tell: Tell
) -> None:
    with running_postgresql() as server:
        url = server.database()
        with Hall(tmp_path, f'database_url = "{url}"').running() as hall:
            tell(survive(hall, "PostgreSQL stopped", server.stop, server.start, extent))


def test_another_program_locks_the_store(hall: Hall, extent: Extent, tell: Tell) -> None:
    release: list[Callable[[], None]] = []
    tell(
        survive(
            hall,
            "store locked by another program",
            lambda: release.append(lock_store(hall.folder / "data" / FILE_NAME)),
            lambda: release.pop()(),
            extent,
        )
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


def test_the_disk_of_the_store_is_full(tmp_path: Path, extent: Extent, tell: Tell) -> None:
    disk = tmp_path / "disk"
    filler = disk / "filler"

    def fill() -> None:
        with filler.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(4096))

    with small_disk(disk, 64):
        # The spool lies on another disk.
        keys = f'database_url = "sqlite:///{disk / FILE_NAME}"'
        with Hall(tmp_path, keys).running() as hall:
            tell(survive(hall, "disk of the store full", fill, filler.unlink, extent))


def test_a_second_service_on_the_same_data_is_refused(hall: Hall, tell: Tell) -> None:
    hall.begin()
    second = subprocess.run(
        hasty("serve", "-c", str(hall.configuration)),
        capture_output=True,
        text=True,
        timeout=patience(120),
        check=False,
    )
    assert second.returncode == os.EX_TEMPFAIL
    assert "another service is running" in second.stderr.splitlines()[-1]
    back_s = hall.recover()
    count = sum(hall.counts().values(), Count())
    assert (count.missing, count.duplicates, count.in_order) == (0, 0, True)
    tell(Outcome("a second service on the same data", count, 0, [back_s]))


def test_kill_9_at_random_moments_costs_nothing_that_was_acknowledged(
    hall: Hall, extent: Extent, tell: Tell
) -> None:
    moment = random.Random(5)
    hall.begin()
    recoveries_s = []
    for _ in range(extent.kills):
        time.sleep(moment.uniform(*KILLED_AFTER_S))
        assert hall.service is not None
        hall.service.kill()
        began = time.monotonic()
        hall.start_service()
        wait_until(hall.is_well, STARTED_S, "all is well after a kill")
        recoveries_s.append(time.monotonic() - began)
    assert hall.pusher.refused > 0
    counts = hall.counts()
    total = sum(counts.values(), Count())
    tell(Outcome(f"kill -9 of the service, {extent.kills} times", total, 0, recoveries_s))
    assert counts["push"].missing == 0, "what was acknowledged is stored"
    assert total.duplicates == 0
    assert total.in_order


def test_sigterm_under_load_stores_all_that_was_accepted(hall: Hall, tell: Tell) -> None:
    hall.begin()
    assert hall.service is not None
    time.sleep(1.0)
    assert hall.service.terminate() == 0
    hall.start_service()
    began = time.monotonic()
    wait_until(hall.is_well, STARTED_S, "all is well after a stop")
    counts = hall.counts()
    total = sum(counts.values(), Count())
    tell(Outcome("SIGTERM under load", total, 0, [time.monotonic() - began]))
    assert counts["push"].missing == 0
    assert total.duplicates == 0
    assert total.in_order


# ------------------------------------------------------------------ the process clock is set


class ServiceInside:
    """A service in this process, so that its clock can be injected; wires are real."""

    def __init__(self, configuration: Path) -> None:
        self._settings = load_settings(configuration)
        self._loop = asyncio.new_event_loop()
        self._stop, self._ready = asyncio.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),))
        self._thread.start()
        assert self._ready.wait(STARTED_S)

    async def _run(self) -> None:
        await serve_in_one_process(
            self._settings, announce=lambda _: self._ready.set(), stop=self._stop
        )

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30)
        assert not self._thread.is_alive()
        self._loop.close()


def test_the_process_clock_is_set_forward_and_back(
    tmp_path: Path, tell: Tell, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SteppedClock()
    monkeypatch.setattr(ProcessClock, "resume", lambda rate, data_dir: clock)
    hall = Hall(tmp_path, now_s=lambda: clock.now_us() / 1e6)
    hall.start_service = lambda: setattr(hall, "service", ServiceInside(hall.configuration))
    recoveries_s = []
    steps = (3600, -3600, 0)
    with hall.running():
        hall.begin()
        for step_s in steps:
            clock.step_us = step_s * 1_000_000
            time.sleep(2.5)  # the service looks at its clock once per second
            recoveries_s.append(hall.recover())
        counted = hall.metrics()["clock_steps_total"]
        counts = hall.counts()
    total = sum(counts.values(), Count())
    # Times follow the clock, so each stretch between two settings is in order by itself.
    total.in_order = hall.stretches_in_order()
    tell(Outcome("process clock set +1 h, -2 h, +1 h", total, 0, recoveries_s))
    assert counted == len(steps)
    assert (total.missing, total.duplicates, total.in_order) == (0, 0, True)
