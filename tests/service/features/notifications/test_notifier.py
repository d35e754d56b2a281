"""Alarms of a real book reach a real mail server and a real webhook, each event once."""

import asyncio
import base64
import gc
import hashlib
import hmac
import json
import threading
import time
from dataclasses import replace
from typing import Any

import pytest
from alarm_bench import COLD, HOT, Bench
from prometheus_client import CollectorRegistry
from receivers import Hook, Mailbox, running_hook

from service.alarms import AlarmBook
from service.alarms.silencing import Silencing
from service.features.notifications.part import Notifier
from service.features.notifications.tables import NotificationRecords
from service.features.silences.tables import Silence, Silences
from service.pauses import MeasuredCoroutine
from service.site.configuration import SettingsError

from .notified import PATIENCE_S, Notified, events, looked, quiet, site, until

pytestmark = pytest.mark.wires

KEY = base64.b64encode(bytes(range(32))).decode()


async def test_a_receiver_that_fails_twice_gets_every_event_once_and_signed(
    bench: Bench, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOOK_KEY", KEY)
    hook.refusals = [503, 302]
    async with Notified(bench, site(hook, secret_variable="HOOK_KEY")) as notified:
        alarm = notified.raise_alarm()
        await until(lambda: hook.taken, "the post")
        assert [status for status, _, _ in hook.posts] == [503, 302, 204]
        assert len({body for _, _, body in hook.posts}) <= 3
        assert len({headers["webhook-id"] for _, headers, _ in hook.posts}) == 1
        notified.book.acknowledge(alarm, "operator")
        await until(lambda: len(events(hook)) == 2, "the acknowledgement")
        notified.end_alarm()
        await quiet(notified)
        assert not any(notified.notifier.problems().values())
    assert events(hook) == [
        ("raised", f"{alarm}:raised:1"),
        ("acknowledged", f"{alarm}:acknowledged:1"),
        ("returned", f"{alarm}:returned:1"),
    ]
    for _, headers, body in hook.posts:
        signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
        digest = hmac.new(base64.b64decode(KEY), signed, hashlib.sha256).digest()
        assert headers["webhook-signature"] == "v1," + base64.b64encode(digest).decode()
    first = json.loads(hook.taken[0][2])["events"][0]
    assert (first["asset_name"], first["alarm"]["priority"]) == ("Bench bench-1", 1)
    assert bench.outbox.flush(30)
    assert not bench.store.part(NotificationRecords).load(), (
        "nothing is kept of an alarm that is over"
    )


async def test_a_burst_is_one_message_and_what_is_set_aside_is_none(
    bench: Bench, hook: Hook, mailbox: Mailbox
) -> None:
    async with Notified(bench, site(hook, mailbox)) as notified:
        aside = notified.raise_alarm(asset="bench-2", suppressed_reason="standstill")
        for number in range(120):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await quiet(notified)
        names = {id for _, id in events(hook)}
        assert len(names) == len(events(hook)) == 120
        assert not any(aside in name for name in names)
        assert len(hook.taken) <= 3, "the first may go out before the last is raised"
        _, message = mailbox.got[-1]
        assert "alarms on 1 machine" in message["subject"]
        assert "more; the page Alarms lists all" in message.get_content()  # type: ignore[attr-defined]


async def test_a_restart_goes_on_where_it_was(bench: Bench, hook: Hook) -> None:
    hook.refusals = [500] * 1000
    async with Notified(bench, site(hook)) as notified:
        alarm = notified.raise_alarm()
        await until(lambda: len(hook.posts) > 1, "two tries")
    bench.restart()
    hook.refusals = []
    async with Notified(bench, site(hook)) as notified:
        await until(lambda: events(hook), "the post")
        await quiet(notified)
    bench.restart()
    async with Notified(bench, site(hook)) as notified:
        await quiet(notified)
        assert events(hook) == [("raised", f"{alarm}:raised:1")], "sent again after a restart"
        # It returned, and was acknowledged, while the receiver was away.
        hook.refusals = [500] * 1000
        notified.end_alarm()
        await until(notified.tries, "a try")
        notified.book.acknowledge(alarm, "operator")
    bench.restart()
    hook.refusals = []
    async with Notified(bench, site(hook)) as notified:
        await quiet(notified)
        assert events(hook)[1:] == [("returned", f"{alarm}:returned:1")]
    assert bench.outbox.flush(30)
    assert not bench.store.part(NotificationRecords).load()


async def test_a_receiver_that_is_replaced_in_the_middle_of_a_post_loses_nothing(
    bench: Bench, hook: Hook
) -> None:
    begun, answers = threading.Event(), threading.Event()

    def judge(body: bytes) -> int:
        begun.set()
        assert answers.wait(PATIENCE_S)
        return 204

    hook.judge = judge
    async with Notified(bench, site(hook)) as notified:
        alarms = {notified.raise_alarm(kind=f"kind {number}") for number in range(3)}
        await until(begun.is_set, "the post")
        alarms.add(notified.raise_alarm(asset="bench-2"))
        await looked(notified, 2)
    answers.set()
    bench.restart()
    with running_hook() as other:
        async with Notified(bench, site(other)) as notified:
            await quiet(notified)
        assert sorted(id for _, id in events(other)) == sorted(f"{id}:raised:1" for id in alarms)


async def test_quiet_hours_hold_low_priorities_and_send_what_is_still_there(
    bench: Bench, hook: Hook
) -> None:
    minute = bench.clock.us // 60_000_000 % 1440
    ends = f"{(minute + 60) % 1440 // 60:02}:{(minute + 60) % 60:02}"
    begins = f"{(minute - 60) % 1440 // 60:02}:{minute % 60:02}"
    hours = {"begins": begins, "ends": ends}
    async with Notified(bench, site(hook, quiet_hours=hours)) as notified:
        urgent = notified.raise_alarm(kind="urgent", priority=1)
        stays = notified.raise_alarm(kind="stays", priority=2)
        notified.raise_alarm(kind="goes", priority=3)
        await quiet(notified)
        assert events(hook) == [("raised", f"{urgent}:raised:1")]
        assert await notified.held() == 2
        notified.end_alarm(kind="goes", priority=3)

        async def one_less() -> bool:
            return await notified.held() == 1

        await until(one_less, "one less is held back")
        bench.clock.advance(3600)
        await until(lambda: len(events(hook)) == 2, "the end of the quiet hours")
        await quiet(notified)
    assert events(hook)[1:] == [("raised", f"{stays}:raised:1")]


async def test_without_acknowledgement_another_is_notified_and_gets_what_follows(
    bench: Bench, hook: Hook, mailbox: Mailbox
) -> None:
    settings = site(hook, mailbox, escalation=[{"after_min": 15, "to": "mail"}])
    (first, second) = settings.notifications
    second = second.model_copy(update={"only_escalations": True})
    settings = settings.model_copy(update={"notifications": (first, second)})
    async with Notified(bench, settings) as notified:
        alarm = notified.raise_alarm()
        answered = notified.raise_alarm(kind="answered")
        await quiet(notified)
        notified.book.acknowledge(answered, "operator")
        bench.clock.advance(14 * 60)
        await quiet(notified)
        assert not mailbox.got
        bench.clock.advance(60)
        await until(lambda: mailbox.got, "the call")
        notified.book.acknowledge(alarm, "shift lead")
        await until(lambda: len(mailbox.got) == 2, "who has it")
        notified.end_alarm()
        await until(lambda: len(mailbox.got) == 3, "the return")
        await quiet(notified)
    subjects = [message["subject"].split(": ")[1] for _, message in mailbox.got]
    assert subjects == ["nobody has acknowledged", "acknowledged", "returned"]
    assert all(len(to) == 2 for to, _ in mailbox.got)


async def test_a_silence_holds_back_messages_and_hides_no_alarm(bench: Bench, hook: Hook) -> None:
    now_us = bench.clock.now_us()
    silence = Silence("s", ("bench-1",), now_us, now_us + 3_600_000_000, "engineer", "greasing")
    bench.store.part(Silences).add(silence, now_us)
    async with Notified(bench, site(hook)) as notified:
        alarm = notified.raise_alarm()
        other = notified.raise_alarm(asset="bench-2")
        await quiet(notified)
        assert events(hook) == [("raised", f"{other}:raised:1")]
        assert [one.state for one in notified.book.active("bench-1")] == ["UNACK"]
        bench.clock.advance(3600)
        await until(lambda: len(events(hook)) == 2, "the end of the silence")
    assert events(hook)[1] == ("raised", f"{alarm}:raised:1")


async def test_what_fails_inside_stops_neither_the_service_nor_the_next_message(
    bench: Bench, hook: Hook
) -> None:
    async with Notified(bench, site(hook)) as notified:
        notified.notifier.alarm_changed(None)  # type: ignore[arg-type]
        alarm = notified.raise_alarm()
        await until(lambda: events(hook), "the next alarm")
        assert events(hook) == [("raised", f"{alarm}:raised:1")]


async def test_another_cell_goes_on_with_what_was_sent(bench: Bench, hook: Hook) -> None:
    def of_fleet() -> tuple[Notifier, AlarmBook]:
        def changed(alarm: Any) -> None:
            notifier.alarm_changed(alarm)

        book = AlarmBook(bench.outbox, bench.clock, changed, begins_empty=True)
        notifier = Notifier(
            site(hook), bench.store, bench.outbox, bench.clock,
            lambda asset: (asset, ""), book, Silencing, CollectorRegistry(),
        )  # fmt: skip
        return notifier, book

    (one, book), (other, others) = of_fleet(), of_fleet()
    running = [asyncio.create_task(each.run()) for each in (one, other)]
    book.evaluate_all([replace(HOT, on_delay_s=0), replace(HOT, asset="bench-2", on_delay_s=0)])
    await asyncio.sleep(0.5)
    assert not hook.posts, "a cell sends nothing of an asset that it does not own"
    await asyncio.to_thread(one.take_over, {"bench-1", "bench-2"})
    await until(lambda: len(events(hook)) == 2, "both are sent")

    async def all_is_noted() -> bool:
        return not any(state.waiting for state in await one.states())

    await until(all_is_noted, "it is noted as sent")
    one.leave(["bench-1"])
    book.leave(["bench-1"])
    assert bench.outbox.flush(30)
    await asyncio.to_thread(others.take_over, ["bench-1"])
    await asyncio.to_thread(other.take_over, {"bench-1"})
    await asyncio.sleep(0.5)
    for held_by in (book, others):
        for asset in ("bench-1", "bench-2"):
            held_by.evaluate(replace(COLD, asset=asset, off_delay_s=0))
    await until(lambda: len(events(hook)) == 4, "both returns")
    await asyncio.sleep(0.5)
    assert sorted(kind for kind, _ in events(hook)) == ["raised", "raised", "returned", "returned"]
    assert len({id for _, id in events(hook)}) == 4
    for task in running:
        task.cancel()
    await asyncio.gather(*running, return_exceptions=True)


@pytest.mark.parametrize("key", ["", "short", base64.b64encode(b"twelve bytes").decode()])
async def test_a_signature_without_a_good_key_is_refused_without_its_value(
    bench: Bench, hook: Hook, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    monkeypatch.setenv("HOOK_KEY", key)
    with pytest.raises(SettingsError, match="secret_variable = 'HOOK_KEY'") as refusal:
        async with Notified(bench, site(hook, secret_variable="HOOK_KEY")):
            pass
    assert not key or key not in str(refusal.value)


async def test_thousands_of_alarms_that_wait_are_looked_at_piece_by_piece(
    bench: Bench, hook: Hook
) -> None:
    """A look at all of them at once would make a poll late."""
    year_us = 366 * 86_400_000_000
    every = Silence("all", (), bench.clock.us, bench.clock.us + year_us, "me", "shift")
    for number in range(200):
        one = replace(every, id=f"{number}", begins="00:00", ends="23:59", time_zone="Asia/Tokyo")
        bench.store.part(Silences).add(one, 0)
    steps_s: list[float] = []
    async with Notified(bench, site(hook)) as notified:
        await notified.notifier.stop()
        for number in range(100):
            notified.book.evaluate_all(
                replace(HOT, asset=f"bench-{number}", channel=f"c-{channel}")
                for channel in range(20)
            )
        # A collection in the middle of a step would look through what all tests before have left.
        gc.collect()
        gc.disable()
        task = asyncio.create_task(MeasuredCoroutine(notified.notifier.run(), steps_s.append))
        try:
            await until(lambda: len(steps_s) > 200, "some looks")
        finally:
            gc.enable()
        begun_s = time.thread_time()
        (state,) = await notified.notifier.states()
        assert (state.waiting, state.held) == (2000, 2000)
        assert time.thread_time() - begun_s < 0.05
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert max(steps_s) < 0.02, max(steps_s)
