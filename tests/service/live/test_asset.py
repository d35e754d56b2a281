"""One live asset: it follows the machine whatever happens to its parts."""

import asyncio
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import pytest

from adapters.samples import Quality, Sample
from service.cell.keeping import StateKeeper
from service.domain.channels import NODES
from service.domain.errors import NotReadyError
from service.domain.requests import ProfileStep
from service.live.kept import KeptState
from service.store import AuditEntry

PATIENCE_S = 30.0
WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 55.0,
    "t_outer_ring_c": 38.0,
}
STEPS = [ProfileStep(duration_s=1800.0, speed_rpm=2400.0, load_n=2650.0)]


async def running(live: Any, values: dict[str, float]) -> None:
    live.start()
    await live.until(lambda: live.runtime.estimate.started, "a start", values)


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
    assert live.tag("t_inner_ring_c.forecast_max")["quality"] == Quality.GOOD
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


async def test_a_forecast_that_fails_does_not_end_the_twin(
    make_live: Callable[..., Any], make_version: Callable[..., Any]
) -> None:
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
    monkeypatch.setattr("service.live.asset.SAVE_EVERY_WALL_S", 0.1)
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
    monkeypatch.setattr("service.live.asset.FORECAST_EVERY_S", 1e6)
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


async def test_a_switch_leaves_no_gap(
    make_live: Callable[..., Any], make_version: Callable[..., Any]
) -> None:
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


async def test_a_plan_for_a_hot_stage_raises_the_forecast_alarm(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
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
        seen.add((await asyncio.wait_for(subscription.get(), 30)).type)
    assert "forecast" in seen


async def test_late_samples_are_not_sent_as_live(make_live: Callable[..., Any]) -> None:
    live = make_live()
    subscription = live.subscribe()
    live.start()
    now_us = live.clock.now_us()
    newest = Sample("bench-1", "t_inner_ring_c", now_us, 55.0, 192, now_us)
    older = Sample("bench-1", "t_inner_ring_c", now_us - 5_000_000, 54.0, 192, now_us)
    live.runtime.take([newest, older], [])
    message = await asyncio.wait_for(subscription.get(), 30)
    while message.type != "measurement":
        message = await asyncio.wait_for(subscription.get(), 30)
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
    make_live: Callable[..., Any], make_section: Callable[..., Any]
) -> None:
    live = make_live(make_section(("speed_rpm", "load_n")))
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


async def test_a_limit_on_a_node_is_shown_but_not_predicted(
    make_live: Callable[..., Any], make_section: Callable[..., Any]
) -> None:
    limits = {"t_node_7_c": {"warning": 60, "alarm": 80}}
    live = make_live(make_section(limits=limits))
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
    async with asyncio.timeout(30):
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


async def test_renewed_grease_counts_from_zero_and_after_a_restart_too(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    with pytest.raises(NotReadyError):
        await live.runtime.renew_grease("engineer eva", "")
    await running(live, WARM)
    await live.until(lambda: live.documents.state().revolutions > 1000, "turning", WARM)
    live.saved.clear()
    answer = await live.runtime.renew_grease("engineer eva", "regreased")
    assert answer.revolutions_before > 1000
    assert answer.revolutions == 0
    assert live.saved[0]["observer"]["revolutions"] == 0.0
    await live.stop()
    again = make_live()
    again.start(json.loads(json.dumps(live.saved[0])))
    await asyncio.sleep(0)
    assert again.runtime.estimate.revolutions == 0.0
    assert live.alarms._outbox.flush(30)
    (event,) = [line for line in live.store.alarms.journal().items if line.kind == "grease renewed"]
    assert (event.who, event.comment) == ("engineer eva", "regreased")


async def test_the_line_of_renewed_grease_is_kept_with_the_first_state_that_has_it(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    await running(live, WARM)
    line = AuditEntry(1, "engineer eva", "", "asset.grease-renewed")
    live.store_is_away = True
    with pytest.raises(OSError, match="no space left"):
        await live.runtime.renew_grease("engineer eva", "", line)
    live.store_is_away = False
    live.saved.clear()
    await live.until(lambda: live.saved, "the next state", WARM)
    await live.runtime._keep_state()
    assert live.audit == [line], "once, with the state that has it"


async def test_a_line_on_its_way_is_not_sent_again_when_who_waits_for_it_leaves(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = make_live()
    await running(live, WARM)
    begun, go_on = threading.Event(), threading.Event()
    written: list[AuditEntry] = []

    def write(documents: Mapping[str, KeptState], lines: Sequence[AuditEntry]) -> None:
        begun.set()
        go_on.wait(PATIENCE_S)
        written.extend(lines)

    save = partial(StateKeeper(write).save, live.runtime.id)
    monkeypatch.setattr(live.runtime, "_save_state", save)
    line = AuditEntry(1, "engineer eva", "", "asset.grease-renewed")
    calling = asyncio.create_task(live.runtime.renew_grease("engineer eva", "", line))
    assert await asyncio.to_thread(begun.wait, PATIENCE_S)
    calling.cancel()
    await asyncio.wait({calling})
    go_on.set()
    await live.runtime._keep_state()
    assert written == [line]
