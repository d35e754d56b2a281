"""Alarms of a real book reach a real mail server and a real webhook, through what goes wrong."""

import asyncio
import base64
import gc
import hashlib
import hmac
import json
import time
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
from service.alarms.silencing import Silencing
from service.features.notifications import mail, notification_queue, refusals
from service.features.notifications.part import Notifier
from service.features.notifications.tables import NotificationRecords
from service.features.silences.part import KnownSilences
from service.features.silences.tables import Silence, Silences
from service.pauses import MeasuredCoroutine
from service.site.configuration import SettingsError
from service.site.settings import Settings
from service.store import JournalFilter

pytestmark = pytest.mark.wires

KEY = base64.b64encode(bytes(range(32))).decode()
PATIENCE_S = 60.0


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
        self.notifier = Notifier(
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


async def quiet(notified: Notified) -> None:
    """Wait until all that may be sent now has been sent."""
    await asyncio.sleep(1.0)

    async def all_is_sent() -> bool:
        return all(one.waiting == one.held for one in await notified.notifier.states())

    await until(all_is_sent, "all is sent")


def events(hook: Hook) -> list[tuple[str, str]]:
    return [
        (event["event"], event["id"])
        for _, _, body in hook.taken
        for event in json.loads(body)["events"]
    ]


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


async def test_mail_goes_out_once_to_each_address_by_tls_and_log_in(
    bench: Bench, mailbox: Mailbox
) -> None:
    mailbox.answers = {"b@example.com": ["451 come again later"]}
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm()
        await quiet(notified)
        await until(lambda: len(mailbox.got) == 2, "both mails")
        assert [to for to, _ in mailbox.got] == [["a@example.com"], ["b@example.com"]]
        assert len({message["message-id"] for _, message in mailbox.got}) == 1
        message = mailbox.got[0][1]
        assert message["subject"] == (
            "Bearing Twin: raised: Bench bench-1, Inner ring over alarm 105 °C"
        )
        text = message.get_content()  # type: ignore[attr-defined]
        assert "value 106.0 °C, limit 105.0 °C" in text
        assert "nobody has acknowledged it" in text
        # An address that is refused for good is named, and the others have the message.
        mailbox.answers = {"b@example.com": ["550 no such user"]}
        notified.end_alarm()
        await until(lambda: len(mailbox.got) == 3, "the return")
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.error == "b@example.com: 550 no such user"
        assert state.tries == 0
        assert await notified.notifier.test("mail", "engineer") == (True, "")
    assert mailbox.got[-1][1]["subject"] == "Bearing Twin: test of mail"


async def test_a_domain_with_an_umlaut_goes_out_as_mail_servers_know_it(
    bench: Bench, mailbox: Mailbox
) -> None:
    mailbox.options["enable_SMTPUTF8"] = False
    to = ["shift@works.example", "guard@bücher.example"]
    async with Notified(bench, site(mailbox=mailbox, to=to)) as notified:
        notified.raise_alarm()
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.error == ""
    ((recipients, message),) = mailbox.got
    assert recipients == ["shift@works.example", "guard@xn--bcher-kva.example"]
    assert message["to"] == ", ".join(recipients)


@pytest.mark.parametrize("takes_all_names", [False, True])
async def test_an_address_with_an_umlaut_keeps_the_message_from_nobody_else(
    bench: Bench, mailbox: Mailbox, takes_all_names: bool
) -> None:
    mailbox.options["enable_SMTPUTF8"] = takes_all_names
    to = ["jörg@works.example", "shift@works.example"]
    async with Notified(bench, site(mailbox=mailbox, to=to)) as notified:
        notified.raise_alarm()
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.tries == 0
    got = [recipients for recipients, _ in mailbox.got]
    assert got[0] == ["shift@works.example"]
    assert mailbox.got[0][1]["to"] == "shift@works.example"
    if takes_all_names:
        assert got[1:] == [["jörg@works.example"]]
        assert state.error == ""
    else:
        assert got[1:] == []
        assert state.error == (
            "jörg@works.example: 553 the mail server takes no such name (it has no SMTPUTF8)"
        )


async def test_a_mail_that_is_refused_for_its_text_is_halved(
    bench: Bench, mailbox: Mailbox
) -> None:
    def judge(message: Message) -> str:
        text = message.get_content()  # type: ignore[attr-defined]
        is_refused = "kind 2," in text or text.count("RAISED") > 3
        return "552 too much" if is_refused else "250 taken"

    mailbox.judge = judge
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(8):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting) == (1, 0)
    texts = "".join(message.get_content() for _, message in mailbox.got)  # type: ignore[attr-defined]
    for number in range(8):
        assert texts.count(f"kind {number},") == (number != 2)


