"""Fair shares: limits in all and for each caller, turns in rotation, nothing lost on the way."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from patience import within

from service.web.shares import BusyError, Shares


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_one_caller_has_its_share_and_no_more() -> None:
    shares = Shares("reads", at_once=3, at_once_each=2)
    await shares.enter("a")
    await shares.enter("a")
    with pytest.raises(BusyError, match=r"^busy: two reads are running with this key$"):
        await shares.enter("a")
    await shares.enter("b")
    with pytest.raises(BusyError, match=r"^busy: too many reads for other callers at the moment$"):
        await shares.enter("c")
    shares.leave("a")
    await shares.enter("c")


async def test_callers_take_turns_however_many_one_of_them_asks_for() -> None:
    shares = Shares("what-ifs", at_once=1, at_once_each=1, waiting_each=4)
    order: list[str] = []

    async def work(caller: str) -> None:
        async with shares.turn(caller):
            order.append(caller)
            await asyncio.sleep(0)

    tasks = [asyncio.create_task(work(one)) for one in ["greedy"] * 5 + ["other"] * 2]
    await asyncio.gather(*tasks)
    assert order == ["greedy", "other", "greedy", "other", "greedy", "greedy", "greedy"]


async def test_who_stops_waiting_is_forgotten() -> None:
    shares = Shares("what-ifs", at_once=1, at_once_each=1, waiting_each=1)
    await shares.enter("a")
    waiting = asyncio.create_task(shares.enter("a"))
    await settle()
    with pytest.raises(BusyError):
        await shares.enter("a")
    waiting.cancel()
    await settle()
    again = asyncio.create_task(shares.enter("a"))
    await settle()
    # Cancelled in the moment in which the turn is given: it goes to the next one.
    shares.leave("a")
    again.cancel()
    await settle()
    async with within(10):
        await shares.enter("b")


async def test_a_turn_lasts_as_long_as_its_work_also_when_the_caller_has_gone() -> None:
    shares = Shares("reads", at_once=1, at_once_each=1)
    release = threading.Event()
    with ThreadPoolExecutor(1) as executor:
        running = asyncio.create_task(shares.run("a", executor, release.wait, 60))
        await settle()
        running.cancel()
        await settle()
        assert running.cancelled()
        with pytest.raises(BusyError):
            await shares.enter("b")
        release.set()
        async with within(30):
            while True:
                try:
                    await shares.enter("b")
                    break
                except BusyError:
                    await asyncio.sleep(0.01)


async def test_a_failure_reaches_the_caller_and_frees_the_turn() -> None:
    shares = Shares("reads", at_once=1, at_once_each=1)

    def fail() -> None:
        raise ValueError("no")

    with ThreadPoolExecutor(1) as executor:
        for _ in range(3):
            with pytest.raises(ValueError, match="no"):
                await shares.run("a", executor, fail)
