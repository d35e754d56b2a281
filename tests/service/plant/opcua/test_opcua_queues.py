"""Subscriptions and their items do what the answers say: queues, modes, intervals (Part 4)."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_requests import (
    PATIENCE_S,
    Unknown,
    ask,
    monitor,
    next_notifications,
    publish,
    status_of,
    subscribe,
)
from opcua_site import RING, Asset, apart, inside, node_id
from patience import patience, within

from service.store import Outbox, Store

pytestmark = pytest.mark.wires
OVERFLOW = 0x0480
NODE = node_id(RING)
Modes = ua.MonitoringMode
Tell = Callable[..., Awaitable[None]]
Look = Callable[[Client, Tell], Coroutine[Any, Any, None]]


@pytest.fixture
def looking(
    tmp_path: Path, store: Store, outbox: Outbox
) -> Callable[[Look], Coroutine[Any, Any, None]]:
    """Run a client that can have the server take over values at once."""

    async def run(look: Look) -> None:
        asset, loop = Asset(), asyncio.get_running_loop()
        async with inside(asset, tmp_path, store, outbox) as served:

            async def tell(*values: float) -> None:
                for value in values:
                    asset.tell(RING, value)
                    done = asyncio.run_coroutine_threadsafe(served.rounds.publish_tags(), loop)
                    await asyncio.wrap_future(done)

            async def work() -> None:
                async with Client(served.address, timeout=patience(30)) as client:
                    await look(client, tell)

            await apart(work)

    return run


async def created(client: Client, request: ua.CreateMonitoredItemsRequest) -> Any:
    (result,) = (await ask(client, request)).Results
    return result


async def begin(client: Client, **more: Any) -> int:
    return int((await ask(client, subscribe(**more))).Parameters.SubscriptionId)


async def set_publishing(client: Client, number: int, enabled: bool) -> None:
    request = ua.SetPublishingModeRequest()
    request.Parameters = ua.SetPublishingModeParameters(enabled, [number])
    (status,) = (await ask(client, request)).Parameters.Results
    assert status.is_good()


async def set_mode(client: Client, number: int, item: int, mode: int) -> str:
    request = ua.SetMonitoringModeRequest()
    request.Parameters = ua.SetMonitoringModeParameters(number, mode, [item])
    (status,) = (await ask(client, request)).Parameters.Results
    return str(status.name)


async def change(client: Client, number: int, item: int, **parameters: Any) -> Any:
    """Modify an item; ``parameters`` are those of `ua.MonitoringParameters`."""
    one = ua.MonitoredItemModifyRequest(MonitoredItemId=item)
    one.RequestedParameters = ua.MonitoringParameters(**({"Filter": None} | parameters))
    request = ua.ModifyMonitoredItemsRequest()
    request.Parameters.SubscriptionId = number
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Server
    request.Parameters.ItemsToModify = [one]
    (result,) = (await ask(client, request)).Results
    return result


def shown(notifications: list[Any], handle: int = 0) -> list[tuple[float, int]]:
    """Values and status codes of the item with a handle."""
    return [
        (one.Value.Value.Value, one.Value.StatusCode.value)
        for one in notifications
        if one.ClientHandle == handle
    ]


async def test_the_value_next_to_a_loss_has_the_overflow_bit(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    kinds = ((2, True), (2, False), (1, True), (1, False), (100, True), (3, True))

    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client, enabled=False)
        for handle, (size, oldest) in enumerate(kinds):
            request = monitor(
                number, NODE, QueueSize=size, DiscardOldest=oldest, ClientHandle=handle
            )
            assert (await created(client, request)).RevisedQueueSize == size
        await tell(*range(1, 20))
        await set_publishing(client, number, True)
        found, _ = await next_notifications(client)
        everything = [(61.5, 0), *((float(k), 0) for k in range(1, 20))]
        for handle, expected in enumerate(
            (
                [(18.0, OVERFLOW), (19.0, 0)],
                [(61.5, 0), (19.0, OVERFLOW)],
                [(19.0, 0)],
                [(19.0, 0)],
                everything,
                [(17.0, OVERFLOW), (18.0, 0), (19.0, 0)],
            )
        ):
            assert shown(found, handle) == expected, kinds[handle]
        # The hole is marked once: not with the next value, nor to those who read.
        await tell(20)
        found, _ = await next_notifications(client)
        assert [one.Value.StatusCode.value for one in found] == [0] * len(kinds)
        read = await client.get_node(NODE).read_data_value()
        assert (read.Value.Value, read.StatusCode.value) == (20.0, 0)

    await looking(look)


async def test_items_have_the_range_and_the_times_that_were_asked_for(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client)
        for text, status in (
            ("0", "BadIndexRangeNoData"),
            ("3:1", "BadIndexRangeInvalid"),
            ("a:b", "BadIndexRangeInvalid"),
        ):
            result = await created(client, monitor(number, NODE, index_range=text))
            assert result.StatusCode.name == status
        for stamps in (ua.TimestampsToReturn.Invalid, Unknown(5)):
            request = monitor(number, NODE, stamps=stamps)
            assert await status_of(client, request) == "BadTimestampsToReturnInvalid"
        request = monitor(number, NODE, mode=Unknown(3))
        assert await status_of(client, request) == "BadMonitoringModeInvalid"
        namespaces = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
        request = monitor(number, namespaces, index_range="2", ClientHandle=9)
        assert (await created(client, request)).StatusCode.is_good()
        for stamps in range(4):
            request = monitor(
                number, NODE, stamps=ua.TimestampsToReturn(stamps), ClientHandle=stamps
            )
            assert (await created(client, request)).StatusCode.is_good()
        times: dict[int, tuple[bool, bool]] = {}
        while len(times) < 5:
            for one in (await next_notifications(client))[0]:
                value = one.Value
                source, server = value.SourceTimestamp, value.ServerTimestamp
                times[one.ClientHandle] = source is not None, server is not None
                if one.ClientHandle == 9:
                    assert value.Value.Value == ["urn:bearing-twin"]
        del times[9]
        assert times == {0: (True, False), 1: (False, True), 2: (True, True), 3: (False, False)}

    await looking(look)


async def test_an_item_that_samples_reports_nothing_and_a_disabled_one_forgets(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client)
        item = (await created(client, monitor(number, NODE, mode=Modes.Sampling))).MonitoredItemId
        witness = await created(client, monitor(number, NODE, ClientHandle=1))
        await tell(1, 2)
        seen: list[tuple[float, int]] = []
        while (2.0, 0) not in seen:
            found, _ = await next_notifications(client)
            assert shown(found) == []
            seen += shown(found, 1)
        assert await set_mode(client, number, witness.MonitoredItemId, Modes.Disabled) == "Good"
        assert await set_mode(client, number, item, Modes.Reporting) == "Good"
        found, _ = await next_notifications(client)
        assert shown(found) == [(61.5, 0), (1.0, 0), (2.0, 0)]
        # What waits when an item is disabled is not sent; enabled, it begins with the value.
        await set_publishing(client, number, False)
        await tell(3)
        assert await set_mode(client, number, item, Modes.Disabled) == "Good"
        await tell(4, 5)
        assert await set_mode(client, number, item, Modes.Reporting) == "Good"
        await set_publishing(client, number, True)
        found, _ = await next_notifications(client)
        assert shown(found) == [(5.0, 0)]
        assert await set_mode(client, number, 99_999, Modes.Reporting) == (
            "BadMonitoredItemIdInvalid"
        )

    await looking(look)


async def test_a_modified_item_is_as_the_answer_says(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client, enabled=False)
        deadband = ua.DataChangeFilter(DeadbandType=1, DeadbandValue=1000.0)
        made = await created(
            client, monitor(number, NODE, deadband, SamplingInterval=50.0, QueueSize=5000)
        )
        # The server looks at the tags each half a second, whatever is asked for.
        assert (made.RevisedSamplingInterval, made.RevisedQueueSize) == (500.0, 100)
        item = made.MonitoredItemId
        for size, revised in ((0, 100), (5000, 100), (3, 3)):
            result = await change(
                client, number, item, QueueSize=size, SamplingInterval=60.0, ClientHandle=7
            )
            assert (result.RevisedSamplingInterval, result.RevisedQueueSize) == (500.0, revised)
        await tell(1, 2, 3)  # the deadband is gone
        result = await change(client, number, item, QueueSize=2, ClientHandle=8)
        assert result.RevisedQueueSize == 2
        await set_publishing(client, number, True)
        found, _ = await next_notifications(client)
        assert shown(found, 7) == [(2.0, OVERFLOW), (3.0, 0)]
        await tell(4)
        found, _ = await next_notifications(client)
        assert shown(found, 8) == [(4.0, 0)]
        (only,) = found
        assert (only.Value.SourceTimestamp, only.Value.ServerTimestamp is None) == (None, False)

    await looking(look)


async def test_a_modified_subscription_is_as_the_answer_says(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client, interval_ms=3_600_000.0)
        assert (await created(client, monitor(number, NODE))).StatusCode.is_good()

        async def modify(interval_ms: float, lifetime: int, keep_alive: int) -> Any:
            request = ua.ModifySubscriptionRequest()
            request.Parameters = ua.ModifySubscriptionParameters(
                number, interval_ms, lifetime, keep_alive, MaxNotificationsPerPublish=3
            )
            answer = (await ask(client, request)).Parameters
            return (
                answer.RevisedPublishingInterval,
                answer.RevisedLifetimeCount,
                answer.RevisedMaxKeepAliveCount,
            )

        assert await modify(1.0, 100, 10) == (50.0, 100, 10)
        assert await modify(float("nan"), 5, 10) == (50.0, 30, 10)
        assert await modify(100.0, 20, 4) == (100.0, 20, 4)
        found, _ = await next_notifications(client)
        assert shown(found) == [(61.5, 0)]
        async with within(PATIENCE_S):  # alive each 0.4 s; it was each hour
            for _ in range(3):
                message = (await ask(client, publish())).Parameters.NotificationMessage
                assert message.NotificationData == []
        await tell(1)
        assert shown((await next_notifications(client))[0]) == [(1.0, 0)]
        request = ua.ModifySubscriptionRequest()
        request.Parameters = ua.ModifySubscriptionParameters(number + 1, 100.0, 100, 10)
        assert await status_of(client, request) == "BadSubscriptionIdInvalid"

    await looking(look)


async def test_a_message_has_as_many_values_as_the_client_takes(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client, enabled=False, most=3)
        for handle in (0, 1):
            await created(client, monitor(number, NODE, ClientHandle=handle))
        await tell(1, 2, 3)
        await set_publishing(client, number, True)
        messages = [await next_notifications(client) for _ in range(3)]
        assert [(len(found), more) for found, more in messages] == [
            (3, True),
            (3, True),
            (2, False),
        ]
        found = [one for message, _ in messages for one in message]
        for handle in (0, 1):
            assert shown(found, handle) == [(61.5, 0), (1.0, 0), (2.0, 0), (3.0, 0)]

    await looking(look)


async def test_what_is_not_done_has_no_good_status(
    looking: Callable[[Look], Coroutine[Any, Any, None]],
) -> None:
    async def look(client: Client, tell: Tell) -> None:
        number = await begin(client)
        move = ua.TransferSubscriptionsRequest()
        move.Parameters = ua.TransferSubscriptionsParameters([number, number + 1], True)
        results = (await ask(client, move)).Parameters.Results
        names = [one.StatusCode.name for one in results]
        assert names == ["BadNothingToDo", "BadSubscriptionIdInvalid"]
        for request in (
            ua.SetTriggeringRequest(),
            ua.HistoryUpdateRequest(),
            ua.QueryFirstRequest(),
            ua.QueryNextRequest(),
            ua.CancelRequest(),
        ):
            assert await status_of(client, request) == "BadServiceUnsupported", request
        methods, codes = ua.ObjectIds, ua.StatusCodes
        for method in (methods.Server_GetMonitoredItems, methods.Server_ResendData):
            argument = ua.Variant(number, ua.VariantType.UInt32)
            call = ua.CallMethodRequest(ua.NodeId(methods.Server), ua.NodeId(method), [argument])
            request = ua.CallRequest(Parameters=ua.CallParameters([call]))
            (result,) = (await ask(client, request)).Results
            assert result.StatusCode.is_bad()
        objects = ua.NodeId(methods.ObjectsFolder)
        browse = ua.BrowseRequest()
        browse.Parameters.NodesToBrowse = [
            ua.BrowseDescription(objects, direction) for direction in ua.BrowseDirection
        ]
        found = (await ask(client, browse)).Results
        bad = codes.BadBrowseDirectionInvalid
        assert [one.StatusCode.value for one in found] == [0, 0, 0, bad]
        browse.Parameters.View.ViewId = ua.NodeId("a view", 2)
        assert await status_of(client, browse) == "BadViewIdUnknown"

    await looking(look)