def text_of(message: Message) -> str:
    text = message.get_content()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("step", ["DATA", "MAIL"])
async def test_a_mail_that_is_too_large_for_the_time_being_is_halved(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setattr(notification_queue, "RETRY_LAST_S", 0.2)
    too_large = "452 message too large at the moment"
    tries = []

    def judge(message: Message) -> str:
        tries.append(text_of(message).count("RAISED"))
        return too_large if step == "DATA" and tries[-1] > 3 else "250 taken"

    mailbox.judge = judge
    if step == "MAIL":
        mailbox.answers["SIZE"] = [too_large] * 4
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(8):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting, state.tries, state.error) == (0, 0, 0, "")
    texts = "".join(text_of(message) for _, message in mailbox.got)
    for number in range(8):
        assert texts.count(f"kind {number},") == 1
    if step == "DATA":
        assert tries[:2] == [8, 8], "the first refusal may have another reason"
    assert len(mailbox.got) > 1


async def test_one_mail_that_is_always_postponed_stops_no_other_and_is_never_given_up(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "REFUSED_FOR_S", 0.1)
    monkeypatch.setattr(refusals, "LAST_S", 0.2)
    odd, postponed = "kind 3,", 0

    def judge(message: Message) -> str:
        nonlocal postponed
        is_odd = bool(odd) and odd in text_of(message)
        postponed += is_odd
        return "451 try again later" if is_odd else "250 taken"

    mailbox.judge = judge
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(4):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await until(lambda: "".join(text_of(m) for _, m in mailbox.got).count("RAISED") == 3,
                    "the others")  # fmt: skip
        tries = postponed
        await until(lambda: postponed > tries + 4, "more tries than a refusal has")
        other = notified.raise_alarm(asset="bench-2", priority=3)
        await until(lambda: "bench-2" in text_of(mailbox.got[-1][1]), f"a later one, {other}")
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting) == (0, 1)
        odd = ""
        await until(lambda: "kind 3," in text_of(mailbox.got[-1][1]), "the odd one")


async def test_a_mail_that_is_refused_for_good_after_it_was_postponed_is_tried_twice(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "REFUSED_FOR_S", 0.1)
    answer, tries = "451 later", 0

    def judge(message: Message) -> str:
        nonlocal tries
        tries += 1
        return answer if "kind 1," in text_of(message) else "250 taken"

    mailbox.judge = judge
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm(kind="kind 1", priority=3)
        await until(lambda: tries > 4, "some tries")
        notified.raise_alarm(asset="bench-2", priority=3)
        await until(lambda: mailbox.got, "the other")
        answer, tries = "554 no", 0
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 1
        assert tries >= 2, "once for good after others were accepted is not enough"


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


async def test_an_address_that_is_refused_for_the_time_being_doubles_no_mail(
    bench: Bench, mailbox: Mailbox
) -> None:
    mailbox.answers = {"b@example.com": ["450 later"] * 4}
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm(kind="first", priority=3)
        notified.raise_alarm(kind="second", priority=1)
        await until(lambda: mailbox.got, "the first mail")
        notified.raise_alarm(kind="third", priority=1)
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = "".join(
            message.get_content()  # type: ignore[attr-defined]
            for recipients, message in mailbox.got
            if address in recipients
        )
        for kind in ("first", "second", "third"):
            assert texts.count(f"  {kind},") == 1, (address, kind)


async def test_a_message_that_becomes_shorter_doubles_no_mail(
    bench: Bench, mailbox: Mailbox
) -> None:
    mailbox.answers = {"b@example.com": ["450 later"] * 4}
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        first = notified.raise_alarm(kind="first", priority=3)
        notified.raise_alarm(kind="second", priority=3)
        await until(lambda: mailbox.got, "the first mail")
        notified.book.shelve(first, 600, "operator")
        await quiet(notified)
    of_a = [message for recipients, message in mailbox.got if "a@example.com" in recipients]
    assert len([one for one in of_a if "  second," in one.get_content()]) == 1  # type: ignore[attr-defined]
    assert any("b@example.com" in recipients for recipients, _ in mailbox.got)


