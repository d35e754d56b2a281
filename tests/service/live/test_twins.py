"""All running twins are stepped by one loop, each once in a period."""

import asyncio
import contextlib
import time
from types import SimpleNamespace
from typing import cast

import pytest
from jumping import LoopClock

from service.live.asset import STEP_S, AssetRuntime
from service.live.twins import SAVE_EVERY_WALL_S, Twins
from service.pauses import STEP_S as STEP_WALL_S

PERIODS = 4


class Steps:
    """Stands for a runtime: it notes when it is stepped."""

    def __init__(self) -> None:
        self.estimates = True
        self.documents = SimpleNamespace(running=True)
        self.readings = SimpleNamespace(take_means=dict)
        self.estimate = None
        self.used = lambda now_us, means: means
        self.saving = SimpleNamespace(begin=self.save, ended=lambda error: None)
        self.stepped_s: list[float] = []
        self.saved_s: list[float] = []
        self.told = 0

    def stepped(self, now_us: int, failure: object) -> None:
        self.stepped_s.append(now_us / 1e6)

    def judge(self, now_us: int, means: object) -> None:
        assert self.stepped_s[-1] == now_us / 1e6

    def save(self) -> asyncio.Future[None]:
        loop = asyncio.get_running_loop()
        self.saved_s.append(loop.time())
        saved: asyncio.Future[None] = loop.create_future()
        saved.set_result(None)
        return saved

    def publish(self, now_us: int, wall_s: float) -> None:
        self.told += 1


async def test_each_is_stepped_once_in_a_period_and_they_take_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "service.live.twins.step_together", lambda estimates, now_us, means: [None] * len(means)
    )
    twins = Twins(LoopClock(1.0, 0))
    all_of_them = [Steps() for _ in range(100)]
    running = asyncio.create_task(twins.run())
    with contextlib.ExitStack() as following:
        for one in all_of_them:
            following.enter_context(twins.stepping(cast(AssetRuntime, one)))
        await asyncio.sleep(PERIODS * STEP_S + 0.05)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    for one in all_of_them:
        assert len(one.stepped_s) == PERIODS
        apart_s = [b - a for a, b in zip(one.stepped_s, one.stepped_s[1:], strict=False)]
        assert apart_s == pytest.approx([STEP_S] * (PERIODS - 1), abs=0.01)
        assert one.told >= PERIODS * STEP_S / 0.3
        assert len(one.saved_s) == PERIODS * STEP_S / SAVE_EVERY_WALL_S
    begun_s = {round(one.saved_s[0], 3) for one in all_of_them}
    assert {at_s - min(begun_s) for at_s in begun_s} == {0.0, 1.0, 2.0, 3.0, 4.0}, "in parts"
    firsts_s = sorted(one.stepped_s[0] for one in all_of_them)
    assert firsts_s == pytest.approx([0.1 * (1 + number // 2) for number in range(100)], abs=0.01)


async def test_all_else_has_its_turn_between_the_alarms_of_two_twins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A twin that ends in such a turn is judged no more."""
    monkeypatch.setattr(
        "service.live.twins.step_together", lambda estimates, now_us, means: [None] * len(means)
    )
    rounds: list[None] = []
    judged: list[tuple[int, Steps]] = []

    class Slow(Steps):
        def judge(self, now_us: int, means: object) -> None:
            time.sleep(STEP_WALL_S)
            judged.append((len(rounds), self))
            asyncio.get_running_loop().call_soon(rounds.append, None)
            last.documents.running = False

    monkeypatch.setattr("service.live.twins._GROUP_EVERY_WALL_S", STEP_S)
    twins = Twins(LoopClock(1.0, 0))
    all_of_them = [Slow() for _ in range(5)]
    last = all_of_them[-1]
    with contextlib.ExitStack() as following:
        for one in all_of_them:
            following.enter_context(twins.stepping(cast(AssetRuntime, one)))
        running = asyncio.create_task(twins.run())
        await asyncio.sleep(1.5 * STEP_S)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    assert judged == list(enumerate(all_of_them[:-1]))
