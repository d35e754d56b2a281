"""The outside ledger: what was pushed and acknowledged, against what the store holds."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, Final

import httpx2

from bearing_twin_laboratory.fleet_demo.site import BASE, HOT_C, HOT_CHANNEL, PUSHED_CHANNEL
from service.clock import wall_us
from service.store import Store

#: Samples of a push, and wall seconds between two pushes to one asset.
_BATCH: Final = 5
_EVERY_S: Final = 0.5
_AGAIN_S: Final = 0.1
_PATIENCE_S: Final = 15.0
_MOST: Final = 10_000_000


@dataclass(frozen=True, slots=True)
class Count:
    """What became of the numbered samples."""

    acknowledged: int
    stored: int
    missing: int
    stored_twice: int
    out_of_order: int

    @property
    def is_clean(self) -> bool:
        """Whether nothing acknowledged is missing, stored twice or out of order."""
        return not (self.missing or self.stored_twice or self.out_of_order)


class Pusher:
    """Pushes numbered samples to each of some assets; the same until they are acknowledged.

    - ``addresses``: of the web processes; one that does not answer, or refuses, is left for the
      next.
    - ``key``: API key.
    - ``assets``: whom to push to.

    - ``acknowledged``: numbers by asset.
    - ``refused``: pushes that had to be repeated.
    - ``rejected``: samples that were refused for good; none should be.
    """

    def __init__(self, addresses: Sequence[str], key: str, assets: Sequence[str]) -> None:
        self.acknowledged: dict[str, list[int]] = {asset: [] for asset in assets}
        self.refused = 0
        self.rejected = 0
        self._addresses = addresses
        self._headers = {"X-API-Key": key}
        self._began_us = wall_us()
        self._stop = asyncio.Event()

    def stop(self) -> None:
        """Begin no more pushes; `run` ends when the last is acknowledged."""
        self._stop.set()

    async def run(self) -> None:
        """Push until the stop."""
        async with (
            httpx2.AsyncClient(headers=self._headers, timeout=_PATIENCE_S) as client,
            asyncio.TaskGroup() as tasks,
        ):
            for place, asset in enumerate(self.acknowledged):
                tasks.create_task(self._feed(client, asset, place))

    async def _feed(self, client: httpx2.AsyncClient, asset: str, place: int) -> None:
        number = 0
        while not self._stop.is_set():
            numbers = range(number, number + _BATCH)
            number += _BATCH
            body = {"samples": _samples(numbers, wall_us())}
            while not await self._is_taken(client, asset, place, body):
                self.refused += 1
                place += 1
                await asyncio.sleep(_AGAIN_S)
            self.acknowledged[asset] += numbers
            await asyncio.sleep(_EVERY_S)

    async def _is_taken(
        self, client: httpx2.AsyncClient, asset: str, place: int, body: dict[str, Any]
    ) -> bool:
        address = self._addresses[place % len(self._addresses)]
        try:
            answer = await client.post(f"{address}api/v1/assets/{asset}/measurements", json=body)
        except httpx2.TransportError:  # it may have been taken: the same is sent again
            return False
        if answer.status_code != httpx2.codes.OK:
            return False
        self.rejected += len(answer.json()["rejected"])
        return True

    def count(self, store: Store) -> Count:
        """Compare with the store."""
        found = [self._count(store, asset, sent) for asset, sent in self.acknowledged.items()]
        return Count(*(sum(column) for column in zip(*found, strict=True)))

    def _count(
        self, store: Store, asset: str, sent: Sequence[int]
    ) -> tuple[int, int, int, int, int]:
        rows = store.samples.read(asset, [PUSHED_CHANNEL], self._began_us, 2**62, _MOST)
        wanted = set(sent)
        values = (round((one.value - BASE) * 1000) for one in rows if one.value is not None)
        numbers = [number for number in values if number in wanted]
        stored = set(numbers)
        late = sum(after <= before for before, after in pairwise(numbers))
        twice = len(numbers) - len(stored)
        return len(sent), len(stored), len(wanted - stored), twice, late


def _samples(numbers: Sequence[int], at_us: int) -> list[dict[str, object]]:
    """A batch: numbered values a millisecond apart, and a temperature above its limit."""
    times = [
        datetime.fromtimestamp((at_us + 1000 * place) / 1e6, UTC).isoformat()
        for place in range(len(numbers))
    ]
    samples: list[dict[str, object]] = [
        {"channel": PUSHED_CHANNEL, "time": time, "value": BASE + number / 1000}
        for number, time in zip(numbers, times, strict=True)
    ]
    hot_c = HOT_C + numbers[0] % 7 / 10  # never a flat line
    return [*samples, {"channel": HOT_CHANNEL, "time": times[0], "value": hot_c}]
