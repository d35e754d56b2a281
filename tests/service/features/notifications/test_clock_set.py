"""The clock is set while alarms stand: no message comes sooner, later or twice."""

import asyncio
from typing import Any

import pytest
from alarm_bench import SECOND_US, Bench
from receivers import Hook, Mailbox

from service.features.silences.tables import Silence, Silences
from service.site.settings import Settings

from .notified import Notified, events, quiet, site, until

pytestmark = pytest.mark.wires

HOUR_US = 3600 * SECOND_US
STEPS_S = (-3600, 3600, -600, 30 * 86_400, -30 * 86_400)
every_step = pytest.mark.parametrize("step_s", STEPS_S)


def set_clock(notified: Notified, step_s: int) -> None:
    """Set the clock, and move what counts spans in the same moment, as the cell does it."""
    notified.bench.clock.advance(step_s)
    for part in notified.parts:
        part.clock_set(step_s * SECOND_US)
    notified.book.clock_set(step_s * SECOND_US)


def escalating(hook: Hook, mailbox: Mailbox) -> Settings:
    settings = site(hook, mailbox, escalation=[{"after_min": 15, "to": "mail"}])
    (first, second) = settings.notifications
    second = second.model_copy(update={"only_escalations": True})
    return settings.model_copy(update={"notifications": (first, second)})


@every_step
async def test_an_escalation_comes_after_its_time(
    bench: Bench, hook: Hook, mailbox: Mailbox, step_s: int
) -> None:
    async with Notified(bench, escalating(hook, mailbox)) as notified:
        alarm = notified.raise_alarm()
        await until(lambda: events(hook), "the first message")
        bench.clock.advance(600)
        set_clock(notified, step_s)
        bench.clock.advance(299)
        await quiet(notified)
        assert not mailbox.got
        bench.clock.advance(1)
        await until(lambda: mailbox.got, "the escalation")
        notified.end_alarm()
        await until(lambda: len(events(hook)) == 2, "the return")
    assert events(hook) == [("raised", f"{alarm}:raised:1"), ("returned", f"{alarm}:returned:1")]


@every_step
async def test_an_escalation_comes_after_its_time_across_a_restart(
    bench: Bench, hook: Hook, mailbox: Mailbox, step_s: int
) -> None:
    settings = escalating(hook, mailbox)
    async with Notified(bench, settings) as notified:
        notified.raise_alarm()
        await until(lambda: events(hook), "the first message")
        await quiet(notified)  # that it was sent is known
        set_clock(notified, step_s)
    assert await asyncio.to_thread(bench.outbox.flush, 30)
    # Set once more while the service is off: the start moves what it has loaded.
    bench.clock.advance(600 - step_s)
    async with Notified(bench, settings, loaded_by_us=-step_s * SECOND_US) as notified:
        bench.clock.advance(299)
        await quiet(notified)
        assert not mailbox.got
        bench.clock.advance(1)
        await until(lambda: mailbox.got, "the escalation")
    assert len(events(hook)) == 1, "nothing is sent twice"


@every_step
async def test_what_was_raised_just_before_is_sent_once(
    bench: Bench, hook: Hook, mailbox: Mailbox, step_s: int
) -> None:
    async with Notified(bench, escalating(hook, mailbox)) as notified:
        alarm = notified.raise_alarm()  # not taken in yet
        set_clock(notified, step_s)
        await until(lambda: events(hook), "the message")
        bench.clock.advance(899)
        await quiet(notified)
        assert not mailbox.got
        bench.clock.advance(1)
        await until(lambda: mailbox.got, "the escalation")
    assert events(hook) == [("raised", f"{alarm}:raised:1")]


def silence(now_us: int, name: str, of: str = "bench-1", **more: Any) -> Silence:
    return Silence(name, (of,), now_us, now_us + HOUR_US, "engineer", "greasing", **more)


@every_step
async def test_a_silence_lasts_as_long_as_it_was_to(bench: Bench, hook: Hook, step_s: int) -> None:
    bench.store.part(Silences).add(silence(bench.clock.us, "s"), bench.clock.us)
    async with Notified(bench, site(hook)) as notified:
        alarm = notified.raise_alarm()
        bench.clock.advance(1800)
        set_clock(notified, step_s)
        bench.clock.advance(1800 - 40)
        await quiet(notified)
        await asyncio.sleep(0.5)  # the store has been read
        assert events(hook) == []
        bench.clock.advance(60)
        await until(lambda: events(hook), "the end of the silence")
    assert events(hook) == [("raised", f"{alarm}:raised:1")]


@every_step
async def test_a_silence_lasts_as_long_across_a_restart(
    bench: Bench, hook: Hook, step_s: int
) -> None:
    bench.store.part(Silences).add(silence(bench.clock.us, "s"), bench.clock.us)
    bench.clock.advance(1800 + step_s)
    async with Notified(bench, site(hook), loaded_by_us=step_s * SECOND_US) as notified:
        notified.raise_alarm()
        bench.clock.advance(1800 - 60)
        await quiet(notified)
        assert events(hook) == []
        bench.clock.advance(120)
        await until(lambda: events(hook), "the end of the silence")


@every_step
async def test_what_is_of_another_start_of_the_machine_goes_by_the_calendar(
    bench: Bench, hook: Hook, mailbox: Mailbox, step_s: int
) -> None:
    settings = escalating(hook, mailbox)
    bench.store.part(Silences).add(silence(bench.clock.us, "s", of="bench-2"), bench.clock.us)
    async with Notified(bench, settings) as notified:
        notified.raise_alarm()
        await until(lambda: events(hook), "the first message")
        await quiet(notified)
    assert await asyncio.to_thread(bench.outbox.flush, 30)
    (kept,) = bench.store.part(Silences).load(0)
    async with Notified(bench, settings, loaded_by_us=None) as notified:
        await asyncio.sleep(0.5)
        set_clock(notified, step_s)
        bench.clock.advance(-step_s)  # a time server has put it right
        bench.clock.advance(899)
        await quiet(notified)
        assert not mailbox.got
        bench.clock.advance(1)
        await until(lambda: mailbox.got, "the escalation")
        await asyncio.sleep(0.5)
    assert len(events(hook)) == 1, "nothing is sent twice"
    assert bench.store.part(Silences).load(0) == [kept]


async def test_planned_silences_and_those_of_certain_hours_go_by_the_calendar(
    bench: Bench, hook: Hook
) -> None:
    now_us, part = bench.clock.us, bench.store.part(Silences)
    planned = silence(now_us + 2 * HOUR_US, "planned")
    weekly = silence(now_us, "weekly", begins="00:00", ends="23:59")
    for one in (planned, weekly):
        part.add(one, now_us)
    async with Notified(bench, site(hook)) as notified:
        await asyncio.sleep(0.5)
        set_clock(notified, -600)
        await asyncio.sleep(0.5)
    assert sorted(part.load(0), key=lambda one: one.id) == [planned, weekly]
