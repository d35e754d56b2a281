"""Studies: one answer for all who ask the same, none for callers who have left."""

import asyncio
from collections.abc import Hashable

import pytest

from service.web.shares import BusyError, Shares
from service.web.studies import Studies


class Desk:
    """A worker whose studies end when the test says so."""

    def __init__(self, waiting_each: int = 4) -> None:
        turns = Shares("calculations", at_once=1, at_once_each=1, waiting_each=waiting_each)
        self.studies = Studies(turns)
        self.begun: list[Hashable] = []
        self.ends: dict[Hashable, asyncio.Future[str]] = {}

    def ask(self, caller: str, key: Hashable) -> "asyncio.Task[str]":
        async def begin() -> str:
            self.begun.append(key)
            self.ends[key] = asyncio.get_running_loop().create_future()
            return await self.ends[key]

        return asyncio.create_task(self.studies.answer(caller, key, begin))


async def settle() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_callers_of_the_same_share_one_study() -> None:
    desk = Desk(waiting_each=0)
    asking = [desk.ask(caller, "envelope") for caller in ("a", "a", "b")]
    await settle()
    desk.ends["envelope"].set_result("map")
    assert await asyncio.gather(*asking) == ["map"] * 3
    assert desk.begun == ["envelope"]
    again = desk.ask("a", "envelope")  # an answer is not kept here
    await settle()
    desk.ends["envelope"].set_result("newer map")
    assert await again == "newer map"


async def test_what_waits_never_begins_when_its_callers_leave() -> None:
    desk = Desk()
    first = desk.ask("a", 1)
    second = [desk.ask("a", 2), desk.ask("b", 2)]
    await settle()
    for one in second:
        one.cancel()
    await settle()
    third = desk.ask("a", 3)
    await settle()
    desk.ends[1].set_result("one")
    await first
    await settle()
    desk.ends[3].set_result("three")
    await third
    assert desk.begun == [1, 3]


async def test_the_caller_who_asked_first_may_leave() -> None:
    desk = Desk()
    first, second = desk.ask("a", 1), desk.ask("b", 1)
    await settle()
    first.cancel()
    await settle()
    desk.ends[1].set_result("one")
    assert await second == "one"
    assert desk.begun == [1]


async def test_a_begun_study_keeps_its_turn_until_the_worker_is_free() -> None:
    desk = Desk()
    first = desk.ask("a", 1)
    await settle()
    first.cancel()
    second = desk.ask("b", 2)
    await settle()
    assert desk.begun == [1]
    desk.ends[1].set_result("for no one")
    await settle()
    desk.ends[2].set_result("two")
    assert await second == "two"


async def test_the_share_of_one_caller_is_not_that_of_another() -> None:
    desk = Desk(waiting_each=1)
    asking = [desk.ask("a", key) for key in (1, 2)]
    await settle()
    refused, other = desk.ask("a", 3), desk.ask("b", 3)
    with pytest.raises(BusyError, match=r"^busy: two calculations are running with this key$"):
        await refused
    for key, one in ((1, asking[0]), (3, other), (2, asking[1])):
        await settle()
        desk.ends[key].set_result("done")
        assert await one == "done"


async def test_a_failure_reaches_all_callers_and_frees_the_turn() -> None:
    desk = Desk()
    asking = [desk.ask(caller, 1) for caller in ("a", "b")]
    await settle()
    desk.ends[1].set_exception(ValueError("no model"))
    for one in asking:
        with pytest.raises(ValueError, match="no model"):
            await one
    last = desk.ask("a", 2)
    await settle()
    desk.ends[2].set_result("two")
    assert await last == "two"
