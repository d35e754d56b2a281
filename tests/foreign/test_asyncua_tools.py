"""The command line tools of asyncua read a value and a history."""

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest
from opcua_site import RING, Asset, node_id, serving
from patience import patience

from adapters.samples import Sample
from service.store import Outbox, Store

TOOLS = Path(sys.executable).parent


async def run(tool: str, address: str, *arguments: str) -> str:
    ran = await asyncio.to_thread(
        subprocess.run,
        [TOOLS / tool, "-u", address, "-n", node_id(RING), *arguments],
        capture_output=True,
        text=True,
        timeout=patience(120),
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.mark.wires
async def test_a_value_and_a_history_are_read(tmp_path: Path, store: Store, outbox: Outbox) -> None:
    begin_us = 1_767_225_600_000_000
    store.samples.write(
        [Sample("bench-1", RING, begin_us + k * 1_000_000, 20.5 + k, 192, 0) for k in range(3)]
    )
    async with serving(Asset(), tmp_path, store, outbox) as address:
        assert "61.5" in await run("uaread", address)
        span = ("--starttime", "2026-01-01 00:00", "--endtime", "2026-01-02 00:00")
        told = await run("uahistoryread", address, *span)
    lines = [line.split()[-2:] for line in told.splitlines()[-3:]]
    assert lines == [["Good", "20.5"], ["Good", "21.5"], ["Good", "22.5"]]
