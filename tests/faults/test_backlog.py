"""Gateways send what they kept for hours, beside one that sends what is measured now."""

import json
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest
from faults.hall import Outcome
from patience import patience
from processes import Station, wait_until
from site_files import CHANNELS, OBSERVE, asset_text, write_site

from service.security.keys import create_key
from service.store.opening import FILE_NAME

pytestmark = [
    pytest.mark.wires,
    pytest.mark.timeout(0),
    pytest.mark.endurance,
    pytest.mark.timing,
]

VALUES = dict(zip(CHANNELS, (1500.0, 2650.0, 23.0, 48.0, 41.0), strict=True))
LIVE = "live"
ASSETS = ("late-1", "late-2", "late-3")
PORTIONS = (20_000, 20_000, *[2500] * 8)
"""Samples of each asset's gateways. All send at once, which is more than one key may do: some are
answered 503."""
CALM_S = 8.0
AGE_RATIO = 6.0
PATIENCE_S = 240.0


class LiveGateway:
    """Sends what is measured now once per second, and looks how old it is where it is shown."""

    def __init__(self, address: str, key: str) -> None:
        self.ages_s: list[float] = []
        self.answered_s: list[float] = []
        self.answers: list[tuple[int, Any]] = []  # by the time of the samples in us
        self._client = httpx2.Client(
            base_url=address, headers={"X-API-Key": key}, timeout=patience(120)
        )
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=work) for work in (self._push, self._look)]

    @contextmanager
    def running(self) -> Iterator["LiveGateway"]:
        for thread in self._threads:
            thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            for thread in self._threads:
                thread.join()
            self._client.close()

    def _push(self) -> None:
        due_s = time.monotonic()
        while not self._stop.wait(max(due_s - time.monotonic(), 0.0)):
            due_s = max(due_s + 1.0, time.monotonic())
            time_ms = int(time.time() * 1000)
            body = {"samples": samples([time_ms / 1000])}
            began = time.monotonic()
            answer = self._client.post(f"/api/v1/assets/{LIVE}/measurements", json=body)
            self.answered_s.append(time.monotonic() - began)
            self.answers.append((time_ms * 1000, answer.json()))

    def _look(self) -> None:
        while not self._stop.wait(0.1):
            tags = self._client.get(f"/api/v1/assets/{LIVE}/snapshot").json()["tags"]
            shown = tags["speed_rpm"]["time"]
            if shown is not None:
                self.ages_s.append(time.time() - datetime.fromisoformat(shown).timestamp())


@dataclass
class Late:
    """A portion of backlog, and how it was answered."""

    asset: str
    begin_s: int
    end_s: int
    samples: int
    body: bytes
    refused: int = 0
    answered_s: float = 0.0
    answer: dict[str, Any] = field(default_factory=dict)


def samples(times_s: Sequence[float]) -> list[dict[str, Any]]:
    return [
        {"channel": name, "time": stamp, "value": value}
        for time_s in times_s
        for stamp in [datetime.fromtimestamp(time_s, UTC).isoformat(timespec="milliseconds")]
        for name, value in VALUES.items()
    ]


def stored_times_us(station: Station, asset: str, begin_s: int, end_s: int) -> list[int]:
    """Times of the samples of all channels of an asset."""
    with closing(
        sqlite3.connect(station.folder / "data" / FILE_NAME, timeout=patience(60))
    ) as store:
        query = (
            "SELECT time_us FROM samples JOIN channels ON channels.id = channel_id "
            "WHERE asset = ? AND time_us >= ? AND time_us < ?"
        )
        return [row[0] for row in store.execute(query, (asset, begin_s * 10**6, end_s * 10**6))]


def percentile(values: list[float], share: float) -> float:
    return sorted(values)[int(share * (len(values) - 1))]


@pytest.fixture
def station(tmp_path: Path) -> Iterator[Station]:
    text = "".join(asset_text(name, CHANNELS, OBSERVE) for name in (LIVE, *ASSETS))
    with Station(tmp_path, *write_site(tmp_path, text)) as station:
        station.start_service()
        yield station


def send(station: Station, late: Late, stored: Callable[[Late], int]) -> None:
    """Send a portion until it is acknowledged; what is answered 503 must not be in the store."""
    address = f"/api/v1/assets/{late.asset}/measurements"
    headers = {"X-API-Key": station.key, "Content-Type": "application/json"}
    with httpx2.Client(base_url=station.address, headers=headers, timeout=patience(120)) as client:
        while True:
            began = time.monotonic()
            answer = client.post(address, content=late.body)
            if answer.status_code == httpx2.codes.OK:
                late.answer, late.answered_s = answer.json(), time.monotonic() - began
                return
            assert answer.status_code == httpx2.codes.SERVICE_UNAVAILABLE, answer.text
            assert int(answer.headers["Retry-After"]) > 0
            assert stored(late) == 0, answer.text
            late.refused += 1
            time.sleep(1.0)  # earlier than told, to keep up the pressure


def test_a_backlog_is_stored_once_and_live_data_stay_young(
    station: Station, tell: Callable[[Outcome], None]
) -> None:
    backlog = []
    for asset in ASSETS:
        begin_s = int(time.time()) - 24 * 3600
        for count in PORTIONS:
            end_s = begin_s + count // len(CHANNELS)
            body = json.dumps({"samples": samples(range(begin_s, end_s))}).encode()
            backlog.append(Late(asset, begin_s, end_s, count, body))
            begin_s = end_s

    def stored(late: Late) -> int:
        return len(stored_times_us(station, late.asset, late.begin_s, late.end_s))

    with station.open_store() as store:
        live_key = create_key(store, "admin").text
    with LiveGateway(station.address, live_key).running() as live:
        wait_until(lambda: len(live.ages_s) > 3, PATIENCE_S, "live data")
        live.ages_s.clear()
        time.sleep(CALM_S)
        calm_s, live.ages_s, live.answered_s = live.ages_s, [], []
        began = time.monotonic()
        with ThreadPoolExecutor(len(backlog)) as gateways:
            list(gateways.map(lambda late: send(station, late, stored), backlog))
        took_s = time.monotonic() - began
        busy_s, short_s = live.ages_s, percentile(live.answered_s, 0.5)
    refused = sum(late.refused for late in backlog)
    count = sum(late.samples for late in backlog)
    busy, calm = percentile(busy_s, 0.95), percentile(calm_s, 0.95)
    long_s = percentile([one.answered_s for one in backlog if one.samples == max(PORTIONS)], 0.5)
    note = (
        f"{count:,} samples in {took_s:.1f} s, {refused} pushes answered 503; live data at the "
        f"95th percentile {busy:.2f} s old, {calm:.2f} s without backlog; answered within "
        f"{short_s:.3f} s, portions of {max(PORTIONS):,} within {long_s:.2f} s (medians)"
    )
    tell(Outcome("backlog", note=note))
    assert refused > 0, "none was answered 503"
    for late in backlog:
        assert late.answer == {"accepted": late.samples, "duplicates": 0, "rejected": []}
        assert stored(late) == late.samples
    taken = {"accepted": len(CHANNELS), "duplicates": 0, "rejected": []}
    assert [answer for _, answer in live.answers if answer != taken] == []
    times_us = Counter(stored_times_us(station, LIVE, 0, 2**40))
    assert [one for one, _ in live.answers if times_us[one] != len(CHANNELS)] == []
    assert busy < AGE_RATIO * calm
    assert short_s < long_s / 2.0, "live pushes do not queue behind the backlog"
