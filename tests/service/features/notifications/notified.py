"""An alarm book whose alarms are sent to the receivers of a test."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from email.message import Message
from inspect import isawaitable
from pathlib import Path
from typing import Any

import pytest
from alarm_bench import COLD, HOT, Bench
from prometheus_client import CollectorRegistry
from receivers import PASSWORD, Hook, Mailbox

from service.alarms import AlarmBook
from service.features.notifications.part import Notifier
from service.features.silences.part import KnownSilences
from service.site.settings import Settings

PATIENCE_S = 60.0


class CountingNotifier(Notifier):
    """Counts its looks for what time brings."""

    looks = 0

    async def _look(self) -> None:
        await super()._look()
        self.looks += 1


class Notified:
    """An alarm book whose alarms are sent, on the store of a bench, unless they are silenced."""

    def __init__(self, bench: Bench, settings: Settings, *, loaded_by_us: int | None = 0) -> None:
        self.bench, self.settings, self.loaded_by_us = bench, settings, loaded_by_us

    async def __aenter__(self) -> "Notified":
        bench = self.bench
        self.book = AlarmBook(
            bench.outbox, bench.clock, lambda alarm: self.notifier.alarm_changed(alarm),
            loaded_by_us=self.loaded_by_us,
        )  # fmt: skip
        silences = KnownSilences(
            bench.store, bench.clock, bench.outbox, loaded_by_us=self.loaded_by_us
        )
        self.notifier = CountingNotifier(
            self.settings, bench.store, bench.outbox, bench.clock,
            lambda asset: (f"Bench {asset}", "Motor 2019"), self.book, lambda: silences,
            CollectorRegistry(), self.loaded_by_us,
        )  # fmt: skip
        self.parts, self.failed = (silences, self.notifier), asyncio.Event()
        await asyncio.to_thread(silences.read_store)
        await asyncio.to_thread(self.notifier.take_over)
        self.book.keep_moved()
        for part in self.parts:
            part.keep_moved()
        for part in self.parts:
            await part.start(self.failed)
        return self

    async def __aexit__(self, *error: object) -> None:
        for part in self.parts:
            await part.stop()
        assert not self.failed.is_set()

    def raise_alarm(self, **changes: Any) -> str:
        condition = replace(HOT, **changes)
        self.book.evaluate(condition)
        self.bench.clock.advance(condition.on_delay_s)
        self.book.evaluate(condition)
        found = [one for one in self.book.active(condition.asset) if one.kind == condition.kind]
        return found[0].id

    async def held(self) -> int:
        (state, *_) = await self.notifier.states()
        return state.held

    async def tries(self) -> int:
        (state, *_) = await self.notifier.states()
        return state.tries

    def end_alarm(self, **changes: Any) -> None:
        self.book.evaluate(replace(COLD, **changes))
        self.bench.clock.advance(COLD.off_delay_s)
        self.book.evaluate(replace(COLD, **changes))


@pytest.fixture
def bench(tmp_path: Path, prompt: None) -> Any:
    bench = Bench(tmp_path / "data")
    yield bench
    bench.close()


def site(hook: Hook | None = None, mailbox: Mailbox | None = None, **more: Any) -> Settings:
    notifications: list[dict[str, Any]] = []
    smtp: dict[str, Any] = {}
    if hook is not None:
        notifications.append({"id": "hook", "kind": "webhook", "url": hook.url, "interval_s": 0})
    if mailbox is not None:
        to = ["a@example.com", "b@example.com"]
        notifications.append({"id": "mail", "kind": "email", "to": to, "interval_s": 0})
        smtp = {
            "host": "localhost", "port": mailbox.port, "username": "twin", "password": PASSWORD,
            "sender": "twin@example.com", "ca_file": str(mailbox.ca_file),
        }  # fmt: skip
    notifications[0] |= more
    return Settings(notifications=tuple(notifications), smtp=smtp)  # type: ignore[arg-type]


async def until(holds: Callable[[], Any], what: str) -> Any:
    for _ in range(round(PATIENCE_S / 0.02)):
        found = holds()
        if isawaitable(found):
            found = await found
        if found:
            return found
        await asyncio.sleep(0.02)
    raise AssertionError(f"{what} did not happen in {PATIENCE_S:g} s")


async def looked(notified: Notified, times: int) -> None:
    """Wait until it has taken in what came before, and looked for what time brings."""
    looks = notified.notifier.looks + times
    await until(lambda: notified.notifier.looks >= looks, "looks")


async def quiet(notified: Notified) -> None:
    """Wait until all that may be sent now has been sent."""
    await looked(notified, 2)

    async def all_is_sent() -> bool:
        return all(one.waiting == one.held for one in await notified.notifier.states())

    await until(all_is_sent, "all is sent")


def events(hook: Hook) -> list[tuple[str, str]]:
    return [
        (event["event"], event["id"])
        for _, _, body in hook.taken
        for event in json.loads(body)["events"]
    ]


def text_of(message: Message) -> str:
    text = message.get_content()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


def refuses(hook: Hook, is_refused: Callable[[list[dict[str, Any]]], int]) -> None:
    """Let a receiver refuse posts for what they say."""
    hook.judge = lambda body: is_refused(json.loads(body)["events"])
