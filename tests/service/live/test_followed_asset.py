"""Live messages of an asset are made for those who follow it; its alarms come anyway."""

from collections.abc import Callable
from datetime import datetime
from typing import Any

HOT = {"t_inner_ring_c": 98.0, "t_outer_ring_c": 60.0}


async def test_of_an_asset_that_nobody_follows_only_alarms_are_sent(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    hot = machine_at_rest | HOT
    live.start()
    await live.until(lambda: live.documents.forecast() is not None, "a forecast", hot)
    await live.until(lambda: live.alarms.active(), "an alarm", hot)
    sent, _ = live.bus.after(0, 1000)
    assert {message.type for message in sent} == {"alarm"}


async def test_who_begins_to_follow_gets_state_and_verdict_soon(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.start()
    await live.until(lambda: live.documents.forecast() is not None, "a forecast", machine_at_rest)
    assert live.bus.seq == 0
    live.bus.follow(["bench-1"])

    def kinds() -> set[str]:
        return {message.type for message in live.bus.after(0, 1000)[0]}

    await live.until(
        lambda: {"measurement", "state", "verdict"} <= kinds(), "messages", machine_at_rest
    )


async def test_since_when_a_verdict_holds_is_known_though_nobody_looks(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.start()
    await live.until(lambda: live.documents.forecast() is not None, "a forecast", machine_at_rest)
    before = live.tag("verdict.now")["value"]
    hot_us = live.clock.now_us()
    await live.until(
        lambda: live.clock.now_us() - hot_us > 7200e6, "two hours", machine_at_rest | HOT
    )
    tag = live.tag("verdict.now")
    assert tag["value"] != before
    since_us = datetime.fromisoformat(tag["time"]).timestamp() * 1e6 - hot_us
    assert 0 <= since_us < 3600e6  # two hours later somebody looks, at 600 times the pace
