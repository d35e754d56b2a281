"""A database server that hangs: it keeps its connections and answers nothing."""

import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest
from faults.hall import PATIENCE, STARTED_S, Count, Hall
from patience import patience
from postgresql import PostgreSQL, running_postgresql
from processes import wait_until

pytestmark = [pytest.mark.wires, pytest.mark.timeout(0), pytest.mark.endurance]
PATIENCE_S = 120.0


def assert_nothing_is_lost_or_doubled(hall: Hall) -> None:
    counts = hall.counts()
    assert counts["push"].missing == 0, "what was acknowledged is stored"
    total = sum(counts.values(), Count())
    assert (total.duplicates, total.in_order) == (0, True)


def push_once(hall: Hall) -> float:
    """Wall seconds until the gateway's next push is acknowledged."""
    began, before = time.monotonic(), len(hall.pusher.acknowledged)
    wait_until(lambda: len(hall.pusher.acknowledged) > before, PATIENCE_S, "acknowledged", 0.01)
    return time.monotonic() - began


@pytest.fixture(scope="module")
def server() -> Iterator[PostgreSQL]:
    with running_postgresql() as server:
        yield server


def test_pushes_probes_and_the_twin_go_on_and_nothing_is_lost(
    tmp_path: Path, server: PostgreSQL
) -> None:
    with Hall(tmp_path, f'database_url = "{server.database()}"').running() as hall:
        hall.begin()
        hall.get("/api/v1/assets/bench-1/snapshot")  # the key is known from here on
        with server.frozen():
            first_s = push_once(hall)
            pushes_s = [push_once(hall) for _ in range(20)]
            answer = httpx2.get(f"{hall.client.base_url}/readyz", timeout=patience(20))
            assert answer.json()["status"] == "degraded"
            wait_until(lambda: hall.metrics()["spool_bytes"] > 0, PATIENCE_S, "on the spool")
            before = hall.tag("t_inner_ring_c"), hall.tags()["t_inner_ring_c"]["time"]
            wait_until(
                lambda: hall.tags()["t_inner_ring_c"]["time"] > before[1], PATIENCE_S, "it acquires"
            )
            waiting = hall.metrics()
            assert waiting["queue_samples"] < waiting["spool_samples"], "on the disk, not in memory"
        hall.recover()
        assert hall.metrics()["samples_skipped_total"] == 0
        assert_nothing_is_lost_or_doubled(hall)
        # The first waits for the store's limit; all others find the spool.
        assert sorted(pushes_s)[len(pushes_s) // 2] < first_s + 1.0


def test_sigterm_while_it_hangs_keeps_what_was_accepted(tmp_path: Path, server: PostgreSQL) -> None:
    with Hall(tmp_path, f'database_url = "{server.database()}"').running() as hall:
        hall.begin()
        assert hall.service is not None
        with server.frozen():
            time.sleep(2.0)  # a statement hangs, samples wait behind it
            began = time.monotonic()
            assert hall.service.terminate() == 0
            # Ten seconds on a machine that has nothing else to do.
            assert time.monotonic() - began < PATIENCE * 10.0
        hall.start_service()
        wait_until(hall.is_well, STARTED_S, "all is well after the start")
        assert_nothing_is_lost_or_doubled(hall)
        assert '"event": "samples_lost"' not in hall.service.log.read_text()


def test_killed_while_it_hangs_costs_nothing_that_was_acknowledged(
    tmp_path: Path, server: PostgreSQL
) -> None:
    with Hall(tmp_path, f'database_url = "{server.database()}"').running() as hall:
        hall.begin()
        assert hall.service is not None
        with server.frozen():
            for _ in range(5):
                push_once(hall)
            hall.service.kill()
        hall.start_service()
        wait_until(hall.is_well, STARTED_S, "all is well after the start")
        assert_nothing_is_lost_or_doubled(hall)
