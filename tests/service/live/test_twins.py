"""All running twins are stepped by one loop, each once in a period."""

import asyncio
import contextlib
from types import SimpleNamespace
from typing import cast

import pytest
from jumping import LoopClock

from service.live.asset import STEP_S, AssetRuntime
from service.live.twins import Twins

PERIODS = 4


class Steps:
    """Stands for a runtime: it notes when it is stepped."""

    def __init__(self) -> None:
        self.documents = SimpleNamespace(running=True)
        self.readings = SimpleNamespace(take_means=dict)
        self.estimate = None
        self.stepped_s: list[float] = []
        self.told = 0

    def stepped(self, now_us: int, means: object, failure: object) -> None:
        self.stepped_s.append(now_us / 1e6)

    def tell(self, now_us: int) -> None:
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
    firsts_s = sorted(one.stepped_s[0] for one in all_of_them)
    assert firsts_s == pytest.approx([0.1 * (1 + number // 2) for number in range(100)], abs=0.01)
