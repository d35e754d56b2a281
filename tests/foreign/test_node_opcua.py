"""The OPC UA server's history, read by node-opcua."""

import asyncio
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from opcua_site import RING, Asset, fill_seconds, node_id, serving
from patience import patience
from programs import needed, node_package

from service.store import Outbox, Store

HERE = Path(__file__).parent
BEGIN, END = "2026-01-01T00:00:00Z", "2026-01-02T00:00:00Z"
BEGIN_US = 1_767_225_600_000_000


async def read(folder: Path, store: Store, outbox: Outbox, page: int) -> dict[str, Any]:
    node = needed("nodejs", "node")
    node_package("node-opcua-client")
    async with serving(Asset(), folder, store, outbox) as address:
        ran = await asyncio.to_thread(
            subprocess.run,
            [node, HERE / "history.js", address, node_id(RING), BEGIN, END, str(page)],
            cwd=HERE,
            capture_output=True,
            text=True,
            timeout=patience(300),
            check=False,
        )
    assert ran.returncode == 0, ran.stderr
    # The library tells of itself on the same stream.
    (line,) = [one for one in ran.stdout.splitlines() if one.startswith("{")]
    found: dict[str, Any] = json.loads(line)
    return found


@pytest.mark.wires
async def test_node_opcua_reads_samples_aggregates_and_single_times(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    fill_seconds(store, BEGIN_US + 123_000, 25)
    found = await read(tmp_path, store, outbox, page=7)
    begin_ms = BEGIN_US // 1000
    expected = [[begin_ms + 1000 * k + 123, 20.0 + k, "Good"] for k in range(25)]
    expected[5][1:] = [None, "BadSensorFailure"]
    expected[7][2] = "Uncertain"
    assert found["values"] == expected
    assert (found["pages"], found["accessLevel"]) == (4, 0b101)  # read now, read the history
    good = [20, 21, 22, 23, 24, 26, 28, 29]
    means = [sum(good) / len(good), 34.5, 42.0]
    starts = [begin_ms + 10_000 * k for k in range(3)]
    for name, values in (
        ("Average", means),
        ("Minimum", [20.0, 30.0, 40.0]),
        ("Maximum", [29.0, 39.0, 44.0]),
        ("Count", [8, 10, 5]),
    ):
        shown = [[start, value] for start, value in zip(starts, values, strict=True)]
        assert [one[:2] for one in found["aggregates"][name]] == shown
    assert [one[:2] for one in found["atTimes"]] == [
        [begin_ms + 4000, 23.0],
        [begin_ms - 1000, None],
    ]
    assert found["written"] != "Good"


@pytest.mark.wires
async def test_node_opcua_reads_a_day_at_once(tmp_path: Path, store: Store, outbox: Outbox) -> None:
    fill_seconds(store, BEGIN_US, 86_400)
    found = await read(tmp_path, store, outbox, page=0)
    assert (found["count"], found["pages"]) == (86_400, 9)
    print(f"a day at 1 Hz: {found['seconds']:.2f} s")  # noqa: T201 - a figure, with pytest -s
