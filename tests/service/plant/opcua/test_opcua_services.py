"""Services that a client uses now and then, answered as Part 4 of OPC UA says."""

from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_requests import ask, monitor, publish, status_of, subscribe
from opcua_site import RING, Asset, apart, node_id, serving
from patience import patience

from service.plant.opcua.sessions import MOST_BROWSES
from service.store import Outbox, Store

pytestmark = pytest.mark.wires


def republish(subscription: int, sequence: int) -> ua.RepublishRequest:
    request = ua.RepublishRequest()
    request.Parameters = ua.RepublishParameters(subscription, sequence)
    return request


async def test_a_message_is_given_again_until_it_is_acknowledged(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:
                number = (await ask(client, subscribe())).Parameters.SubscriptionId
                await ask(client, monitor(number, node_id(RING)))
                first = (await ask(client, publish())).Parameters.NotificationMessage
                while not first.NotificationData:  # alive, before there was a value
                    first = (await ask(client, publish())).Parameters.NotificationMessage
                sequence = first.SequenceNumber
                for _ in range(2):
                    again = await ask(client, republish(number, sequence))
                    assert again.NotificationMessage == first
                for subscription, message, expected in (
                    (number, sequence + 1, "BadMessageNotAvailable"),
                    (number + 1, sequence, "BadSubscriptionIdInvalid"),
                ):
                    request = republish(subscription, message)
                    assert await status_of(client, request) == expected
                # The answer comes with the next value: which there is with another item.
                await ask(client, monitor(number, node_id(RING)))
                acknowledged = (number, sequence), (number, sequence), (number + 1, sequence)
                results = (await ask(client, publish(*acknowledged))).Parameters.Results
                names = [one.name for one in results]
                assert names == ["Good", "BadSequenceNumberUnknown", "BadSubscriptionIdInvalid"]
                request = republish(number, sequence)
                assert await status_of(client, request) == "BadMessageNotAvailable"

        await apart(look)


async def test_what_cannot_be_watched_is_refused_by_its_status(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    def deadband(kind: int, value: float) -> ua.DataChangeFilter:
        return ua.DataChangeFilter(DeadbandType=kind, DeadbandValue=value)

    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:
                number = (await ask(client, subscribe())).Parameters.SubscriptionId

                async def status(node: str, filter: Any = None, attribute: int = 13) -> str:
                    answer = await ask(client, monitor(number, node, filter, attribute))
                    return str(answer.Results[0].StatusCode.name)

                ring, events = node_id(RING), int(ua.AttributeIds.EventNotifier)
                assert await status(ring, deadband(1, 0.5)) == "Good"
                assert await status(ring, deadband(0, 0.0)) == "Good"
                assert await status(ring, deadband(1, -1.0)) == "BadDeadbandFilterInvalid"
                assert await status(ring, deadband(1, float("nan"))) == "BadDeadbandFilterInvalid"
                assert await status(ring, deadband(7, 1.0)) == "BadDeadbandFilterInvalid"
                percent = await status(ring, deadband(2, 1.0))
                assert percent == "BadMonitoredItemFilterUnsupported"
                assert await status("i=2253", ua.EventFilter(), events) == "BadAttributeIdInvalid"
                server = client.nodes.server
                notifier = await server.read_attribute(ua.AttributeIds.EventNotifier)
                assert notifier.Value.Value == 0

                created = await ask(client, monitor(number, ring))
                item = created.Results[0].MonitoredItemId

                async def change(item: int, filter: Any) -> str:
                    request = ua.ModifyMonitoredItemsRequest()
                    request.Parameters.SubscriptionId = number
                    one = ua.MonitoredItemModifyRequest(MonitoredItemId=item)
                    one.RequestedParameters.Filter = filter
                    request.Parameters.ItemsToModify = [one]
                    answer = await ask(client, request)
                    return str(answer.Results[0].StatusCode.name)

                assert await change(item, deadband(1, 2.0)) == "Good"
                assert await change(item, deadband(1, -2.0)) == "BadDeadbandFilterInvalid"
                assert await change(item + 99, None) == "BadMonitoredItemIdInvalid"

        await apart(look)


async def test_references_come_in_pages_of_the_size_that_is_asked_for(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:

                async def browse(most: int) -> Any:
                    request = ua.BrowseRequest()
                    request.Parameters.RequestedMaxReferencesPerNode = most
                    one = ua.BrowseDescription(
                        NodeId=ua.NodeId(ua.ObjectIds.Server),
                        BrowseDirection=ua.BrowseDirection.Forward,
                        ResultMask=ua.BrowseResultMask.All,
                    )
                    request.Parameters.NodesToBrowse = [one]
                    return (await ask(client, request)).Results[0]

                async def following(point: bytes, release: bool = False) -> Any:
                    request = ua.BrowseNextRequest()
                    request.Parameters.ContinuationPoints = [point]
                    request.Parameters.ReleaseContinuationPoints = release
                    return (await ask(client, request)).Parameters.Results[0]

                whole = await browse(0)
                assert len(whole.References) > 7
                assert not whole.ContinuationPoint
                page = await browse(3)
                found = list(page.References)
                while page.ContinuationPoint:
                    assert len(page.References) == 3
                    page = await following(page.ContinuationPoint)
                    found += page.References
                assert found == whole.References
                gone = await following(b"12345678")
                assert gone.StatusCode.name == "BadContinuationPointInvalid"
                points = [(await browse(1)).ContinuationPoint for _ in range(MOST_BROWSES)]
                assert (await browse(1)).StatusCode.name == "BadNoContinuationPoints"
                released = await following(points[0], release=True)
                assert (released.StatusCode.name, released.References) == ("Good", [])
                assert (await browse(1)).ContinuationPoint

                for name in ("ServerProfileArray", "LocaleIdArray", "MinSupportedSampleRate"):
                    number = getattr(ua.ObjectIds, f"Server_ServerCapabilities_{name}")
                    assert await client.get_node(number).read_value(), name

        await apart(look)
