"""The service starts before what it needs is there: it acquires, waits and goes on by itself."""

import json
import os
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
import psycopg
import pytest
from faults.hall import ASSET, BASE, CAN, MODBUS, Hall, lock_store
from faults.test_store_away import small_disk
from hasty import HASTY_S
from patience import patience
from postgresql import running_postgresql
from processes import hasty, wait_until

from service.ingest.spool import FILE_NAME as SPOOL_FILE
from service.store import lock_data_directory
from service.store.opening import FILE_NAME
from service.web.listening import bind

pytestmark = [pytest.mark.wires, pytest.mark.timeout(0), pytest.mark.endurance]
PATIENCE_S = 120.0
COMMAND = (sys.executable, "-m", "service")


class Starting:
    """A service that was started and has not said yet that it is ready."""

    def __init__(self, configuration: Path, log: Path, command: Sequence[str]) -> None:
        self.log = log
        with log.open("ab") as errors:
            self.process = subprocess.Popen(
                [*command, "serve", "-c", str(configuration)],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        self.ready = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        if self.process.stdout.readline():
            self.ready.set()
        self.process.stdout.read()

    def wait_until_ready(self) -> None:
        wait_until(
            lambda: self.ready.is_set() or self.process.poll() is not None, PATIENCE_S, "ready"
        )
        assert self.process.poll() is None, self.log.read_text()[-3000:]

    def events(self, name: str) -> list[dict[str, Any]]:
        """Log lines of a kind."""
        lines = self.log.read_text().splitlines()
        documents = [json.loads(line) for line in lines if line.startswith("{")]
        return [one for one in documents if one["event"] == name]

    def waits(self, why: str) -> bool:
        return any(why in one["error"] for one in self.events("waiting"))

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(60)
        finally:
            self.process.kill()
            self._reader.join()
            if self.process.stdout is not None:
                self.process.stdout.close()


@contextmanager
def starting(hall: Hall, command: Sequence[str] = COMMAND) -> Iterator[Starting]:
    service = Starting(hall.configuration, hall.folder / "serve.log", command)
    try:
        yield service
    finally:
        service.end()


@contextmanager
def devices(hall: Hall) -> Iterator[None]:
    """Only the devices: the service is started by the test."""
    peers = hall.modbus, hall.can
    for peer in peers:
        peer.start()
    try:
        yield
    finally:
        for peer in peers:
            peer.kill()


def spooled(hall: Hall) -> int:
    file = hall.folder / "data" / SPOOL_FILE
    if not file.exists():
        return 0
    with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as outside:
        try:
            return int(outside.execute("SELECT COUNT(*) FROM samples").fetchone()[0])
        except sqlite3.OperationalError:  # just being made, or written
            return 0


def numbers(hall: Hall, channel: str) -> list[int]:
    """What the device counted, as it is stored."""
    with hall.open_store() as store:
        rows = store.samples.read("bench-1", [channel], 0, 2**62, 10**7)
    return [
        round((one.value - BASE) * 1000)
        for one in rows
        if one.value is not None and one.quality >= 192
    ]


def assert_nothing_is_missing(hall: Hall) -> None:
    """From the first to the last number, each once: nothing was lost while it waited."""
    for channel in (MODBUS, CAN):
        found = numbers(hall, channel)
        assert found, channel
        assert len(found) == len(set(found)), f"{channel}: twice"
        assert found == list(range(found[0], found[-1] + 1)), f"{channel}: a hole"


def survive(
    hall: Hall,
    why: str,
    come_back: Callable[[], object],
    waits_for: str = "the store",
    command: Sequence[str] = COMMAND,
) -> None:
    """Start without the store, let it come, and look for every sample since the start."""
    with devices(hall), starting(hall, command) as service:
        wait_until(lambda: service.waits(why), PATIENCE_S, f"it waits because of: {why}")
        wait_until(lambda: spooled(hall) > 100, PATIENCE_S, "samples on the spool")

        def waiting() -> httpx2.Response | None:
            """The web side hears of it from the cell, a moment after both have started."""
            answer = hall.client.get("/readyz")
            detail = answer.json()["checks"][0]["detail"]
            return answer if detail == f"waits for {waits_for}" else None

        answer = wait_until(waiting, PATIENCE_S, f"it waits for {waits_for}")
        assert answer.status_code == 503
        assert answer.json()["status"] == "not ready"
        assert answer.headers["Retry-After"]
        assert hall.client.get("/livez").status_code == 200
        pushed = hall.client.post("/api/v1/assets/bench-1/measurements", json={"samples": []})
        assert pushed.status_code == 503
        before = spooled(hall)
        come_back()
        service.wait_until_ready()
        wait_until(lambda: spooled(hall) == 0, PATIENCE_S, "the spool is empty")
        wait_until(
            lambda: len(numbers(hall, MODBUS)) > before / 6, PATIENCE_S, "all is in the store"
        )
        wait_until(lambda: hall.tag("t_node_7_c.twin"), PATIENCE_S, "the twin runs")
        assert service.end() == 0
    assert_nothing_is_missing(hall)
    first = min(map(len, (numbers(hall, MODBUS), numbers(hall, CAN))))
    assert first > 10


def test_a_postgresql_server_that_comes_up_after_the_service(tmp_path: Path) -> None:
    with (
        running_postgresql() as server,
        Hall(tmp_path, f'database_url = "{server.database()}"') as hall,
    ):
        server.stop()
        survive(hall, "Is the server running", server.start)


def test_a_postgresql_server_that_hangs_at_the_start(tmp_path: Path) -> None:
    with running_postgresql() as server:
        hall = Hall(tmp_path, f'database_url = "{server.database()}"')
        with server.frozen() as thaw:
            survive(hall, "timeout", thaw)
        hall.close()


def test_a_store_that_is_locked_for_long_at_the_start(tmp_path: Path) -> None:
    with Hall(tmp_path) as hall:
        release = lock_store(hall.folder / "data" / FILE_NAME)

        def come_back() -> None:  # later than another service would have to leave
            time.sleep(2.0 * HASTY_S)
            release()

        survive(hall, "database is locked", come_back, command=hasty())


def test_a_disk_that_is_full_at_the_start(tmp_path: Path) -> None:
    disk = tmp_path / "data"
    with small_disk(disk, 32):
        hall = Hall(tmp_path)
        filler = disk / "filler"
        with filler.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(4096))
        with devices(hall), starting(hall) as service:
            wait_until(lambda: service.waits("full"), PATIENCE_S, "it waits for room")
            filler.unlink()
            service.wait_until_ready()
            wait_until(lambda: hall.tag("t_node_7_c.twin"), PATIENCE_S, "the twin runs")
            assert service.end() == 0
        assert_nothing_is_missing(hall)
        hall.close()


