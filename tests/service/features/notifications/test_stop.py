"""Notifications stop at once, also in the moment in which a receiver answers."""

import asyncio
from typing import Any

import pytest
from alarm_bench import Bench
from patience import within
from receivers import Hook

from service.features.notifications.messages import OutgoingMessage

from .notified import Notified, site

pytestmark = pytest.mark.wires


class Swallowing:
    """Sends as `aiosmtplib` does when the answer comes together with a cancellation."""

    def __init__(self) -> None:
        self.sends, self.sent = asyncio.Event(), 0

    async def send(self, message: OutgoingMessage) -> str:
        self.sends.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            self.sent += 1
        return "ok"

    async def close(self) -> None:
        """Nothing is open."""


async def test_a_cancellation_that_a_library_swallows_ends_it_all_the_same(
    bench: Bench, hook: Hook
) -> None:
    notified = Notified(bench, site(hook))
    await notified.__aenter__()
    queue: Any = notified.notifier._queues["hook"]
    queue._sender = sender = Swallowing()
    notified.raise_alarm()
    await sender.sends.wait()
    async with within(10):
        await notified.__aexit__()
    assert sender.sent == 1
    assert not queue.notifications[next(iter(queue.notifications))].pending, "it is known as sent"
