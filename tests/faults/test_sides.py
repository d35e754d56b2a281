"""Cell, web side and plant side in processes of their own: each ends and comes back alone."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest
from patience import patience
from processes import Station, wait_until
from site_files import CHANNELS, OBSERVE, asset_text, write_site
from websockets.sync.client import ClientConnection, connect

from service.domain.roles import Role

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900)]

ASSET = "bench-1"
VALUES = dict(zip(CHANNELS, (1500.0, 2000.0, 22.0, 40.0, 38.0), strict=True))
#: A machine that other programs keep busy compiles the twin first.
STARTED_S = 600.0
PATIENCE_S = 60.0

#: The command, which says at its end whether the compiled twin was loaded.
_SERVE = """
import atexit, sys
from service.cli import main
atexit.register(lambda: print("numba" if "numba" in sys.modules else "no numba", flush=True))
main()
"""


class Side:
    """A side in a process of its own."""

    def __init__(self, name: str, configuration: Path) -> None:
        self.name, self.configuration = name, configuration
        self.log = configuration.with_name(f"{name}.log")
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        serve = [sys.executable, "-c", _SERVE, "serve", "--only", self.name]
        with self.log.open("ab") as errors:
            self.process = subprocess.Popen(
                [*serve, "-c", str(self.configuration)],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )

    def until_ready(self) -> None:
        assert self.process is not None
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line == f"{self.name} is ready\n", f"{self.name}: {self.log.read_text()[-2000:]}"

    def send(self, number: signal.Signals) -> None:
        assert self.process is not None
        os.kill(self.process.pid, number)

    def end(self, number: signal.Signals = signal.SIGKILL) -> str:
        """End it; returns what it said last."""
        if self.process is None:
            return ""
        assert self.process.stdout is not None
        if self.process.poll() is None:
            self.send(number)
        out, _ = self.process.communicate(timeout=patience(PATIENCE_S))
        self.process = None
        return out.strip()


class Site(Station):
    """A configuration, its keys and its sides."""

    def __init__(self, folder: Path) -> None:
        limits = "limits = { t_inner_ring_c = { warning = 90, alarm = 105 } }"
        text = asset_text(ASSET, CHANNELS, limits, OBSERVE)
        super().__init__(folder, *write_site(folder, text))
        self.cell = Side("cell", self.configuration)
        self.web = Side("web", self.configuration)

    def ask(self, path: str, role: Role = "viewer") -> httpx2.Response:
        return self.client.get(path, headers={"X-API-Key": self.key_of(role)})

    def push_at(self, time_ms: int) -> httpx2.Response:
        at = datetime.fromtimestamp(time_ms / 1000, UTC).isoformat(timespec="milliseconds")
        samples = [{"channel": name, "time": at, "value": one} for name, one in VALUES.items()]
        return self.client.post(
            f"/api/v1/assets/{ASSET}/measurements",
            json={"samples": samples},
            headers={"X-API-Key": self.key_of("gateway")},
        )

    def answers(self) -> bool:
        try:
            return self.ask(f"/api/v1/assets/{ASSET}/snapshot").status_code == 200
        except httpx2.TransportError:
            return False

    def stream(self, query: str = "") -> ClientConnection:
        address = f"ws://127.0.0.1:{self.port}/api/v1/stream{query}"
        headers = {"X-API-Key": self.key_of("viewer")}
        return connect(address, additional_headers=headers, proxy=None, open_timeout=PATIENCE_S)

    def close(self) -> None:
        super().close()
        for side in (self.web, self.cell):
            side.end()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with Site(tmp_path_factory.mktemp("site")) as site:
        for role in ("viewer", "operator", "gateway"):
            site.key_of(role)
        site.cell.start()
        site.web.start()
        wait_until(site.answers, STARTED_S, "the web side answers")
        yield site


class Feed:
    """Pushes numbered samples again and again, and notes which were acknowledged."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.acknowledged: list[int] = []
        self.refused = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Feed":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            time_ms = time.time_ns() // 1_000_000
            while not self._stop.is_set():  # the same again until it is taken, as gateways do
                try:
                    answer = self.site.push_at(time_ms)
                except httpx2.TransportError:
                    self.refused += 1
                else:
                    if answer.status_code == 200:
                        assert answer.json()["rejected"] == []
                        self.acknowledged.append(time_ms)
                        break
                    self.refused += 1
                self._stop.wait(0.05)


