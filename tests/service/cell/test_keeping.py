"""States of many twins go together, and each is told how its own ended."""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from patience import within

from service.cell.keeping import StateKeeper
from service.store import AuditEntry, Store


async def test_what_comes_together_is_written_together() -> None:
    written: list[Mapping[str, Mapping[str, Any]]] = []
    keeper = StateKeeper(lambda documents, lines: written.append(documents))
    await asyncio.gather(*(keeper.save(f"m{n}", {"n": n}) for n in range(50)))
    assert written == [{f"m{n}": {"n": n} for n in range(50)}]
    await keeper.save("m1", {"n": 2})
    assert written[1:] == [{"m1": {"n": 2}}]


async def test_who_comes_during_a_write_goes_with_the_next_and_the_newest_wins() -> None:
    loop, begun, go_on = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
    written: list[Mapping[str, Mapping[str, Any]]] = []

    def write(documents: Mapping[str, Mapping[str, Any]], lines: Sequence[AuditEntry]) -> None:
        loop.call_soon_threadsafe(begun.set)
        asyncio.run_coroutine_threadsafe(go_on.wait(), loop).result(30.0)
        written.append(documents)

    keeper = StateKeeper(write)
    first = keeper.save("a", {"n": 1})
    async with within(30.0):
        await begun.wait()
        later = [keeper.save("a", {"n": n}) for n in (2, 3)]
        await asyncio.sleep(0)
        assert not first.done()
        go_on.set()
        await asyncio.gather(first, *later)
    assert written == [{"a": {"n": 1}}, {"a": {"n": 3}}]


async def test_a_failure_reaches_all_who_wait_and_the_next_write_works() -> None:
    fails = True

    def write(documents: Mapping[str, Mapping[str, Any]], lines: Sequence[AuditEntry]) -> None:
        if fails:
            raise OSError("no space left on device")

    keeper = StateKeeper(write)
    ended = await asyncio.gather(*(keeper.save(name, {}) for name in "abc"), return_exceptions=True)
    assert [type(one) for one in ended] == [OSError] * 3
    fails = False
    await keeper.save("a", {})


async def test_one_who_leaves_does_not_take_the_others_along() -> None:
    written: list[Mapping[str, Mapping[str, Any]]] = []
    keeper = StateKeeper(lambda documents, lines: written.append(documents))
    leaving, staying = (asyncio.shield(keeper.save(name, {})) for name in "ab")
    await asyncio.sleep(0)
    leaving.cancel()
    await staying
    with pytest.raises(asyncio.CancelledError):
        await leaving
    assert set(written[0]) == {"a", "b"}


async def test_lines_of_the_audit_trail_go_with_the_states_that_they_are_about(
    tmp_path: Path,
) -> None:
    line = AuditEntry(time_us=1, who="dana", address="", action="renew grease", target="a")
    with Store.open("", tmp_path) as store:
        keeper = StateKeeper(store.states.save_all)
        await asyncio.gather(keeper.save("a", {"revolutions": 0.0}, [line]), keeper.save("b", {}))
        await keeper.save("a", {"revolutions": 1.0})
        assert store.states.load_all() == {"a": {"revolutions": 1.0}, "b": {}}
        assert [entry.who for entry in store.audit.page(10).items] == ["dana"]
