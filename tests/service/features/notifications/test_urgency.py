"""Priority 1 stands behind nothing that a receiver did not take."""

import asyncio
import json
import threading
from typing import Any

import pytest
from alarm_bench import Bench
from receivers import Hook, Mailbox

from service.features.notifications import mail, notification_queue
from service.features.silences.tables import Silence, Silences

from .notified import PATIENCE_S, Notified, events, looked, quiet, refuses, site, text_of, until

pytestmark = pytest.mark.wires


@pytest.mark.parametrize("why", ["an address", "all", "the server"])
async def test_priority_1_waits_for_no_back_off_of_an_earlier_message(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 3600.0)
    monkeypatch.setattr(notification_queue, "RETRY_LAST_S", 3600.0)
    answers = {"b@example.com": ["450 greylisted"] * 99}
    if why == "all":
        answers["a@example.com"] = ["450 greylisted"]
    mailbox.answers = answers
    settings = site(mailbox=mailbox)
    if why == "the server":
        mailbox.judge = lambda message: "421 closing" if "kind 0," in text_of(message) else "250 ok"
        mailbox.answers = {}
    async with Notified(bench, settings) as notified:
        notified.raise_alarm(kind="kind 0", priority=1)
        await until(notified.tries, "the back-off")
        earlier = len(mailbox.got)
        low = notified.raise_alarm(kind="low", priority=3)
        for number in range(1, 4):
            notified.raise_alarm(kind=f"kind {number}", priority=1)
            await until(
                lambda number=number: (
                    mailbox.got  # type: ignore[misc]
                    and f"kind {number}," in text_of(mailbox.got[-1][1])
                ),
                "the urgent one",
            )
        await looked(notified, 5)
        texts = [text_of(message) for _, message in mailbox.got[earlier:]]
        assert len(texts) == 3, "each was tried once"
        assert low
    if why != "the server":
        assert len(answers["b@example.com"]) == 99 - 4


async def test_urgent_mails_that_an_address_postpones_reach_all_once(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mail, "_PATIENCE", 3)
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 3600.0)
    later = mailbox.answers["b@example.com"] = ["450 greylisted"] * 99
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(6):
            notified.raise_alarm(kind=f"kind {number}", priority=1)
            await until(lambda number=number: len(mailbox.got) == number + 1, "one")  # type: ignore[misc]
        later.clear()  # as greylisting ends, after fewer tries of one message than are its patience
        notified.raise_alarm(kind="kind 6", priority=1)  # ends the back-off
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = "".join(text_of(m) for recipients, m in mailbox.got if address in recipients)
        for number in range(7):
            assert texts.count(f"  kind {number},") == 1, (address, number)


