"""Priority 1 stands behind nothing that a receiver did not take."""

import asyncio

import pytest
from alarm_bench import Bench
from receivers import Hook, Mailbox

from service.features.notifications import mail, notification_queue

from .notified import Notified, events, quiet, refuses, site, text_of, until

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
        await asyncio.sleep(1.0)
        texts = [text_of(message) for _, message in mailbox.got[earlier:]]
        assert len(texts) == 3, "each was tried once"
        assert low
    if why != "the server":
        assert len(answers["b@example.com"]) == 99 - 4


async def test_urgent_mails_that_an_address_postpones_reach_all_once(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mail, "_PATIENCE", 3)
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 12.0)
    later = mailbox.answers["b@example.com"] = ["450 greylisted"] * 99
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(6):
            notified.raise_alarm(kind=f"kind {number}", priority=1)
            await until(lambda number=number: len(mailbox.got) == number + 1, "one")  # type: ignore[misc]
        later.clear()  # as greylisting ends, after fewer tries of one message than are its patience
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = "".join(text_of(m) for recipients, m in mailbox.got if address in recipients)
        for number in range(6):
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
