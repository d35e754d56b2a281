"""A live asset before there is what its estimates are computed with."""

import asyncio
from collections.abc import Callable
from typing import Any

from adapters.samples import Quality, Sample

from .warm_machine import WARM, waiting


async def test_measured_values_are_there_before_the_kernels_are(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.ready = asyncio.Event()
    live.start({"watch": {}})
    await live.until(
        lambda: live.tag("t_inner_ring_c")["quality"] == Quality.GOOD, "a reading", machine_at_rest
    )
    for _ in range(20):
        live.feed(machine_at_rest)
        await asyncio.sleep(1.0)
    assert not live.runtime.estimate.started
    assert live.documents.verdict().now.word == "unknown"
    assert dict(live.documents.summary().health)["twin_running"] is False
    live.ready.set()
    await live.until(lambda: live.runtime.estimate.started, "a start", machine_at_rest)


async def test_what_came_once_before_the_kernels_is_used(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.ready = asyncio.Event()
    live.start()
    live.feed(machine_at_rest)  # a broker keeps the last value of each
    await asyncio.sleep(0.5)
    live.ready.set()
    temperatures = {name: of for name, of in machine_at_rest.items() if name.startswith("t_")}
    await live.until(lambda: live.runtime.estimate.started, "a start", temperatures, 5.0)


async def test_what_came_before_the_kernels_is_where_a_kept_estimate_goes_on(
    make_live: Callable[..., Any],
) -> None:
    live = await waiting(make_live)
    live.feed(WARM | {"speed_rpm": 0.0, "load_n": 500.0})  # it sends changes only
    await asyncio.sleep(0.5)
    live.ready.set()
    temperatures = {name: of for name, of in WARM.items() if name.startswith("t_")}
    await live.until(lambda: live.runtime._had_started, "a step", temperatures)
    assert (live.runtime.estimate.point.speed_rpm, live.runtime.estimate.point.load_n) == (0, 500)


async def test_a_sample_of_a_channel_that_was_removed_disturbs_no_step(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.start()
    live.runtime.readings.latest["t_removed_c"] = sample_of("t_removed_c", live.clock.now_us())
    await live.until(lambda: live.runtime.estimate.started, "a start", machine_at_rest)


def sample_of(channel: str, now_us: int) -> Sample:
    return Sample("bench-1", channel, now_us, 20.0, Quality.GOOD, now_us)


async def test_no_forecast_is_made_from_before_the_start(
    make_live: Callable[..., Any],
) -> None:
    live = await waiting(make_live)
    await asyncio.sleep(0.1)
    live.plan((0.0, 2400.0, 2650.0))  # wants a forecast
    live.clock._start_us += 1_000_000_000
    live.ready.set()
    begun_us = live.clock.now_us()
    await live.until(live.documents.forecast, "a forecast", WARM)
    assert live.runtime.forecast_age_s() < (live.clock.now_us() - begun_us) / 1e6 + 10.0


async def test_alarms_do_not_wait_for_the_kernels(make_live: Callable[..., Any]) -> None:
    live = await waiting(make_live)
    followed_s = live.runtime._waits["followed_s"]
    hot = WARM | {"t_inner_ring_c": 97.0}
    (alarm,) = await live.until(
        lambda: [one for one in live.alarms.active("bench-1") if one.level == "alarm"], "it", hot
    )
    assert (alarm.kind, alarm.channel, alarm.value) == ("measured limit", "t_inner_ring_c", 97.0)
    assert live.documents.verdict().now.word == "unknown"
    assert not live.runtime.estimate.started
    # What was kept is not lost by then.
    assert not live.saved
    live.ready.set()
    await live.until(lambda: live.runtime.estimate.started, "the kept estimate")
    assert live.runtime.estimate.followed_s > followed_s - 1.0
    await live.until(lambda: not live.alarms.present("bench-1"), "an end of the alarm", WARM)
