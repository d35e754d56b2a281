"""Who makes the cell work much waits himself: neither a poll nor another caller does."""

import asyncio
import time
from typing import Any, Protocol

import msgspec

from service.bus.asking import on_behalf_of
from service.bus.calls import command_type
from service.bus.dispatch import WAITING_EACH, Dispatcher
from service.bus.loop_share import CALLERS_SHARE
from service.bus.memory import MemoryBus
from service.bus.messages import Answer, Call, Command, Request, encode
from service.domain.errors import CellUnavailableError
from service.pauses import Steps


class Part(Protocol):
    @Call()
    async def work(self, pieces: int) -> int: ...

    @Call()
    async def look(self) -> int: ...


Work, Look = command_type(Part.work), command_type(Part.look)


def busy(seconds: float) -> None:
    ends_s = time.thread_time() + seconds
    while time.thread_time() < ends_s:
        pass


async def work(command: Any) -> int:
    steps = Steps()
    for _ in range(command.pieces):
        busy(0.001)
        await steps.pause()
    return command.pieces


async def look(command: Any) -> int:
    return 1


async def asked_as(bus: MemoryBus, who: str, command: Command[Any]) -> float:
    """Processor seconds of this process until the answer."""
    on_behalf_of.set(who)
    begun_s = time.process_time()
    await bus.ask(command, 60)
    return time.process_time() - begun_s


async def test_one_who_asks_for_much_waits_and_another_is_answered_at_once() -> None:
    bus = MemoryBus()
    serving = asyncio.create_task(bus.serve({Work: work, Look: look}))
    await asyncio.sleep(0)
    greedy = [asyncio.create_task(asked_as(bus, "greedy", Work(100))) for _ in range(20)]
    await asyncio.sleep(0.05)
    looks_s = [await asyncio.create_task(asked_as(bus, "other", Look())) for _ in range(10)]
    # Behind those of the greedy one it would be after 2 s of work, or after 20 ms of it.
    assert max(looks_s) < 0.015, looks_s
    assert not any(task.done() for task in greedy)
    for task in (serving, *greedy):
        task.cancel()
    await asyncio.gather(serving, *greedy, return_exceptions=True)


async def test_callers_leave_the_loop_its_share_and_have_one_step_at_a_time() -> None:
    bus = MemoryBus()
    serving = asyncio.create_task(bus.serve({Work: work}))
    await asyncio.sleep(0)
    begun_s, began_s = time.thread_time(), time.monotonic()
    asking = [asyncio.create_task(asked_as(bus, f"key {n}", Work(15))) for n in range(10)]
    longest_s = 0.0
    while not all(task.done() for task in asking):
        round_s = time.thread_time()
        await asyncio.sleep(0.001)  # as a poll waits for its answer
        longest_s = max(longest_s, time.thread_time() - round_s)
    used_s, took_s = time.thread_time() - begun_s, time.monotonic() - began_s
    assert used_s > 0.15
    assert took_s > 0.14 / CALLERS_SHARE, "the rest of the time is that of polls"
    assert longest_s < 0.01, "ten callers at once would have ten steps in a round"
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


async def test_so_many_wait_for_one_caller_and_no_more() -> None:
    dispatcher = Dispatcher({Look: look})
    answers: list[Answer] = []

    def take(who: str) -> None:
        body = msgspec.Raw(encode(Look()))
        request = Request(1, time.monotonic() + 60, Look.__name__, body, caller=who)
        dispatcher.take(
            b"web",
            encode(request),
            lambda body: answers.append(msgspec.msgpack.decode(body, type=Answer)),
        )

    for _ in range(WAITING_EACH + 5):
        take("greedy")
    await asyncio.sleep(0)  # they stand in the row now
    for _ in range(3):
        take("greedy")
    take("other")
    for _ in range(500):
        await asyncio.sleep(0)
    refused = [one for one in answers if one.error]
    assert [one.error for one in refused] == [CellUnavailableError.__name__] * 3
    assert len(answers) == WAITING_EACH + 5 + 3 + 1
    await dispatcher.close()