async def test_an_address_that_is_always_refused_for_the_time_being_delays_no_other_message(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mail, "_PATIENCE", 3)
    later = mailbox.answers["b@example.com"] = ["452 mailbox full"] * 4
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        notified.raise_alarm()
        await quiet(notified)
        assert len(later) == 1, "tried three times"
        (state,) = await notified.notifier.states()
        assert (state.tries, state.error) == (0, "b@example.com: 452 mailbox full")
        notified.end_alarm()
        await quiet(notified)
        assert not later, "tried once"
        assert [recipients for recipients, _ in mailbox.got] == [["a@example.com"]] * 2
        notified.raise_alarm(asset="bench-2")
        await until(lambda: len(mailbox.got) == 3, "the next alarm")
    assert mailbox.got[-1][0] == ["a@example.com", "b@example.com"]


async def test_a_wrong_password_is_said_without_it(bench: Bench, mailbox: Mailbox) -> None:
    settings = site(mailbox=mailbox)
    smtp = settings.smtp.model_copy(update={"username": "other"})
    settings = settings.model_copy(update={"smtp": smtp})
    async with Notified(bench, settings) as notified:
        notified.raise_alarm()
        await until(lambda: notified.notifier.problems()["notifications"], "a problem")
        problem = notified.notifier.problems()["notifications"]
        assert problem is not None
        assert "535" in problem
        assert PASSWORD not in problem
        is_sent, why = await notified.notifier.test("mail", "engineer")
        assert not is_sent
        assert "535" in why
        (state,) = await notified.notifier.states()
        assert state.waiting == 1
        assert state.failing_since_us is not None
    assert not mailbox.got


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


def refuses(hook: Hook, is_refused: Callable[[list[dict[str, Any]]], int]) -> None:
    """Let a receiver refuse posts for what they say."""
    hook.judge = lambda body: is_refused(json.loads(body)["events"])


async def test_a_post_that_is_too_large_is_halved_until_it_is_taken(
    bench: Bench, hook: Hook
) -> None:
    refuses(hook, lambda events: 413 if len(events) > 30 else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(120):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await quiet(notified)
        (state,) = await notified.notifier.states()
    names = [id for _, id in events(hook)]
    assert len(names) == len(set(names)) == 120
    assert (state.given_up, state.tries, state.error) == (0, 0, "")
    assert 413 in {status for status, _, _ in hook.posts}


@pytest.mark.parametrize("status", [400, 413, 422])
async def test_one_alarm_that_a_receiver_refuses_stops_no_other(
    bench: Bench, hook: Hook, status: int
) -> None:
    def odd(events: list[dict[str, Any]]) -> int:
        return status if any(one["alarm"]["kind"] == "kind 17" for one in events) else 204

    refuses(hook, odd)
    async with Notified(bench, site(hook)) as notified:
        for number in range(40):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await quiet(notified)
        urgent = notified.raise_alarm(asset="bench-2")
        await until(lambda: ("raised", f"{urgent}:raised:1") in events(hook), "the urgent one")
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting, state.tries) == (1, 0, 0)
        # It returns: the receiver, who does not know of it, gets nothing of it.
        notified.end_alarm(kind="kind 17", priority=3)
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 1
    assert len(events(hook)) == 40
    assert bench.outbox.flush(30)
    lines = bench.store.alarms.journal(JournalFilter(events=True), 100).items
    (line,) = [one for one in lines if one.kind == "notification refused"]
    assert line.asset == "bench-1"
    assert line.message.startswith("hook was not notified (raised) of: ")
    assert line.message.endswith(f"answered {status}")


async def test_one_alarm_on_which_a_receiver_fails_stops_no_other_and_is_never_given_up(
    bench: Bench, hook: Hook
) -> None:
    is_odd = True

    def odd(events: list[dict[str, Any]]) -> int:
        return 500 if is_odd and any(e["alarm"]["kind"] == "kind 3" for e in events) else 204

    refuses(hook, odd)
    async with Notified(bench, site(hook)) as notified:
        for number in range(8):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await until(lambda: len(events(hook)) == 7, "the others")
        tries = len(hook.posts)
        await until(lambda: len(hook.posts) > tries + 4, "more tries than a refusal has")
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting) == (0, 1)
        is_odd = False
        await until(lambda: len(events(hook)) == 8, "the odd one")


