"""Looks all the time whether the answers are right while parts of the fleet are away."""

import asyncio
import contextlib
import itertools
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final

import httpx2
import websockets

from bearing_twin_laboratory.fleet_demo.alarms import Alarms, hot_alarms
from service.bus.replica import UNCERTAIN_AFTER_S

_EVERY_S: Final = 0.2
_ALARMS_EVERY_S: Final = 0.5
_PATIENCE_S: Final = 10.0
#: A verdict that is older than this must not be called safe: data are uncertain after 5 s, and a
#: busy machine takes its time.
OLD_S: Final = 20.0
_OK, _NOT_NOW = 200, 503


@dataclass
class Seen:
    """How the web processes answered."""

    fresh: int = 0
    marked_old: int = 0
    try_again: int = 0
    unreachable: int = 0
    wrong: list[str] = field(default_factory=list)
    #: Of when the last answer was that is certain, by asset, on the monotonic clock.
    fresh_s: dict[str, float] = field(default_factory=dict)

    def counts(self) -> dict[str, int]:
        """How many of each."""
        return {
            "fresh": self.fresh,
            "marked_old": self.marked_old,
            "try_again": self.try_again,
            "unreachable": self.unreachable,
        }


class Watcher:
    """Asks for verdicts and snapshots of all assets, one after the other, of all web processes.

    - ``addresses``: of the web processes.
    - ``key``: API key.
    - ``assets``: whom to ask for.
    - ``is_up``: whether a web process, by its place, is meant to answer.

    - ``alarms``: what every answer must give from now on; None: anything.
    """

    def __init__(
        self,
        addresses: Sequence[str],
        key: str,
        assets: Sequence[str],
        is_up: Callable[[int], bool],
    ) -> None:
        self.seen = Seen()
        self.alarms: Alarms | None = None
        self._addresses = addresses
        self._headers = {"X-API-Key": key}
        self._assets = assets
        self._is_up = is_up

    async def run(self) -> None:
        """Look until cancelled."""
        async with (
            httpx2.AsyncClient(headers=self._headers, timeout=_PATIENCE_S) as client,
            asyncio.TaskGroup() as tasks,
        ):
            for place in range(len(self._addresses)):
                tasks.create_task(self._look(client, place))
                tasks.create_task(self._look_at_alarms(client, place))

    async def _look(self, client: httpx2.AsyncClient, place: int) -> None:
        for asset in itertools.cycle(self._assets):
            for what in ("verdict", "snapshot"):
                url = f"{self._addresses[place]}api/v1/assets/{asset}/{what}"
                was_up = self._is_up(place)
                try:
                    answer = await client.get(url)
                except httpx2.TransportError as error:
                    self.seen.unreachable += 1
                    if was_up and self._is_up(place):
                        self.seen.wrong.append(f"{what} of {asset}: {error!r}")
                else:
                    self._judge(asset, what, answer)
            await asyncio.sleep(_EVERY_S)

    async def _look_at_alarms(self, client: httpx2.AsyncClient, place: int) -> None:
        while True:
            await asyncio.sleep(_ALARMS_EVERY_S)
            if self.alarms is None:
                continue
            try:
                answer = await client.get(f"{self._addresses[place]}api/v1/alarms")
            except httpx2.TransportError:
                continue  # the reader of the values judges that
            if answer.status_code == _OK:
                found = hot_alarms(answer.json(), {asset for asset, _ in self.alarms})
                if found != self.alarms:
                    changed = sorted(set(found.items()) ^ set(self.alarms.items()))
                    self.seen.wrong.append(f"alarms of web {place + 1}: {changed}")
            elif answer.status_code != _NOT_NOW or "Retry-After" not in answer.headers:
                self.seen.wrong.append(f"alarms of web {place + 1}: status {answer.status_code}")

    def _judge(self, asset: str, what: str, answer: httpx2.Response) -> None:
        seen = self.seen
        if answer.status_code == _NOT_NOW and "Retry-After" in answer.headers:
            seen.try_again += 1
            return
        if answer.status_code != _OK:
            seen.wrong.append(f"{what} of {asset}: status {answer.status_code} {answer.text[:200]}")
            return
        document = answer.json()
        if what == "snapshot":
            age_s = float(answer.headers.get("Age", 0.0))
            if age_s > UNCERTAIN_AFTER_S:
                seen.marked_old += 1
            else:
                seen.fresh += 1
                seen.fresh_s[asset] = time.monotonic() - age_s
            return
        why = wrong_verdict(document, time.time())
        if why:
            seen.wrong.append(f"verdict of {asset}: {why}")
        elif any("no data of the twin" in reason for reason in document["now"]["reasons"]):
            seen.marked_old += 1
        else:
            seen.fresh += 1


def wrong_verdict(document: Any, now_s: float) -> str:
    """Say what is wrong with a verdict: safe, and yet nothing fresh stands behind it."""
    words = {document[name]["word"] for name in ("now", "present_step", "next_step")}
    age_s = now_s - datetime.fromisoformat(document["time"]).timestamp()
    if "safe" not in words:
        return ""
    if "twin" in document["missing"]:
        return "safe without the twin"
    return f"safe, {age_s:.0f} s old" if age_s > OLD_S else ""


@dataclass
class Followed:
    """What came over the stream."""

    messages: int = 0
    connections: int = 0
    gaps_told: int = 0
    longest_silence_s: float = 0.0
    last_s: float = field(default_factory=time.monotonic)
    wrong: list[str] = field(default_factory=list)


class StreamReader:
    """Follows live messages of some assets; goes to the next web process when one is away.

    - ``addresses``: of the web processes.
    - ``key``: API key.
    - ``assets``: whom to follow.
    """

    def __init__(self, addresses: Sequence[str], key: str, assets: Sequence[str]) -> None:
        self.followed = Followed()
        self._addresses = [address.replace("http", "ws", 1) for address in addresses]
        self._headers = {"X-API-Key": key}
        self._assets = ",".join(assets)

    async def run(self) -> None:
        """Follow until cancelled."""
        resume = ""
        for address in itertools.cycle(self._addresses):
            url = f"{address}api/v1/stream?assets={self._assets}{resume}"
            with contextlib.suppress(OSError, TimeoutError, websockets.WebSocketException):
                async with websockets.connect(url, additional_headers=self._headers) as stream:
                    self.followed.connections += 1
                    last = 0
                    async for text in stream:
                        message = json.loads(text)
                        self._take(message, last)
                        last = message["seq"]
                        resume = f"&resume={last}&epoch={message['epoch']}"
            await asyncio.sleep(_EVERY_S)

    def _take(self, message: Any, last: int) -> None:
        followed, now_s = self.followed, time.monotonic()
        if message["type"] == "hello":
            followed.gaps_told += message["gap"]
        elif message["seq"] < last:  # some go beside the numbered ones, with the latest number
            followed.wrong.append(f"message {message['seq']} after {last}")
        if message["type"] not in ("hello", "heartbeat"):
            followed.messages += 1
            silence_s = now_s - followed.last_s
            followed.longest_silence_s = max(followed.longest_silence_s, silence_s)
            followed.last_s = now_s
