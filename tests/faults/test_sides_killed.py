"""Web and plant side killed again and again under load: nothing is lost, nothing comes late."""

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx2
import pytest
from asyncua import Client
from patience import patience
from processes import wait_until
from security.stand import Stand

from bearing_twin_laboratory.benchmarks.attackers import ASSET, PUSHED, PUSHED_ASSET

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900), pytest.mark.endurance]

#: A longer run: ``BEARING_TWIN_KILLS=50 pytest -s tests/faults/test_sides_killed.py``.
KILLS = int(os.environ.get("BEARING_TWIN_KILLS", "4"))
PATIENCE_S = 60.0
BETWEEN_KILLS_S = 1.0
#: Share of the polls that the starts of a side may cost, beyond what the machine loses without.
SHARE = 0.05
_SAMPLES = 20


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    with Stand(tmp_path_factory.mktemp("stand")).running() as stand:
        yield stand


class Gateway:
    """Pushes samples without a pause, each batch until it is accepted."""

    def __init__(self, stand: Stand) -> None:
        self.accepted: list[datetime] = []
        self.tries = 0
        self._url = f"http://127.0.0.1:{stand.port}/api/v1/assets/{PUSHED_ASSET}/measurements"
        self._headers = {"X-API-Key": stand.key_of("gateway")}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._push)

    def __enter__(self) -> "Gateway":
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _push(self) -> None:
        while not self._stop.is_set():
            now = datetime.now(UTC)
            times = [now + timedelta(milliseconds=number) for number in range(_SAMPLES)]
            samples = [{"channel": PUSHED[0], "time": t.isoformat(), "value": 60.0} for t in times]
            while not self._try({"samples": samples}):
                time.sleep(0.02)
            self.accepted += times
            time.sleep(0.05)

    def _try(self, body: Any) -> bool:
        self.tries += 1
        try:
            answer = httpx2.post(self._url, json=body, headers=self._headers, timeout=patience(10))
        except httpx2.TransportError:
            return False
        return answer.status_code == httpx2.codes.OK


def killed(stand: Stand, side: str, answers: Callable[[], bool]) -> list[float]:
    """Kill a side again and again; wall seconds until it answers after each."""
    assert stand.service is not None
    took_s = []
    for _ in range(KILLS):
        os.kill(stand.service.side(side), signal.SIGKILL)
        began_s = time.monotonic()
        wait_until(answers, PATIENCE_S, f"an answer of the {side} side", every_s=0.02)
        took_s.append(time.monotonic() - began_s)
        time.sleep(BETWEEN_KILLS_S)
    print(f"\n{side} side killed {KILLS} times, answers after {sorted(took_s)} s")  # noqa: T201
    return took_s


def skipped_while(stand: Stand, work: Callable[[], object]) -> float:
    """Share of the polls that are skipped while something goes on, beyond those without it."""
    polls, began_s = stand.state.sent, time.monotonic()
    work()
    elapsed_s = time.monotonic() - began_s
    skipped = max(1.0 - (stand.state.sent - polls) / (10.0 * elapsed_s), 0.0)
    if skipped >= SHARE:
        skipped -= stand.watch(elapsed_s).skipped
    print(f"polls skipped: {skipped:.1%} of {elapsed_s:.0f} s")  # noqa: T201
    return skipped


def test_a_killed_web_side_loses_no_sample_and_costs_no_poll(stand: Stand) -> None:
    assert stand.service is not None
    cell = stand.service.side("cell")

    def answers() -> bool:
        url = f"http://127.0.0.1:{stand.port}/api/v1/assets/{ASSET}/snapshot"
        try:
            answer = httpx2.get(
                url, headers={"X-API-Key": stand.key_of("viewer")}, timeout=patience(10)
            )
        except httpx2.TransportError:
            return False
        return answer.status_code == httpx2.codes.OK

    with Gateway(stand) as gateway:
        assert skipped_while(stand, lambda: killed(stand, "web", answers)) < SHARE
    assert stand.service.side("cell") == cell
    first = min(gateway.accepted)
    stored: list[datetime] = []
    cursor: dict[str, str] = {}
    while cursor or not stored:
        page = stand.get(
            f"/api/v1/assets/{PUSHED_ASSET}/measurements",
            channel=PUSHED[0],
            start=first.isoformat(),
            limit=10_000,
            **cursor,
        )
        stored += [datetime.fromisoformat(row["time"]) for row in page["items"]]
        cursor = {"cursor": page["next"]} if page["next"] else {}
    assert sorted(stored) == sorted(gateway.accepted)
    assert gateway.tries > len(gateway.accepted) / _SAMPLES  # some did meet a dead web side


def test_a_killed_plant_side_serves_its_clients_again_and_costs_no_poll(stand: Stand) -> None:
    endpoint = f"opc.tcp://127.0.0.1:{stand.opcua_port}/"

    async def connect() -> None:
        client = Client(endpoint, timeout=patience(5))
        client.set_user("key")
        client.set_password(stand.key_of("viewer"))
        async with client:
            await client.nodes.server_state.read_value()

    def answers() -> bool:
        try:
            asyncio.run(connect())
        except (OSError, TimeoutError):
            return False
        return True

    assert answers()
    assert skipped_while(stand, lambda: killed(stand, "plant", answers)) < SHARE


def test_the_sides_of_a_killed_supervisor_end_and_leave_the_data_to_the_next(stand: Stand) -> None:
    """It comes last: the others need the service."""
    service = stand.service
    assert service is not None
    os.kill(service.process.pid, signal.SIGKILL)
    service.process.wait(PATIENCE_S)
    wait_until(lambda: not service.processes(), PATIENCE_S, "the end of all its processes")
    service.end()
    polls = stand.state.sent
    stand.start_service()
    wait_until(lambda: stand.state.sent > polls, PATIENCE_S, "a poll by the next one")
