"""Keys, sessions, streams and logs of a running service, and a fuzz run against it.

One service for the whole file: an asset whose values are pushed, no bench.
"""

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
import websockets
from patience import patience, wait_for
from processes import Station, wait_until
from site_files import MACHINE, asset_text, write_site

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]

FUZZ = Path(__file__).parents[1] / "fuzz" / "schemathesis.toml"
# A slow machine has read the description of the calls when the shortest is over.
FUZZ_S = (10, 60, 240)
# Within two seconds on a machine that does nothing else.
PATIENCE_S = 30.0
WRONG = "bt_0badc0de_" + "A" * 43


class Place(Station):
    """A service, and the secrets that its users know."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, *write_site(folder, asset_text("bench-1")))
        self.secrets = [self.key]

    def cli(self, *arguments: str) -> Any:
        """Run ``bearing-twin keys …`` beside the service."""
        command = [sys.executable, "-m", "service", "keys", *arguments]
        done = subprocess.run(
            [*command, "-c", str(self.configuration), "--json"],
            capture_output=True,
            text=True,
            check=True,
            timeout=patience(180),
        )
        return json.loads(done.stdout)

    def new_key(self, role: str) -> dict[str, Any]:
        answer = self.client.post("/api/v1/keys", json={"role": role, "label": "test"})
        made: dict[str, Any] = answer.json()
        self.secrets.append(made["key"])
        return made


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    values = dict(zip(MACHINE, (1500.0, 2650.0, 22.0, 40.0), strict=True))
    with Place(tmp_path_factory.mktemp("access")) as place:
        place.start_service()
        assert place.push("bench-1", **values).json()["accepted"] == len(values)
        yield place


async def read_on(stream: websockets.ClientConnection) -> None:
    while True:
        await stream.recv()


async def until_the_stream_ends(place: Place, key: str, revoke: Any) -> tuple[int, str, float]:
    """Open a stream with a key, revoke the key, and wait: close code, reason, wall seconds."""
    address = place.address.replace("http", "ws") + "/api/v1/stream"
    protocols: Any = [f"bearer.{key}"]
    async with websockets.connect(
        address, subprotocols=protocols, open_timeout=PATIENCE_S
    ) as stream:
        assert json.loads(await stream.recv())["type"] == "hello"
        await asyncio.to_thread(revoke)
        began = time.monotonic()
        with pytest.raises(websockets.ConnectionClosed) as closed:
            await wait_for(read_on(stream), PATIENCE_S)
    end = closed.value.rcvd
    assert end is not None
    return end.code, end.reason, time.monotonic() - began


@pytest.mark.parametrize("way", ["rest", "command line"])
def test_a_revoked_key_loses_its_sessions_and_streams_too(place: Place, way: str) -> None:
    made = place.new_key("operator")

    def revoke() -> None:
        if way == "rest":
            assert place.client.delete(f"/api/v1/keys/{made['id']}").status_code == 200
        else:
            assert place.cli("revoke", made["prefix"])["revoked"] is not None

    with httpx2.Client(base_url=place.address, timeout=patience(30)) as browser:
        assert browser.post("/api/v1/session", json={"key": made["key"]}).status_code == 200
        assert browser.get("/api/v1/assets").status_code == 200
        code, reason, took_s = asyncio.run(until_the_stream_ends(place, made["key"], revoke))
        assert (code, reason) == (1008, "the key is no longer valid")
        print(f"revoked by {way}: stream closed after {took_s:.2f} s")  # noqa: T201
        assert browser.get("/api/v1/assets").status_code == 401
    mine = {"X-API-Key": made["key"]}
    assert httpx2.get(f"{place.address}/api/v1/assets", headers=mine).status_code == 401


def test_what_was_done_is_in_the_trail_with_who_and_from_where(place: Place) -> None:
    made = place.new_key("viewer")
    by_hand = place.cli("create", "--role", "gateway", "--label", "hall 3")
    place.secrets.append(by_hand["key"])
    assert by_hand["label"] == "hall 3"
    line, other = place.client.get("/api/v1/audit?limit=2").json()["items"]
    assert (line["action"], line["detail"]) == ("key.create", "role gateway, hall 3")
    assert line["who"].startswith("command line, ")
    assert other["target"] == f"key {made['prefix']}"
    assert other["who"].startswith("admin bt_")
    assert other["address"] == "127.0.0.1"


def test_an_upgrade_is_refused_with_a_problem(place: Place) -> None:
    async def refused(path: str, key: str) -> Any:
        address = place.address.replace("http", "ws") + path
        with pytest.raises(websockets.InvalidStatus) as refusal:
            await websockets.connect(address, additional_headers={"X-API-Key": key})
        response = refusal.value.response
        assert response.headers["content-type"] == "application/problem+json"
        return json.loads(response.body)

    admin = place.key
    assert asyncio.run(refused("/api/v1/stream", WRONG))["status"] == 403
    assert asyncio.run(refused("/api/v1/stream?assets=none", admin))["status"] == 404
    assert asyncio.run(refused("/api/v1/streams", admin))["status"] == 404


def fuzz(place: Place, seconds: int) -> "subprocess.CompletedProcess[str]":
    """Do the short form of the run in docs/connect/api.md."""
    return subprocess.run(
        [
            sys.executable, "-m", "schemathesis.cli", "--no-color", "--config-file", str(FUZZ),
            "run", f"{place.address}/openapi.json", "--max-time", str(seconds), "--seed", "1",
            "--phases", "fuzzing,stateful", "--no-shrink",
            "--suppress-health-check", "all", "--checks",
            "not_a_server_error,status_code_conformance,content_type_conformance,"
            "response_schema_conformance,response_headers_conformance",
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=patience(500),
        cwd=place.folder,
        env=os.environ | {"BEARING_TWIN_KEY": place.key},
    )  # fmt: skip


def test_a_fuzz_run_finds_no_server_error_and_nothing_undocumented(place: Place) -> None:
    for seconds in FUZZ_S:
        done = fuzz(place, seconds)
        if "Tested: 0" not in done.stdout:
            break
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert "Tested: 0" not in done.stdout


def test_no_secret_is_ever_logged(place: Place) -> None:
    """After all the rest: keys, cookies and what was offered in vain are nowhere in the log."""
    with httpx2.Client(base_url=place.address, timeout=patience(30)) as browser:
        # The fuzz run may have offered too many wrong keys a moment ago.
        mine = {"key": place.secrets[0]}
        wait_until(
            lambda: browser.post("/api/v1/session", json=mine).is_success, 90, "a log-in", 1.0
        )
        cookies = list(browser.cookies.values())
        assert cookies
        browser.post("/api/v1/session", json={"key": WRONG})
        browser.get("/api/v1/assets", headers={"X-API-Key": WRONG})
        browser.get("/api/v1/assets", auth=("anyone", WRONG))
    assert place.service is not None
    assert place.service.terminate() == 0
    log = place.service.log.read_text()
    assert '"event": "audit"' in log
    data = place.folder / "data"
    for secret in (*(key.split("_", 2)[2] for key in (*place.secrets, WRONG)), *cookies):
        assert secret not in log
        for file in data.rglob("*"):
            assert not file.is_file() or secret.encode() not in file.read_bytes(), file