def stored_ms(site: Site, channel: str) -> list[int]:
    path = site.folder / "data" / "bearing-twin.db"
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as connection:
        rows = connection.execute(
            "SELECT time_us FROM samples JOIN channels ON channels.id = channel_id "
            "WHERE asset = ? AND name = ?",
            (ASSET, channel),
        )
        return sorted(time_us // 1000 for (time_us,) in rows)


def test_a_web_side_that_is_killed_loses_and_doubles_nothing(site: Site) -> None:
    back_s = []
    with Feed(site) as feed:
        for _ in range(3):
            before = len(feed.acknowledged)
            wait_until(lambda n=before: len(feed.acknowledged) > n + 10, PATIENCE_S, "pushes go on")  # type: ignore[misc]
            site.web.end()
            begun_s = time.monotonic()
            site.web.start()
            wait_until(site.answers, PATIENCE_S, "the web side answers again", 0.02)
            back_s.append(time.monotonic() - begun_s)
    print(f"answers again after {', '.join(f'{one:.2f}' for one in back_s)} s")  # noqa: T201
    assert feed.refused > 0
    for channel in CHANNELS:
        found = stored_ms(site, channel)
        assert set(feed.acknowledged) <= set(found)
        assert len(found) == len(set(found))


@pytest.mark.endurance
def test_a_stream_goes_on_after_the_web_side_was_killed(site: Site) -> None:
    with Feed(site), site.stream() as stream:
        hello = json.loads(stream.recv(PATIENCE_S))
        seen: list[dict[str, Any]] = [json.loads(stream.recv(PATIENCE_S)) for _ in range(10)]
        site.web.end()
        site.web.start()
        wait_until(site.answers, PATIENCE_S, "the web side answers again")
        last = seen[-1]["seq"]
        with site.stream(f"?resume={last}&epoch={hello['epoch']}") as again:
            second = json.loads(again.recv(PATIENCE_S))
            assert (second["type"], second["gap"], second["epoch"]) == (
                "hello",
                False,
                hello["epoch"],
            )
            following = [json.loads(again.recv(PATIENCE_S)) for _ in range(20)]
    numbers = [one["seq"] for one in [*seen, *following] if one["type"] != "heartbeat"]
    # What the cell has kept of them, in one go: nothing is missing, nothing comes twice.
    with site.stream(f"?resume={numbers[0] - 1}&epoch={hello['epoch']}") as whole:
        whole.recv(PATIENCE_S)
        kept = [json.loads(whole.recv(PATIENCE_S))["seq"] for _ in numbers]
    assert numbers == kept


@pytest.mark.endurance
def test_the_web_side_goes_on_without_the_cell_and_says_so(site: Site) -> None:
    with Feed(site):
        tags = f"/api/v1/assets/{ASSET}/snapshot"
        wait_until(
            lambda: site.ask(tags).json()["tags"]["t_inner_ring_c"]["quality"] >= 192,
            PATIENCE_S,
            "a good value",
        )
    site.push_at(time.time_ns() // 1_000_000)
    with site.stream() as stream:
        epoch = json.loads(stream.recv(PATIENCE_S))["epoch"]
        site.cell.end()

        def doubtful() -> httpx2.Response | None:
            answer = site.ask(tags)
            found = answer.json()["tags"]
            if found["t_inner_ring_c"]["quality"] >= 192:
                return None
            return answer

        answer = wait_until(doubtful, PATIENCE_S, "old values are no longer good")
        assert int(answer.headers["Age"]) >= 1
        assert answer.json()["tags"]["verdict.now"]["value"] == 0
        verdict = site.ask(f"/api/v1/assets/{ASSET}/verdict").json()
        assert (verdict["now"]["word"], verdict["next_step"]["word"]) == ("unknown", "unknown")
        assert "twin" in verdict["missing"]
        assert site.ask("/livez").status_code == 200
        ready = site.ask("/readyz")
        assert ready.status_code == 503
        assert [check["name"] for check in ready.json()["checks"]] == ["cell"]
        assert site.ask(f"/api/v1/assets/{ASSET}/measurements").status_code == 200, "history"
        refused = site.push_at(time.time_ns() // 1_000_000)
        assert refused.status_code == 503
        assert int(refused.headers["Retry-After"]) > 0
        kinds = set()
        while kinds < {"health", "verdict"}:
            message = json.loads(stream.recv(PATIENCE_S))
            if message["type"] == "health" and message["data"]["degraded"]:
                kinds.add("health")
            if message["type"] == "verdict" and message["data"]["now"]["word"] == "unknown":
                kinds.add("verdict")
        site.cell.start()
        begun_s = time.monotonic()
        wait_until(lambda: site.ask("/readyz").status_code == 200, STARTED_S, "ready again")
        print(f"ready again after {time.monotonic() - begun_s:.1f} s")  # noqa: T201
    with site.stream(f"?resume=1&epoch={epoch}") as stream:
        hello = json.loads(stream.recv(PATIENCE_S))
    assert hello["epoch"] != epoch
    assert hello["gap"] is True
    assert site.push_at(time.time_ns() // 1_000_000).status_code == 200


@pytest.mark.endurance
def test_a_web_side_that_stands_still_holds_nobody_up_and_catches_up(site: Site) -> None:
    def rss_mib() -> float:
        assert site.cell.process is not None
        pages = Path(f"/proc/{site.cell.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20

    before_mib = rss_mib()
    with site.stream() as stream:
        json.loads(stream.recv(PATIENCE_S))
        site.web.send(signal.SIGSTOP)
        try:
            time.sleep(10.0)
            grown_mib = rss_mib() - before_mib
        finally:
            site.web.send(signal.SIGCONT)
        wait_until(site.answers, PATIENCE_S, "it answers again")
        message = json.loads(stream.recv(PATIENCE_S))
        # What the web side says itself has no number of its own: the cell's own messages must come.
        while message["seq"] == 0:
            message = json.loads(stream.recv(PATIENCE_S))
        assert message["seq"] > 0
    assert grown_mib < 50.0


@pytest.mark.endurance
def test_audit_lines_of_a_killed_web_side_are_there_once(site: Site) -> None:
    made = []
    for number in range(5):
        answer = site.client.post(
            "/api/v1/keys",
            json={"role": "viewer", "label": f"number {number}"},
            headers={"X-API-Key": site.key},
        )
        assert answer.status_code == 201
        made.append(answer.json()["prefix"])
    site.client.post("/api/v1/session", json={"key": site.key_of("operator")}).raise_for_status()
    site.web.end()
    site.web.start()
    wait_until(site.answers, PATIENCE_S, "the web side answers again")
    lines = site.ask("/api/v1/audit?limit=100", "admin").json()["items"]
    for prefix in made:
        assert sum(prefix in line["target"] for line in lines) == 1, lines
    assert sum(line["action"] == "session.begin" for line in lines) == 1


def test_metrics_tell_of_both_sides(site: Site) -> None:
    def told() -> bool:
        text = site.ask("/metrics").text
        return 'bearing_twin_process_up{process="web"} 1.0' in text

    wait_until(told, PATIENCE_S, "the web side reports to the cell")
    assert "bearing_twin_samples_accepted_total" in site.ask("/metrics").text


def test_only_the_cell_loads_the_compiled_twin(site: Site) -> None:
    assert site.web.end(signal.SIGTERM).endswith("no numba")
    plant = Side("plant", site.configuration)
    plant.start()
    plant.until_ready()
    assert plant.end(signal.SIGTERM).endswith("no numba")
    site.web.start()
    wait_until(site.answers, PATIENCE_S, "the web side answers again")
