"""The address of a fleet's PostgreSQL leads to an older copy: cells, web processes, pushers."""

import asyncio
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from patience import patience, wait_for
from programs import missing

from bearing_twin_laboratory.fleet_demo.site import BASE, PUSHED_CHANNEL
from bearing_twin_laboratory.fleet_demo.stand import CELLS, Stand, running_stand
from service.demo.processes import DemoError

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900), pytest.mark.endurance]
PATIENCE_S = 120.0


async def test_cells_keep_what_they_get_until_a_person_confirms_the_store() -> None:
    with tempfile.TemporaryDirectory(prefix="bt-", ignore_cleanup_errors=True) as folder:
        try:
            async with running_stand(
                Path(folder), benches=4, pushed=4, nights=0, ports=(0, 0), report=print
            ) as stand:
                await _fail_over(stand)
        except DemoError as error:
            if "is missing" in str(error):
                missing("pip install 'bearing-twin[fleet,servers]'")
            raise


async def _fail_over(stand: Stand) -> None:
    server, copy = stand.database._server, stand.folder / "copy"
    await asyncio.to_thread(server.stop)
    # With its owner: as root the server runs as a user of its own.
    await asyncio.to_thread(subprocess.run, ["cp", "-a", server.pgdata, copy], check=True)
    await asyncio.to_thread(server.start)
    await stand.witness.until_owned(least_cells=CELLS)
    await stand.until_fresh(time.monotonic())
    await _until_all_pushed(stand)
    await asyncio.to_thread(server.stop)
    await asyncio.sleep(3.0)  # what was stored there by then is acknowledged
    since = {asset: len(numbers) for asset, numbers in stand.pusher.acknowledged.items()}
    _lead_to(copy, Path(server.pgdata))
    await asyncio.to_thread(server.start)

    await _until_store(stand, "degraded", "an older copy")
    refused = stand.pusher.refused
    await _until_all_pushed(stand)
    assert stand.pusher.refused == refused, "a push was refused while a person is asked"
    assert (await _store_check(stand))[0] == "degraded"

    confirm = [sys.executable, "-m", "service", "db", "confirm", "-c", str(stand.configuration)]
    await asyncio.to_thread(subprocess.run, confirm, check=True, timeout=patience(PATIENCE_S))
    await _until_store(stand, "ok", "")
    await _until_all_pushed(stand)
    stand.pusher.stop()
    await wait_for(stand.pushing, PATIENCE_S)
    wanted = {
        asset: numbers[since[asset] :] for asset, numbers in stand.pusher.acknowledged.items()
    }
    assert all(wanted.values())
    await _until(lambda: not _missing(stand, wanted), "all is stored")
    for asset, numbers in _stored(stand).items():
        assert max(Counter(numbers).values()) == 1, f"{asset} has a number twice"
        assert numbers == sorted(numbers), f"{asset} has numbers of another"


def _lead_to(copy: Path, place: Path) -> None:
    place.rename(place.with_name("left"))
    copy.rename(place)


def _stored(stand: Stand) -> dict[str, list[int]]:
    with stand.open_store() as store:
        return {
            asset: [
                round((one.value - BASE) * 1000)
                for one in store.samples.read(asset, [PUSHED_CHANNEL], 0, 2**62, 10**6)
                if one.value is not None
            ]
            for asset in stand.pushed
        }


def _missing(stand: Stand, wanted: dict[str, list[int]]) -> dict[str, set[int]]:
    stored = _stored(stand)
    found = {asset: set(numbers) - set(stored[asset]) for asset, numbers in wanted.items()}
    return {asset: numbers for asset, numbers in found.items() if numbers}


async def _store_check(stand: Stand) -> tuple[str, str]:
    async with stand.client() as client:
        answer = await client.get("/readyz")
    checks = {one["name"]: one for one in answer.json()["checks"]}
    one = checks.get("store", {"status": "", "detail": ""})
    return one["status"], one["detail"] or ""


async def _until_store(stand: Stand, status: str, words: str) -> None:
    began_s, found = time.monotonic(), ("", "")
    while not (found[0] == status and words in found[1]):
        assert time.monotonic() - began_s < PATIENCE_S, f"{found}, expected {status}"
        await asyncio.sleep(0.2)
        found = await _store_check(stand)


async def _until_all_pushed(stand: Stand) -> None:
    """Every pusher has some more acknowledged."""
    before = {asset: len(numbers) for asset, numbers in stand.pusher.acknowledged.items()}
    await _until(
        lambda: all(
            len(stand.pusher.acknowledged[asset]) >= count + 15 for asset, count in before.items()
        ),
        "pushes are acknowledged",
    )


async def _until(look: Callable[[], bool], what: str) -> None:
    began_s = time.monotonic()
    while not await asyncio.to_thread(look):
        assert time.monotonic() - began_s < PATIENCE_S, f"not within {PATIENCE_S:g} s: {what}"
        await asyncio.sleep(0.5)
