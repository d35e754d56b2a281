"""The flow of deploy/node-red polls a service in a Node-RED of its own."""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from patience import patience
from processes import Site, free_port, wait_until
from programs import needed, node_package

from service.demo.configuration import ASSET

pytestmark = pytest.mark.wires

FLOWS = Path(__file__).parents[2] / "deploy" / "node-red" / "flows.json"
RING = "t_inner_ring_c"


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with Site(tmp_path, "staircase", 1.0) as site:
        site.start_bench()
        site.start_service()
        yield site


@pytest.fixture
def node_red(site: Site, tmp_path: Path) -> Iterator[str]:
    node = needed("nodejs", "node")
    program = node_package("node-red") / "red.js"
    folder, port = tmp_path / "node-red", free_port()
    folder.mkdir()
    (folder / "flows.json").write_bytes(FLOWS.read_bytes())
    settings = {
        "uiHost": "127.0.0.1",
        "uiPort": port,
        "flowFile": "flows.json",
        "telemetry": {"enabled": False},
    }
    (folder / "settings.js").write_text(f"module.exports = {json.dumps(settings)};")
    environment = {
        "BEARING_TWIN_URL": f"http://127.0.0.1:{site.port}",
        "BEARING_TWIN_KEY": site.key,
        "BEARING_TWIN_ASSET": ASSET,
    }
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [node, program, "--userDir", folder],
            cwd=folder,
            env=os.environ | environment,
            stdout=log,
            stderr=log,
        )
    try:
        yield f"http://127.0.0.1:{port}/context/flow/bearing-twin"
    finally:
        process.terminate()
        process.wait(30)


def context(address: str, name: str) -> Any:
    """A value that the flow keeps; None before there is one, or before Node-RED listens."""
    try:
        answer = httpx2.get(f"{address}/{name}", timeout=patience(30))
    except httpx2.TransportError:
        return None
    kept = answer.json() if answer.is_success else {}
    return json.loads(kept["msg"]) if kept.get("format") == "Object" else None


def test_the_flow_holds_the_tags_of_the_snapshot(site: Site, node_red: str) -> None:
    def polls() -> dict[str, int]:
        return dict(context(node_red, "polls") or {})

    wait_until(lambda: polls().get("200", 0) >= 3, 120, "three answers")
    names = site.tags().keys()
    wait_until(lambda: context(node_red, "tags").keys() == names, 60, "all tags")
    before = context(node_red, "tags")[RING]
    wait_until(
        lambda: context(node_red, "tags")[RING]["time"] != before["time"], 60, "a newer value"
    )
    begun = time.monotonic()
    mine, theirs = site.tags()[RING], context(node_red, "tags")[RING]
    assert (theirs["unit"], theirs["quality"]) == ("°C", mine["quality"])
    assert theirs["value"] == pytest.approx(mine["value"], abs=1 + time.monotonic() - begun)
    assert polls().keys() <= {"200", "304"}
