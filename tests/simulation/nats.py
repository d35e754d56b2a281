"""NATS as it is between a web process and cells: it loses what a real one loses."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

from service.bus import nats_bus

_TRAVEL_S = 0.002


class Nats:
    """Brings messages to those who listen at that moment; keeps nothing."""

    def __init__(self) -> None:
        self.connections: list[Connection] = []
        self.is_down = False

    def carry(self, subject: str, body: bytes, reply: str) -> None:
        if self.is_down:
            return
        for one in self.connections:
            if one.connected:
                one.receive(subject, body, reply)


class Connection:
    """Stands for `NatsConnection`."""

    def __init__(self, nats: Nats) -> None:
        self.nats = nats
        self.is_cut = self.is_paused = False
        self._takes: list[tuple[str, Any]] = []
        self._kept: deque[tuple[Any, Any]] = deque()
        self._tasks: set[asyncio.Task[None]] = set()
        nats.connections.append(self)

    @property
    def connected(self) -> bool:
        return not (self.nats.is_down or self.is_cut)

    def listen(self, subject: str, take: Any) -> None:
        self._takes.append((subject, take))

    async def follow(self, subject: str) -> AsyncIterator[bytes]:
        queue: asyncio.Queue[bytes] = asyncio.Queue()

        async def take(message: Any) -> None:
            queue.put_nowait(message.data)

        entry = (subject, take)
        self._takes.append(entry)
        try:
            while True:
                yield nats_bus.unpacked(await queue.get())
        finally:
            self._takes.remove(entry)

    def send(self, subject: str, body: bytes, reply: str = "") -> None:
        if self.connected and not self.is_paused:
            loop = asyncio.get_running_loop()
            loop.call_later(_TRAVEL_S, self.nats.carry, subject, body, reply)

    def receive(self, subject: str, body: bytes, reply: str) -> None:
        message = SimpleNamespace(subject=subject, data=body, reply=reply)
        for pattern, take in self._takes:
            stem = pattern.removesuffix("*")
            if subject == pattern or (stem != pattern and subject.startswith(stem)):
                self._kept.append((take, message))
        if not self.is_paused:
            self.go_on()

    def go_on(self) -> None:
        """Hand over what has come; what came in a pause too."""
        while self._kept:
            take, message = self._kept.popleft()
            task = asyncio.ensure_future(take(message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def run(self) -> None:
        await asyncio.Event().wait()

    def close(self) -> None:
        self.nats.connections.remove(self)