def test_a_port_that_is_given_up_late(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    with bind("127.0.0.1", hall.port) as other, devices(hall), starting(hall) as service:
        wait_until(lambda: service.waits("cannot listen there"), PATIENCE_S, "it waits")
        # The cell works without its web side.
        wait_until(lambda: len(numbers(hall, MODBUS)) > 50, PATIENCE_S, "samples meanwhile")
        other.close()
        service.wait_until_ready()
        wait_until(lambda: hall.tag("t_node_7_c.twin"), PATIENCE_S, "the twin runs")
        assert service.end() == 0
    assert_nothing_is_missing(hall)
    hall.close()


def test_a_port_that_stays_taken_ends_with_75_and_what_was_acquired_stays(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    with bind("127.0.0.1", hall.port), devices(hall), starting(hall, hasty()) as service:
        assert service.process.wait(PATIENCE_S) == os.EX_TEMPFAIL
        last = service.log.read_text().splitlines()[-1]
        assert f"service.port = {hall.port}: cannot listen there" in last
    with devices(hall), starting(hall) as service:
        service.wait_until_ready()
        wait_until(lambda: spooled(hall) == 0, PATIENCE_S, "the spool is empty")
        assert service.end() == 0
    found = numbers(hall, MODBUS)
    assert len(found) == len(set(found)) > 50
    hall.close()


def test_a_data_directory_that_is_given_up_late(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    with lock_data_directory(tmp_path / "data") as lock, starting(hall) as service:
        wait_until(lambda: service.waits("another service is running"), PATIENCE_S, "it waits")
        lock.close()
        service.wait_until_ready()
        assert service.end() == 0
    hall.close()


def test_a_database_that_another_machine_gives_up_late(tmp_path: Path) -> None:
    with running_postgresql() as server:
        url = server.database()
        hall = Hall(tmp_path, f'database_url = "{url}"')
        with psycopg.connect(url, autocommit=True) as other:
            other.execute("SELECT pg_advisory_lock(%s, hashtext(current_schema()))", (0x42545773,))
            survive(
                hall,
                "another service is running on it",
                other.close,
                "another service to leave the database",
            )
        hall.close()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [("no_such_database", "does not exist"), ("no_such_user", "does not exist")],
)
def test_what_a_person_must_mend_ends_at_once_with_2(tmp_path: Path, wrong: str, said: str) -> None:
    with running_postgresql() as server:
        url = server.database()
        hall = Hall(tmp_path, f'database_url = "{url}"')
        hall.close()
        database = url.partition("?")[0].rpartition("/")[2]
        bad = (
            url.replace(f"/{database}?", f"/{wrong}?")
            if wrong == "no_such_database"
            else url.replace("://postgres:", f"://{wrong}:")
        )
        assert bad != url
        hall.configuration.write_text(hall.configuration.read_text().replace(url, bad))
        ended = subprocess.run(
            [sys.executable, "-m", "service", "serve", "-c", str(hall.configuration)],
            capture_output=True,
            text=True,
            timeout=patience(PATIENCE_S),
            check=False,
        )
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1), ended.stderr
    assert said in ended.stderr


def test_with_an_empty_kernel_cache_devices_are_read_and_shown_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    with Hall(tmp_path) as hall, devices(hall), starting(hall) as service:
        service.wait_until_ready()
        assert not service.events("twin_loaded")
        wait_until(lambda: numbers(hall, MODBUS), PATIENCE_S, "stored samples")
        page = hall.client.get("/")
        verdict = hall.client.get(f"/api/v1/assets/{ASSET}/verdict").json()
        checks = {one["name"]: one for one in hall.client.get("/readyz").json()["checks"]}
        assert not service.events("twin_loaded"), "it was compiled before anything was shown"
        assert checks[f"twin:{ASSET}"]["status"] == "degraded"
        assert "being compiled" in checks[f"twin:{ASSET}"]["detail"]
        assert page.status_code == httpx2.codes.OK
        assert verdict["now"]["word"] == verdict["next_step"]["word"] == "unknown"
        wait_until(lambda: service.events("twin_loaded"), 600.0, "the compiled twin")
        wait_until(
            lambda: hall.tags()["t_node_7_c.twin"]["value"] is not None,
            PATIENCE_S,
            "an estimate",
        )
        assert service.end() == 0


def test_sigterm_while_it_waits_ends_it_and_keeps_what_was_acquired(tmp_path: Path) -> None:
    with running_postgresql() as server:
        hall = Hall(tmp_path, f'database_url = "{server.database()}"')
        server.stop()
        with devices(hall), starting(hall) as service:
            wait_until(lambda: spooled(hall) > 100, PATIENCE_S, "samples on the spool")
            assert service.end() == 0
            kept = spooled(hall)
            assert kept > 100
        server.start()
        with starting(hall) as service:
            service.wait_until_ready()
            wait_until(lambda: spooled(hall) == 0, PATIENCE_S, "the spool is empty")
            assert service.end() == 0
        for channel in (MODBUS, CAN):
            found = numbers(hall, channel)
            assert len(found) == len(set(found)) > 10
        hall.close()


def test_a_command_on_a_locked_store_says_so_in_one_line(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    release = lock_store(hall.folder / "data" / FILE_NAME)
    try:
        ended = subprocess.run(
            [
                sys.executable, "-m", "service", "keys", "create", "--role", "viewer",
                "-c", str(hall.configuration),
            ],
            capture_output=True,
            text=True,
            timeout=patience(PATIENCE_S),
            check=False,
        )  # fmt: skip
    finally:
        release()
        hall.close()
    assert (ended.returncode, ended.stderr.count("\n")) == (os.EX_TEMPFAIL, 1), ended.stderr
    assert "locked" in ended.stderr
