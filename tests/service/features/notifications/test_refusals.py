"""What one receiver refuses stops no other message, and is given up only where that is of use."""

import asyncio
import json
import time
from typing import Any

import pytest
from alarm_bench import Bench
from receivers import Hook

from service.features.notifications import refusals
from service.store import JournalFilter

from .notified import PATIENCE_S, Notified, events, quiet, refuses, site, until

pytestmark = pytest.mark.wires


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