async def test_after_a_receiver_failed_on_everything_alarms_go_out_together_again(
    bench: Bench, hook: Hook
) -> None:
    fails = True
    refuses(hook, lambda events: 500 if fails else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(40):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await until(lambda: len(hook.posts) > 8, "some tries")
        fails = False
        await quiet(notified)
    names = [id for _, id in events(hook)]
    assert len(names) == len(set(names)) == 40
    assert len(hook.taken) < 15


async def test_an_alarm_that_is_shelved_while_it_is_refused_stops_nothing(
    bench: Bench, hook: Hook
) -> None:
    loop = asyncio.get_running_loop()

    async def waiting() -> int:
        (state,) = await notified.notifier.states()
        return state.waiting

    def shelving(posted: list[dict[str, Any]]) -> int:
        if posted[0]["alarm"]["asset"] == "bench-2":
            return 204
        notified.book.shelve(posted[0]["alarm"]["id"], 600, "operator")
        while asyncio.run_coroutine_threadsafe(waiting(), loop).result(PATIENCE_S):
            time.sleep(0.02)
        return 422

    refuses(hook, shelving)
    async with Notified(bench, site(hook)) as notified:
        notified.raise_alarm()
        await until(lambda: hook.posts, "the refusal")
        other = notified.raise_alarm(asset="bench-2")
        await until(lambda: events(hook) == [("raised", f"{other}:raised:1")], "the next alarm")
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 0


async def test_a_receiver_that_accepts_nothing_for_a_while_loses_nothing(
    bench: Bench, hook: Hook
) -> None:
    """It may be a key, or a proxy, that is not right yet."""
    is_wrong = True
    refuses(hook, lambda events: 400 if is_wrong else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(4):
            notified.raise_alarm(kind=f"kind {number}", priority=1 + number % 3)
        await until(lambda: len(hook.posts) > 12, "several tries of each")
        is_wrong = False
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 0
    assert len({id for _, id in events(hook)}) == 4


async def test_one_alarm_that_is_never_taken_delays_no_later_one(bench: Bench, hook: Hook) -> None:
    refuses(hook, lambda events: 500 if any("odd" in e["alarm"]["kind"] for e in events) else 204)
    async with Notified(bench, site(hook)) as notified:
        for number in range(3):
            notified.raise_alarm(kind=f"odd {number}")
        await until(lambda: len(hook.posts) > 12, "its tries become rare")
        tried = {json.loads(body)["events"][0]["alarm"]["kind"] for _, _, body in hook.posts[-3:]}
        assert len(tried) == 3, "in turn"
        posts = len(hook.posts)
        notified.raise_alarm(asset="bench-2")
        await until(lambda: hook.taken, "the later one")
        assert len(hook.posts) <= posts + 2


async def test_a_return_that_is_refused_is_given_up_once(
    bench: Bench, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "REFUSED_FOR_S", 0.1)
    refuses(hook, lambda events: 422 if events[0]["event"] == "returned" else 204)
    async with Notified(bench, site(hook)) as notified:
        alarm = notified.raise_alarm()
        await quiet(notified)
        notified.end_alarm()
        await quiet(notified)
        posts = len(hook.posts)
        notified.book.acknowledge(alarm, "operator")
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 1
        assert len(hook.posts) == posts
        notified.raise_alarm()
        await until(lambda: len(hook.taken) == 2, "the next raise")


async def test_what_is_refused_and_nothing_else_comes_is_given_up_as_well(
    bench: Bench, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "REFUSED_FOR_S", 0.1)
    refuses(hook, lambda events: 422)
    async with Notified(bench, site(hook)) as notified:
        notified.raise_alarm()
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert state.given_up == 1
        assert len(hook.posts) >= 3
        hook.judge = None
        notified.raise_alarm(asset="bench-2")
        await until(lambda: hook.taken, "the next alarm")
        assert not any(notified.notifier.problems().values())


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
        await asyncio.sleep(1.0)
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
    await asyncio.sleep(1.0)
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
    await asyncio.sleep(1.0)
    for held_by in (book, others):
        for asset in ("bench-1", "bench-2"):
            held_by.evaluate(replace(COLD, asset=asset, off_delay_s=0))
    await until(lambda: len(events(hook)) == 4, "both returns")
    await asyncio.sleep(1.0)
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
