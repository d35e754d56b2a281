"""One live asset: it follows the machine whatever happens to its parts."""

import asyncio
import gc
import json
import weakref
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from jumping import LoopClock
from patience import wait_for, within

from adapters.samples import Quality, Sample
from service.domain.channels import NODES
from service.domain.requests import ProfileStep
from service.features.ledger.keeping import KeptForecastsOf
from service.live.asset import AssetRuntime
from service.live.twins import Twins

from .conftest import asset_section, make_version
from .warm_machine import WARM, running

PATIENCE_S = 30.0
STEPS = [ProfileStep(duration_s=1800.0, speed_rpm=2400.0, load_n=2650.0)]


async def test_it_starts_with_the_first_good_values_and_forecasts(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    live.start()
    assert live.tag("t_node_7_c.twin")["quality"] == Quality.WAITING_FOR_INITIAL_DATA
    assert dict(live.documents.state().nodes["t_node_7_c"]) == {
        "mean_c": None,
        "std_c": None,
        "known": False,
        "reason": "no estimate yet",
    }
    assert live.documents.forecast() is None
    assert live.documents.machine().estimate is None
    forecast = await live.until(live.documents.forecast, "a forecast", machine_at_rest)
    assert forecast.model_version == 1
    assert forecast.planned is False
    assert forecast.time_s[-1] == 4 * 3600
    assert live.tag("t_node_7_c.twin")["value"] == pytest.approx(23.0, abs=0.5)
    # The model was never identified.
    assert live.tag("t_inner_ring_c.forecast_max")["quality"] == Quality.UNCERTAIN
    assert dict(live.documents.summary().health) == {
        "status": "good",
        "twin_running": True,
        "channels_without_good_data": [],
    }


async def test_no_stale_value_is_shown_as_live(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    live = make_live()
    await running(live, machine_at_rest)
    await live.until(
        lambda: live.tag("t_inner_ring_c")["quality"] == Quality.LAST_KNOWN, "a stale value"
    )
    assert live.tag("t_inner_ring_c")["value"] is None
    assert live.tag("t_node_7_c.twin")["value"] is not None, "the twin goes on alone"
    assert "t_inner_ring_c" in live.documents.summary().health.channels_without_good_data


async def test_a_forecast_that_fails_does_not_end_the_twin(make_live: Callable[..., Any]) -> None:
    live = make_live(active=make_version(1, designation="6016"))  # not the asset's bearing
    await running(live, WARM)
    began_us = live.runtime.estimate.time_us
    await live.until(
        lambda: live.runtime.estimate.time_us > began_us + 600 * 1_000_000, "steps", WARM
    )
    assert live.documents.forecast() is None
    assert live.documents.running
    live.runtime.switch(make_version(2))
    forecast = await live.until(live.documents.forecast, "a forecast", WARM)
    assert forecast.model_version == 2


async def test_an_absurd_value_does_not_end_the_twin(make_live: Callable[..., Any]) -> None:
    """Nothing bounds a pushed value; the model runs away from this one and starts anew."""
    live = make_live()
    await running(live, WARM)
    absurd = WARM | {"t_inner_ring_c": 1e300}
    await live.until(lambda: not live.runtime.estimate.started, "the failure", absurd)
    assert live.tag("t_node_7_c.twin")["value"] is None
    await live.until(
        lambda: (live.tag("t_inner_ring_c.twin")["value"] or 0) == pytest.approx(55.0, abs=1.5),
        "a new start",
        WARM,
    )


async def test_a_store_that_takes_no_state_does_not_end_the_twin(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = make_live()
    monkeypatch.setattr("service.live.twins.SAVE_EVERY_WALL_S", 0.1)
    live.store_is_away = True
    await running(live, WARM)
    await live.until(lambda: live.refused > 3, "states that the store did not take", WARM)
    assert not live.saved
    assert live.documents.running
    live.store_is_away = False
    await live.until(lambda: live.saved, "a kept state", WARM)
    live.store_is_away = True
    await live.stop()
    assert live.task.cancelled()


async def test_a_twin_that_collections_of_garbage_pass_over_goes_when_it_has_ended(
    make_live: Callable[..., Any],
) -> None:
    live, twins = make_live(), Twins(LoopClock(600.0, 0))
    live.runtime.follow_forecasts(KeptForecastsOf(live.runtime, live.clock, lambda issued: None))

    async def follow(twin: AssetRuntime) -> None:
        with twins.stepping(twin):
            await twin.run(None)

    stepping = asyncio.create_task(twins.run())
    live.task = asyncio.create_task(follow(live.runtime))
    await live.until(live.runtime.documents.forecast, "a forecast", WARM)
    gc.freeze()  # as the cell does
    try:
        await live.stop()
        ended = weakref.ref(live.runtime), weakref.ref(live.runtime.estimate)
        live.runtime = live.task = None
        stepping.cancel()
        await asyncio.wait({stepping})
        gc.collect()
        assert [one() for one in ended] == [None, None]
    finally:
        gc.unfreeze()


async def test_what_was_kept_is_taken_up(make_live: Callable[..., Any]) -> None:
    first = make_live()
    await running(first, WARM)
    await first.until(lambda: first.runtime.estimate.observer.revolutions > 0, "turning", WARM)
    await first.stop()
    kept = json.loads(json.dumps(first.saved[-1]))
    second = make_live()
    second.start(kept)
    await asyncio.sleep(0)
    assert second.runtime.estimate.started
    before = first.runtime.estimate.observer
    assert second.runtime.estimate.observer.revolutions == before.revolutions
    assert second.runtime.estimate.observer.sensor("t_inner_ring_c") == pytest.approx(
        before.sensor("t_inner_ring_c")
    )


@pytest.mark.parametrize("ahead_s", [0, 31 * 3600])
async def test_the_first_forecast_after_a_restart_does_not_wait_for_its_period(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, ahead_s: int
) -> None:
    """Also when the kept estimate lies ahead of the clock, as after a run of a faster one."""
    first = make_live()
    await running(first, WARM)
    await first.stop()
    kept = json.loads(json.dumps(first.saved[-1]))
    kept["time_us"] += ahead_s * 1_000_000
    monkeypatch.setattr("service.live.forecast_loop.FORECAST_EVERY_S", 1e6)
    second = make_live()
    second.start(kept)
    await second.until(second.runtime.documents.forecast, "a forecast", WARM)


@pytest.mark.parametrize("kept", [{}, {"observer": {"state": []}, "time_us": 1}])
async def test_a_kept_state_of_another_kind_is_left_aside(
    make_live: Callable[..., Any], kept: dict[str, Any]
) -> None:
    live = make_live()
    live.start(kept)
    await live.until(lambda: live.runtime.estimate.started, "a start", WARM)


async def test_a_switch_leaves_no_gap(make_live: Callable[..., Any]) -> None:
    live = make_live()
    await running(live, WARM)
    before = live.tag("t_node_7_c.twin")["value"]
    live.runtime.switch(make_version(2, z=0.2))
    assert live.tag("t_node_7_c.twin")["value"] == before
    assert live.tag("model.version")["value"] == 2
    assert live.documents.state().model_version == 2
    await live.until(
        lambda: (f := live.documents.forecast()) and f.model_version == 2, "its forecast", WARM
    )


async def test_the_plan_is_followed_while_it_is_fresh(make_live: Callable[..., Any]) -> None:
    live = make_live()
    live.start()

    def planned() -> Any:
        live.plan((1800.0, 2400.0, 2650.0), (3600.0, 6200.0, 5500.0))
        forecast = live.documents.forecast()
        return forecast if forecast and forecast.planned else None

    forecast = await live.until(planned, "a forecast along the plan", WARM)
    assert [step.speed_rpm for step in forecast.profile] == [2400.0, 6200.0]
    controller = live.documents.summary().controller
    assert [step.load_n for step in controller.plan] == [2650.0, 5500.0]
    # A controller that has fallen silent (30 s, here 1.5 s of wall time) plans nothing.
    held = await live.until(
        lambda: (f := live.documents.forecast()) and not f.planned and f, "the point held", WARM
    )
    assert [step.speed_rpm for step in held.profile] == [2400.0]


async def test_a_model_that_was_never_identified_raises_no_forecast_alarm(
    make_live: Callable[..., Any],
) -> None:
    """As long as the verdict on the steps is unknown; with the first identification it speaks."""
    live = make_live()
    live.start()

    def plan() -> None:
        live.plan((600.0, 2400.0, 2650.0), (14_400.0, 12_000.0, 20_000.0))

    def predicted() -> list[str]:
        return [one.channel for one in live.alarms.active() if one.kind == "forecast limit"]

    def hot() -> bool:
        plan()
        forecast = live.documents.forecast()
        return forecast is not None and any(
            levels["warning"].probability > 0.5 for levels in forecast.time_to_limit.values()
        )

    await live.until(hot, "a forecast over a limit", WARM)
    began_us = live.clock.now_us()
    await live.until(lambda: plan() or live.clock.now_us() > began_us + 300e6, "5 min", WARM)
    assert predicted() == []
    said = live.documents.verdict()
    assert {said.present_step.word, said.next_step.word} == {"unknown"}
    assert live.tag("t_inner_ring_c.forecast_max")["quality"] == Quality.UNCERTAIN
    live.runtime.switch(replace(make_version(2), identified_at_us=1))
    await live.until(lambda: plan() or predicted(), "the alarm", WARM)
    assert live.tag("t_inner_ring_c.forecast_max")["quality"] == Quality.GOOD
    live.runtime.switch(make_version(1))
    live.runtime.look()
    await live.until(
        lambda: plan() or {one.state for one in live.alarms.active() if one.predicted} == {"RTNUN"},
        "the end of an alarm of a model that does not speak any more",
        WARM,
    )


async def test_a_plan_for_a_hot_stage_raises_the_forecast_alarm(
    make_live: Callable[..., Any],
) -> None:
    live = make_live(active=replace(make_version(), identified_at_us=1))
    subscription = live.subscribe()
    live.plan((600.0, 2400.0, 2650.0), (14_400.0, 12_000.0, 20_000.0))
    live.start()
    alarm = await live.until(
        lambda: next((a for a in live.alarms.active() if a.kind == "forecast limit"), None),
        "the alarm",
        WARM,
    )
    assert alarm.predicted
    assert alarm.channel == "t_inner_ring_c"
    assert alarm.probability > 0.2
    assert 0 < alarm.lead_time_s < 14_400
    earliest_s = live.documents.forecast().time_to_limit["t_inner_ring_c"][alarm.level].earliest_s
    assert alarm.lead_time_s == pytest.approx(earliest_s, abs=600)
    seen = set()
    while "alarm" not in seen:
        seen.add((await wait_for(subscription.get(), 30)).type)
    assert "forecast" in seen


async def test_late_samples_are_not_sent_as_live(make_live: Callable[..., Any]) -> None:
    live = make_live()
    subscription = live.subscribe()
    live.start()
    now_us = live.clock.now_us()
    newest = Sample("bench-1", "t_inner_ring_c", now_us, 55.0, 192, now_us)
    older = Sample("bench-1", "t_inner_ring_c", now_us - 5_000_000, 54.0, 192, now_us)
    live.runtime.take([newest, older], [])
    message = await wait_for(subscription.get(), 30)
    while message.type != "measurement":
        message = await wait_for(subscription.get(), 30)
    (sent,) = json.loads(message.text)["data"]["samples"]
    assert sent["value"] == 55.0


async def test_estimates_go_to_the_store_once_a_minute(make_live: Callable[..., Any]) -> None:
    live = make_live()
    await running(live, WARM)
    await live.until(lambda: len(live.stored) >= 6, "estimates", WARM)
    channels = {sample.channel for sample in live.stored}
    assert channels == {"t_inner_ring_c.twin", "t_outer_ring_c.twin"}
    times = [s.time_us for s in live.stored if s.channel == "t_inner_ring_c.twin"]
    assert all(b - a >= 59_000_000 for a, b in pairwise(times))


async def test_what_if_answers_from_the_present_state(make_live: Callable[..., Any]) -> None:
    live = make_live()
    await running(live, WARM)
    answer = live.what_if(STEPS, 600.0, ["t_node_7_c", "t_inner_ring_c"])
    assert answer.time_s == [0.0, 600.0, 1200.0, 1800.0]
    assert list(answer.nodes) == ["t_node_7_c", "t_inner_ring_c"]
    assert answer.nodes["t_inner_ring_c"].q50[0] == pytest.approx(55.0, abs=1.5)
    assert [dict(step) for step in answer.profile] == [
        {"duration_s": 1800.0, "speed_rpm": 2400.0, "load_n": 2650.0, "ambient_c": 23.0}
    ]


async def test_an_asset_without_temperatures_only_shows_what_it_has(
    make_live: Callable[..., Any],
) -> None:
    live = make_live(asset_section(("speed_rpm", "load_n")))
    live.start()
    await live.until(
        lambda: live.tag("speed_rpm")["value"] == 1500.0,
        "speed",
        {"speed_rpm": 1500.0, "load_n": 2650.0},
    )
    for _ in range(60):
        live.feed({"speed_rpm": 1500.0, "load_n": 2650.0})
        await live.clock.sleep(60.0)
    assert not live.runtime.estimate.started, "an hour later"
    assert live.documents.summary().health.twin_running is False
    assert live.tag("t_inner_ring_c.forecast_max")["value"] is None
    assert not live.task.done()


async def test_a_limit_on_a_node_is_shown_but_not_predicted(make_live: Callable[..., Any]) -> None:
    limits = {"t_node_7_c": {"warning": 60, "alarm": 80}}
    live = make_live(asset_section(limits=limits))
    live.start()
    forecast = await live.until(live.documents.forecast, "a forecast", WARM)
    assert {name: dict(pair) for name, pair in forecast.limits.items()} == limits
    assert forecast.time_to_limit == {}
    assert live.tag("t_node_7_c.forecast_max")["value"] == max(forecast.nodes["t_node_7_c"].q50)
    assert live.tag("t_node_7_c.time_to_warning_s")["quality"] < 192
    assert set(live.documents.state().nodes) == set(NODES)


async def test_a_snapshot_stays_the_same_object_until_a_tag_changes(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    await running(live, WARM)
    first = live.documents.snapshot()
    assert live.documents.snapshot() is first
    live.feed(WARM | {"t_inner_ring_c": 55.5})
    second = live.documents.snapshot()
    assert second is not first
    assert second["tags"]["t_inner_ring_c"]["value"] == 55.5


async def test_state_messages_carry_the_estimates_of_the_sensors(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    subscription = live.subscribe()
    await running(live, WARM)
    async with within(30):
        while (message := await subscription.get()).type != "state":
            live.feed(WARM)
    data = json.loads(message.text)["data"]
    assert {one["channel"] for one in data["samples"]} == {
        "t_inner_ring_c.twin",
        "t_outer_ring_c.twin",
    }
    for one in data["samples"]:
        assert 20.0 < one["value"] < 80.0
        assert (one["quality"], one["time"]) == (192, data["time"])


@pytest.mark.parametrize("speed_rpm", [1e9, 1e308, -1e9])
async def test_an_impossible_speed_never_ages_the_grease(
    make_live: Callable[..., Any], speed_rpm: float
) -> None:
    """Thirteen seconds of 1e9 rpm made 147 million revolutions of 255."""
    live = make_live()
    await running(live, WARM)
    await live.until(lambda: live.documents.state().revolutions > 100, "turning", WARM)
    began_us, before = live.clock.now_us(), live.documents.state().revolutions
    await live.until(
        lambda: live.clock.now_us() - began_us > 600_000_000, "10 min", WARM | {
            "speed_rpm": speed_rpm
        },
    )  # fmt: skip
    live.documents.changed()
    assert live.tag("verdict.now")["value"] == 0, "the twin does not run on it"
    await live.until(lambda: live.runtime.estimate.started, "a new start", WARM)
    minutes = (live.clock.now_us() - began_us) / 60e6
    assert live.documents.state().revolutions <= before + WARM["speed_rpm"] * minutes


async def test_a_machine_that_turns_backwards_is_not_taken_for_standing(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    await running(live, WARM | {"speed_rpm": -2400.0})
    assert live.runtime.estimate.point.speed_rpm == 2400.0