async def test_urgent_posts_of_an_outage_go_out_together_after_it(bench: Bench, hook: Hook) -> None:
    fails = True
    refuses(hook, lambda events: 503 if fails else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(5):
            notified.raise_alarm(kind=f"kind {number}", priority=1)
            await until(
                lambda number=number: (
                    hook.posts  # type: ignore[misc]
                    and f"kind {number}" in hook.posts[-1][2].decode()
                ),
                "its try",
            )
        fails = False
        await quiet(notified)
    assert len({id for _, id in events(hook)}) == len(events(hook)) == 5
    assert len(hook.taken) <= 2


async def test_priority_1_does_not_stand_behind_a_post_that_fails(bench: Bench, hook: Hook) -> None:
    refuses(hook, lambda events: 503 if any(e["alarm"]["priority"] == 3 for e in events) else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(5):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await until(lambda: len(hook.posts) > 1, "two tries")
        urgent = notified.raise_alarm(asset="bench-2")
        await until(lambda: events(hook) == [("raised", f"{urgent}:raised:1")], "the urgent one")
        failed = {h["webhook-id"] for status, h, _ in hook.posts if status == 503}
        await until(lambda: hook.posts[-1][0] == 503, "another try of the rest")
        assert hook.posts[-1][1]["webhook-id"] in failed, "the same message as before"
        hook.judge = None
        await quiet(notified)
    assert len(events(hook)) == 6


async def test_priority_1_does_not_stand_behind_what_is_refused_one_by_one(
    bench: Bench, hook: Hook
) -> None:
    refuses(hook, lambda events: 204 if any(e["alarm"]["priority"] == 1 for e in events) else 500)
    async with Notified(bench, site(hook)) as notified:
        for number in range(24):
            notified.raise_alarm(kind=f"kind {number}", priority=3)

        def sizes() -> list[int]:
            return [len(json.loads(body)["events"]) for _, _, body in hook.posts]

        await until(lambda: sizes().count(1) > 2, "refusals of one alarm")
        before = len(hook.posts)
        notified.raise_alarm(asset="bench-2")
        await until(lambda: hook.taken, "the urgent one")
        assert hook.posts.index(hook.taken[0]) <= before + 5


async def test_priority_1_that_was_refused_does_not_stand_behind_a_post_that_fails(
    bench: Bench, hook: Hook
) -> None:
    is_odd = True

    def judge(events: list[dict[str, Any]]) -> int:
        if any(e["alarm"]["priority"] == 3 for e in events):
            return 503
        return 500 if is_odd else 204

    refuses(hook, judge)
    async with Notified(bench, site(hook)) as notified:
        urgent = notified.raise_alarm()
        await until(lambda: hook.posts, "the refusal")
        notified.raise_alarm(kind="low", priority=3)
        await until(lambda: hook.posts[-1][0] == 503, "the failure of the other")
        is_odd = False
        await until(lambda: events(hook) == [("raised", f"{urgent}:raised:1")], "the urgent one")


async def test_priority_1_that_comes_while_its_receiver_answers_is_tried_in_the_back_off(
    bench: Bench, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 3600.0)
    loop = asyncio.get_running_loop()
    raised = threading.Event()

    def judge(events: list[dict[str, Any]]) -> int:
        if all(e["alarm"]["priority"] == 1 for e in events):
            return 204
        if not raised.is_set():
            loop.call_soon_threadsafe(raise_in_the_loop)
            assert raised.wait(PATIENCE_S)
        return 503

    def raise_in_the_loop() -> None:
        notified.raise_alarm()
        raised.set()

    refuses(hook, judge)
    async with Notified(bench, site(hook)) as notified:
        notified.raise_alarm(kind="low", priority=3)
        await until(lambda: hook.taken, "the urgent one")
        assert [status for status, _, _ in hook.posts][:2] == [503, 204]


async def test_urgent_posts_that_are_too_large_go_out_in_their_order(
    bench: Bench, hook: Hook
) -> None:
    refuses(hook, lambda events: 413 if len(events) > 2 else 204)
    async with Notified(bench, site(hook)) as notified:
        await looked(notified, 1)  # what was there at the start has an order of its own
        alarms = [notified.raise_alarm(kind=f"kind {number}") for number in range(10)]
        await quiet(notified)
    assert events(hook) == [("raised", f"{id}:raised:1") for id in alarms]


async def test_priority_1_waits_for_no_odd_one_that_came_with_it(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 3600.0)
    monkeypatch.setattr(notification_queue, "RETRY_LAST_S", 3600.0)
    mailbox.answers = {"b@example.com": ["450 greylisted"] * 99}
    mailbox.judge = lambda message: "451 later" if "odd," in text_of(message) else "250 ok"
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm(kind="kind 0", priority=1)
        await until(notified.tries, "the back-off")
        notified.raise_alarm(kind="odd", priority=1)
        notified.raise_alarm(kind="right", priority=1)
        await until(lambda: "right," in text_of(mailbox.got[-1][1]), "the right one")


async def test_a_silence_while_an_address_lacks_a_mail_doubles_it_for_no_other(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mail, "_PATIENCE", 1000)
    monkeypatch.setattr(notification_queue, "RETRY_LAST_S", 0.1)
    later = mailbox.answers["b@example.com"] = ["450 greylisted"] * 9999
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm(priority=3, kind="kind 0")
        await until(lambda: mailbox.got, "the mail to a")
        now_us = bench.clock.us
        silence = Silence("s", ("bench-1",), now_us, now_us + 60_000_000, "engineer", "greasing")
        bench.store.part(Silences).add(silence, now_us)
        await until(lambda: notified.parts[0].covers("bench-1", now_us + 1), "the silence")
        await looked(notified, 3)
        notified.raise_alarm(priority=3, kind="kind 1", asset="bench-2")
        bench.clock.advance(3600)
        await looked(notified, 3)
        later.clear()
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = "".join(text_of(m) for recipients, m in mailbox.got if address in recipients)
        assert [texts.count(f"kind {number},") for number in range(2)] == [1, 1], address
