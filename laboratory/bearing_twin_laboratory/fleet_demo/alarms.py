"""Alarms that must outlive the cell that raised them."""

import asyncio
import contextlib
import time
from collections.abc import Collection, Sequence
from typing import Any, Final

import httpx2

from bearing_twin_laboratory.fleet_demo.site import HOT_CHANNEL
from service.demo.processes import DemoError
from service.store import JournalFilter, Store, StoreUnavailableError

KIND: Final = "measured limit"
#: A busy machine takes its time.
_PATIENCE_S: Final = 600.0
_LINES_MAX: Final = 100_000
#: Wall seconds in which open alarms of store and owners agree at least once.
_AGREE_S: Final = 60.0

#: State of each alarm by asset and id.
Alarms = dict[tuple[str, str], str]


async def open_alarms(client: httpx2.AsyncClient, assets: Collection[str]) -> Alarms:
    """Give the alarms of the pushed temperatures as a web process lists them.

    Raises `httpx2.HTTPError` if it does not.
    """
    answer = await client.get("/api/v1/alarms")
    answer.raise_for_status()
    return hot_alarms(answer.json(), assets)


def hot_alarms(document: Any, assets: Collection[str]) -> Alarms:
    """Give the alarms of the pushed temperatures in a list of alarms."""
    return {
        (one["asset"], one["id"]): one["state"]
        for one in document["items"]
        if one["asset"] in assets and (one["kind"], one["channel"]) == (KIND, HOT_CHANNEL)
    }


async def raise_and_acknowledge(client: httpx2.AsyncClient, assets: Sequence[str]) -> Alarms:
    """Wait until each asset has its alarm, and acknowledge every second one.

    Raises `DemoError` if they do not come.
    """
    deadline_s = time.monotonic() + _PATIENCE_S
    found: Alarms = {}
    while time.monotonic() < deadline_s:
        with contextlib.suppress(httpx2.HTTPError):
            found = await open_alarms(client, assets)
            if {asset for asset, _ in found} == set(assets):
                break
        await asyncio.sleep(0.5)
    else:
        raise DemoError(f"{len(found)} of {len(assets)} alarms after {_PATIENCE_S:g} s")
    known = sorted(found)[::2]
    body = {"ids": [id for _, id in known], "comment": "seen before anything was killed"}
    while time.monotonic() < deadline_s:
        # A cell that is busy may be asked again (503); what is acknowledged stays so.
        with contextlib.suppress(httpx2.HTTPError):
            await client.post("/api/v1/alarms/acknowledge", json=body)
            found = await open_alarms(client, assets)
            if all(found.get(one) == "ACKED" for one in known):
                return found
        await asyncio.sleep(0.5)
    raise DemoError(f"alarms are not acknowledged after {_PATIENCE_S:g} s")


async def until_same(client: httpx2.AsyncClient, before: Alarms) -> float:
    """Wait until the alarms are those of before, with their states; wall seconds that it took.

    Raises `DemoError` if they do not become so.
    """
    began_s = time.monotonic()
    assets = {asset for asset, _ in before}
    now: Alarms = {}
    while (passed_s := time.monotonic() - began_s) < _PATIENCE_S:
        with contextlib.suppress(httpx2.HTTPError):
            now = await open_alarms(client, assets)
            if now == before:
                return passed_s
        await asyncio.sleep(0.5)
    changed = sorted(set(now.items()) ^ set(before.items()))
    raise DemoError(f"alarms are not those of before: {changed[:5]}")


async def disagreement(client: httpx2.AsyncClient, store: Store) -> list[str]:
    """Compare the open alarms of the store with those of the owners; give what differs.

    A change is in the memory of its owner before it is in the store, so that both are read again
    until they agree, for a while.
    """
    began_s = time.monotonic()
    differing: list[str] = []
    while time.monotonic() - began_s < _AGREE_S:
        try:
            before = await asyncio.to_thread(store.alarms.load)
            answer = await client.get("/api/v1/alarms")
            answer.raise_for_status()
        except (httpx2.HTTPError, StoreUnavailableError) as error:
            differing = [repr(error)]
        else:
            stored = {f"{one.asset} {one.id} {one.state}" for one in before}
            owned = {f"{one['asset']} {one['id']} {one['state']}" for one in answer.json()["items"]}
            differing = [
                *(f"only in the store: {one}" for one in sorted(stored - owned)),
                *(f"only at its owner: {one}" for one in sorted(owned - stored)),
            ]
            if not differing:
                return []
        await asyncio.sleep(0.5)
    return differing


def raised_again(store: Store, alarms: Alarms) -> int:
    """How many times these alarms were raised beyond the first time, as the journal says."""
    raises = 0
    for asset in {asset for asset, _ in alarms}:
        lines = store.alarms.journal(JournalFilter(asset=asset), _LINES_MAX).items
        raises += sum(
            (one.kind, one.channel, one.event) == (KIND, HOT_CHANNEL, "raise") for one in lines
        )
    return raises - len(alarms)
