"""Mails reach each address of a real mail server once, through what goes wrong with some."""

from email.message import Message

import pytest
from alarm_bench import Bench
from receivers import PASSWORD, Mailbox

from service.features.notifications import mail, notification_queue, refusals

from .notified import Notified, looked, quiet, site, text_of, until

pytestmark = pytest.mark.wires


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
        left = [too_large] * 4
        mailbox.judge_size = lambda: left.pop() if left else None
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


async def test_a_message_that_becomes_shorter_is_not_joined_with_what_came_since(
    bench: Bench, mailbox: Mailbox
) -> None:
    later = mailbox.answers["b@example.com"] = ["450 later"] * 999
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        first = notified.raise_alarm(kind="first", priority=3)
        notified.raise_alarm(kind="second", priority=3)
        await until(lambda: mailbox.got, "the first mail")
        notified.book.shelve(first, 600, "operator")
        notified.raise_alarm(kind="third", priority=3)
        await until(lambda: len(later) < 996, "further tries")
        later.clear()
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = "".join(text_of(m) for recipients, m in mailbox.got if address in recipients)
        for kind in ("second", "third"):
            assert texts.count(f"  {kind},") == 1, (address, kind)


@pytest.mark.parametrize("step", ["DATA", "MAIL"])
async def test_an_address_whose_text_is_always_postponed_delays_no_other_message(
    bench: Bench, mailbox: Mailbox, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setattr(mail, "_PATIENCE", 3)
    full, is_full = "452 mailbox full", True
    mailbox.answers["b@example.com"] = ["450 later"]

    def judge(message: Message) -> str:
        return full if step == "DATA" and mailbox.got and is_full else "250 taken"

    def size() -> str | None:
        return full if step == "MAIL" and mailbox.got and is_full else None

    mailbox.judge, mailbox.judge_size = judge, size
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        for number in range(4):
            notified.raise_alarm(kind=f"kind {number}", priority=3)
        await until(lambda: mailbox.got, "the mail to the first")
        await quiet(notified)
        (state,) = await notified.notifier.states()
        assert (state.given_up, state.waiting, state.tries) == (0, 0, 0)
        assert state.error == f"b@example.com: {full}"
        is_full = False
        notified.raise_alarm(asset="bench-2")
        await until(lambda: len(mailbox.got) == 2, "the next alarm")
    assert [to for to, _ in mailbox.got] == [["a@example.com"], ["a@example.com", "b@example.com"]]


async def test_an_address_that_has_a_raise_learns_that_the_alarm_was_shelved(
    bench: Bench, mailbox: Mailbox
) -> None:
    later = mailbox.answers["b@example.com"] = ["450 later"] * 999
    async with Notified(bench, site(mailbox=mailbox)) as notified:
        alarm = notified.raise_alarm(priority=3)
        await until(lambda: mailbox.got, "the raise")
        await until(notified.tries, "that it is known")
        notified.book.shelve(alarm, 600, "operator")
        await looked(notified, 2)
        later.clear()
        await until(lambda: "returned" in mailbox.got[-1][1]["subject"], "the return")
        await quiet(notified)
    for address in ("a@example.com", "b@example.com"):
        texts = [text_of(m) for recipients, m in mailbox.got if address in recipients]
        assert [text.split()[0] for text in texts] == ["RAISED", "RETURNED"], address
