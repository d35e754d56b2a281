import asyncio
import json
import threading

import pytest
from jumping import work
from patience import wait_for, within

from service.bus.stream import LiveMessages
from service.bus.subscription import Subscription, SubscriptionClosedError
from service.clock import ProcessClock


def make_bus(**limits: int) -> LiveMessages:
    return LiveMessages(ProcessClock(120.0, (0.0, 1_700_000_000_000_000)), "epoch-1", **limits)


async def read(subscription: Subscription, count: int) -> list[dict]:
    async with within(20):
        return [json.loads((await subscription.get()).text) for _ in range(count)]


async def test_message_has_the_contract_shape_and_null_for_nan() -> None:
    bus = make_bus()
    subscription = bus.subscribe()
    bus.publish("state", "bench-1", {"nodes": {"t_node_1_c": float("nan")}}, time_us=1_000_000)
    (message,) = await read(subscription, 1)
    assert set(message) == {"type", "seq", "epoch", "asset", "time", "sent_at", "data"}
    assert message["type"] == "state"
    assert message["seq"] == 1
    assert message["epoch"] == "epoch-1"
    assert message["asset"] == "bench-1"
    assert message["time"] == "1970-01-01T00:00:01.000Z"
    assert message["sent_at"].startswith("20")
    assert message["data"] == {"nodes": {"t_node_1_c": None}}


async def test_numbers_are_global_and_subscribers_get_their_assets_and_the_common_ones() -> None:
    bus = make_bus()
    mine, everything = bus.subscribe(["a"]), bus.subscribe()
    bus.publish("state", "a", {})
    bus.publish("state", "b", {})
    bus.publish("health", None, {})
    assert [(m["seq"], m["asset"]) for m in await read(mine, 2)] == [(1, "a"), (3, None)]
    assert [m["seq"] for m in await read(everything, 3)] == [1, 2, 3]


async def test_resume_gives_exactly_what_was_missed() -> None:
    bus = make_bus()
    for _ in range(5):
        bus.publish("state", "a", {})
    resumed = bus.subscribe(["a"], resume_from=2)
    assert (resumed.gap, resumed.start_seq) == (False, 2)
    bus.publish("state", "a", {})
    assert [m["seq"] for m in await read(resumed, 4)] == [3, 4, 5, 6]


async def test_resume_at_the_latest_message_is_no_gap() -> None:
    bus = make_bus()
    bus.publish("state", "a", {})
    assert not bus.subscribe(resume_from=1).gap


@pytest.mark.parametrize("resume_from", [0, 1, 7, -1])
async def test_a_resume_point_that_is_gone_or_never_was_is_a_gap(resume_from: int) -> None:
    bus = make_bus(history_messages=3)
    for _ in range(5):
        bus.publish("state", "a", {})
    subscription = bus.subscribe(resume_from=resume_from)
    assert subscription.gap
    assert subscription.start_seq == 5
    bus.publish("state", "a", {})
    assert [m["seq"] for m in await read(subscription, 1)] == [6]


async def test_history_is_bounded_in_bytes() -> None:
    bus = make_bus(history_bytes=5000)
    for _ in range(10):
        bus.publish("forecast", "a", {"text": "x" * 1000})
    assert not bus.subscribe(resume_from=7).gap
    assert bus.subscribe(resume_from=5).gap


async def test_resuming_over_more_than_may_wait_loses_nothing() -> None:
    bus = make_bus()
    for _ in range(50):
        bus.publish("measurement", "a", {})
    resumed = bus.subscribe(resume_from=0, capacity=4)
    assert [m["seq"] for m in await read(resumed, 50)] == list(range(1, 51))
    assert resumed.dropped == 0


async def test_slow_subscriber_loses_measurements_then_forecasts_but_no_alarm() -> None:
    bus = make_bus()
    slow = bus.subscribe(capacity=4)
    for type_ in ("alarm", "forecast", "measurement", "state", "job", "alarm", "alarm"):
        bus.publish(type_, "a", {})  # type: ignore[arg-type]
    assert slow.dropped == 3
    assert [m["type"] for m in await read(slow, 4)] == ["alarm", "job", "alarm", "alarm"]


async def test_oldest_measurement_goes_first() -> None:
    bus = make_bus()
    slow = bus.subscribe(capacity=3)
    for number in range(6):
        bus.publish("measurement", "a", {"number": number})
    assert [m["data"]["number"] for m in await read(slow, 3)] == [3, 4, 5]


async def test_subscriber_that_alarms_alone_overflow_is_cut_off_with_a_reason() -> None:
    bus = make_bus()
    slow, other = bus.subscribe(capacity=2), bus.subscribe()
    for _ in range(3):
        bus.publish("alarm", "a", {})
    assert bus.subscribers == 1
    with pytest.raises(SubscriptionClosedError, match="overflow"):
        await read(slow, 4)
    assert len(await read(other, 3)) == 3


async def test_get_waits_for_a_message_from_another_thread() -> None:
    bus = make_bus()
    subscription = bus.subscribe()
    waiting = asyncio.create_task(subscription.get())
    await asyncio.sleep(0.01)
    assert not waiting.done()
    threading.Thread(target=lambda: bus.publish("alarm", "a", {})).start()
    with work():
        assert (await wait_for(waiting, 30)).type == "alarm"


async def test_messages_of_many_threads_are_numbered_without_hole_and_in_order() -> None:
    bus = make_bus()
    subscription = bus.subscribe(capacity=1000)

    def publish() -> None:
        for _ in range(100):
            bus.publish("alarm", "a", {})

    threads = [threading.Thread(target=publish) for _ in range(4)]
    for thread in threads:
        thread.start()
    with work():
        messages = await read(subscription, 400)
    for thread in threads:
        thread.join()
    assert [m["seq"] for m in messages] == list(range(1, 401))


async def test_close_ends_waiting_and_later_subscriptions() -> None:
    bus = make_bus()
    subscription = bus.subscribe()
    waiting = asyncio.create_task(subscription.get())
    await asyncio.sleep(0)
    bus.close("stopping")
    with pytest.raises(SubscriptionClosedError, match="stopping"):
        await wait_for(waiting, 30)
    with pytest.raises(SubscriptionClosedError):
        await wait_for(bus.subscribe().get(), 30)
    assert bus.subscribers == 0


async def test_closed_subscription_gets_nothing_more() -> None:
    bus = make_bus()
    subscription = bus.subscribe()
    subscription.close()
    bus.publish("state", "a", {})
    with pytest.raises(SubscriptionClosedError):
        await subscription.get()


async def test_heartbeats_are_numbered_but_not_replayed() -> None:
    bus = make_bus()
    bus.publish("state", "a", {})
    bus.publish("heartbeat", None, {})
    bus.publish("state", "a", {})
    assert [m["seq"] for m in await read(bus.subscribe(resume_from=0), 2)] == [1, 3]
