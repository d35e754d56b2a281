"""Live messages that wait for one subscriber, and which of them go when it is slow."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from service.documents.messages import MessageType
from service.domain.errors import BearingTwinError

# What goes first when a subscriber is slow; a message of the last tier never goes.
_TIER: Mapping[MessageType, int] = {
    "heartbeat": 0,
    "measurement": 0,
    "state": 0,
    "forecast": 1,
    "health": 1,
    "verdict": 1,
    "alarm": 2,
    "job": 2,
}
_TIERS = 3
#: What is made only for those who follow the asset.
ON_DEMAND: frozenset[MessageType] = frozenset({"measurement", "state", "verdict", "forecast"})


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it goes out; the text is made once for all subscribers.

    Attributes
    ----------
    type
        What the data are.
    seq
        Number of the message, counted from 1 at the start of the service.
    asset
        Asset that it is about, None for the service as a whole.
    text
        The JSON text with type, seq, epoch, asset, time, sent_at and data.
    """

    type: MessageType
    seq: int
    asset: str | None
    text: str


class SubscriptionClosedError(BearingTwinError):
    """No more messages come; the text says why."""


class Subscription:
    """Messages that wait for one subscriber. Made by `LiveMessages.subscribe`; read in its loop.

    Attributes
    ----------
    start_seq
        Number after which this subscription goes on: the resume point, or the latest message.
    gap
        True when messages after the resume point are gone, so that a fresh snapshot is needed.
    dropped
        Messages left out so far because the subscriber was slow.
    missed
        Messages after the resume point that were waiting at the beginning.
    """

    def __init__(
        self,
        lock: threading.RLock,
        forget: "Callable[[Subscription], None]",
        assets: frozenset[str] | None,
        start_seq: int,
        gap: bool,
        capacity: int,
        types: frozenset[MessageType] | None = None,
        live: frozenset[str] | None = None,
    ) -> None:
        self.start_seq = start_seq
        self.gap = gap
        self.dropped = 0
        self.missed = 0
        self._lock = lock
        self._forget = forget
        self._assets = assets
        self._types = types
        self._live = assets if live is None else live
        self._capacity = capacity
        self._tiers: tuple[deque[Message], ...] = tuple(deque() for _ in range(_TIERS))
        self._closed: str | None = None
        self._loop = asyncio.get_running_loop()
        self._thread = threading.get_ident()
        self._something = asyncio.Event()

    @property
    def followed(self) -> frozenset[str] | None:
        """Assets whose live messages are wanted; None for all."""
        live = self._types is None or not self._types.isdisjoint(ON_DEMAND)
        return self._live if live else frozenset()

    def wants(self, message: Message) -> bool:
        """Return whether the message is about one of the assets asked for, or about all."""
        if self._types is not None and message.type not in self._types:
            return False
        wanted = self._live if message.type in ON_DEMAND else self._assets
        return message.asset is None or wanted is None or message.asset in wanted

    async def get(self) -> Message:
        """Wait for the next message, in order of number.

        Raises
        ------
        SubscriptionClosedError
            When the subscription was closed and what had been waiting is read.
        """
        while True:
            message = self._take()
            if message is not None:
                return message
            if self._closed is not None:
                raise SubscriptionClosedError(self._closed)
            await self._something.wait()

    def close(self, reason: str = "closed") -> None:
        """End the subscription; a waiting `get` raises once the queue is empty."""
        self._forget(self)
        self.end(reason)

    def _take(self) -> Message | None:
        with self._lock:
            waiting = [tier for tier in self._tiers if tier]
            if waiting:
                return min(waiting, key=lambda tier: tier[0].seq).popleft()
            if self._closed is None:
                self._something.clear()
            return None

    def put(self, message: Message) -> bool:
        """Queue a message (the bus holds the lock); False when the subscriber must be cut off."""
        self._tiers[_TIER[message.type]].append(message)
        if sum(map(len, self._tiers)) > self._capacity:
            victims = next((tier for tier in self._tiers[:-1] if tier), None)
            if victims is None:
                return False
            victims.popleft()
            self.dropped += 1
        return True

    def end(self, reason: str) -> None:
        """Let no more messages come; those that wait can be read."""
        if self._closed is None:
            self._closed = reason
        self.wake()

    def wake(self) -> None:
        """Let the reader look again."""
        if threading.get_ident() == self._thread:
            self._something.set()
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._something.set)
