"""The verdict is told when it changes, and not made again while nothing has changed."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest
from patience import wait_for

from adapters.samples import Quality

WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 55.0,
    "t_outer_ring_c": 38.0,
}
HOT = WARM | {"t_inner_ring_c": 75.0}  # over the warning of 70
PATIENCE_S = 60.0


async def words(subscription: Any) -> tuple[str, list[str]]:
    """The next verdict of this moment that is told."""
    while True:
        message = await wait_for(subscription.get(), PATIENCE_S)
        if message.type == "verdict":
            data = json.loads(message.text)["data"]
            return data["now"]["word"], data["missing"]


@pytest.fixture
def only_news(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is told again because it is old."""
    monkeypatch.setattr("service.live.publishing.VERDICT_EVERY_WALL_S", 1e9)


@pytest.mark.usefixtures("only_news")
async def test_limits_bad_samples_and_silence_are_told_without_being_asked(
    make_live: Callable[..., Any],
) -> None:
    live = make_live(max_age_s=3600.0)
    subscription = live.subscribe()
    live.start()
    await live.until(lambda: live.runtime.estimate.started, "a start", WARM)

    async def until(word: str, missing: str = "") -> None:
        """Wait for a word; on a slow machine others may be told before, and more be missing."""
        while True:
            told, without = await words(subscription)
            if told == word and (not missing or missing in without):
                assert word != "safe" or "t_inner_ring_c" not in without
                return

    await until("safe")
    live.feed(HOT)
    await until("not safe")
    live.feed({"t_inner_ring_c": 75.0}, Quality.SENSOR_FAILURE)
    await until("unknown", missing="t_inner_ring_c")  # a broken sensor
    live.feed(WARM)
    await until("safe")
    # Nothing comes any more: the channels get stale by time alone.
    await until("unknown", missing="t_inner_ring_c")
    live.feed(WARM)
    await until("safe")


@pytest.mark.usefixtures("only_news")
async def test_a_machine_in_which_nothing_changes_costs_no_verdicts(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = make_live(max_age_s=1800.0)
    monkeypatch.setattr("service.live.forecast_loop.FORECAST_EVERY_S", 1e6)
    made = 0
    verdict = live.documents.verdict

    def counted() -> Any:
        nonlocal made
        made += 1
        return verdict()

    monkeypatch.setattr(live.documents, "verdict", counted)
    live.start()
    await live.until(live.documents.forecast, "a forecast", WARM)
    looks = 0
    before = made
    end_us = live.clock.now_us() + 4 * 3600 * 1_000_000
    while live.clock.now_us() < end_us:
        live.feed(WARM)
        looks += 1
        await asyncio.sleep(0.02)
    assert looks > 50
    assert made - before < looks / 5


async def test_a_load_that_may_be_in_kilonewtons_is_among_the_reasons(
    make_live: Callable[..., Any],
) -> None:
    live = make_live(max_age_s=3600.0)
    live.start()
    await live.until(lambda: live.runtime.estimate.started, "a start", WARM)

    def is_doubted() -> bool:
        return "load below 45 N at this speed: kN?" in live.documents.verdict().now.reasons

    assert not is_doubted()
    await live.until(is_doubted, "a doubt", WARM | {"load_n": 2.65})
    live.feed(WARM)
    await live.until(lambda: not is_doubted(), "no doubt", WARM)
