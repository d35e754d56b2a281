"""Requests to an OPC UA server as they are on the line, past what the library's client adds."""

from typing import Any

from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_from_binary
from patience import within

PATIENCE_S = 60.0


class Unknown(int):
    """A number that is no member of an enumeration, as a client may send it."""

    @property
    def value(self) -> int:
        return int(self)


async def ask(client: Client, request: Any) -> Any:
    """Send a request, and give the answer."""
    answer = await client.uaclient.protocol.send_request(request)
    name = type(request).__name__.replace("Request", "Response")
    return struct_from_binary(getattr(ua, name), answer)


async def status_of(client: Client, request: Any) -> str:
    """Name of the status of the whole service."""
    try:
        response = await ask(client, request)
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    return str(response.ResponseHeader.ServiceResult.name)


def read_of(
    *nodes: ua.ReadValueId, stamps: int = ua.TimestampsToReturn.Both, max_age: float = 0.0
) -> ua.ReadRequest:
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = list(nodes)
    request.Parameters.TimestampsToReturn = stamps
    request.Parameters.MaxAge = max_age
    return request


def subscribe(
    enabled: bool = True, interval_ms: float = 100, most: int = 0
) -> ua.CreateSubscriptionRequest:
    request = ua.CreateSubscriptionRequest()
    request.Parameters.RequestedPublishingInterval = interval_ms
    request.Parameters.RequestedLifetimeCount = 10_000
    request.Parameters.RequestedMaxKeepAliveCount = 1_000
    request.Parameters.MaxNotificationsPerPublish = most
    request.Parameters.PublishingEnabled = enabled
    return request


def monitor(
    subscription: int,
    node: str | ua.NodeId,
    filter: Any = None,
    attribute: int = 13,
    *,
    stamps: int = ua.TimestampsToReturn.Source,
    index_range: str | None = None,
    mode: int = ua.MonitoringMode.Reporting,
    **parameters: Any,
) -> ua.CreateMonitoredItemsRequest:
    """Ask for one item; ``parameters`` are those of `ua.MonitoringParameters`."""
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor.NodeId = ua.NodeId.from_string(node) if isinstance(node, str) else node
    item.ItemToMonitor.AttributeId = ua.AttributeIds(attribute)
    item.ItemToMonitor.IndexRange = index_range
    item.MonitoringMode = mode
    item.RequestedParameters = ua.MonitoringParameters(
        **({"QueueSize": 10, "Filter": filter} | parameters)
    )
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = subscription
    request.Parameters.TimestampsToReturn = stamps
    request.Parameters.ItemsToCreate = [item]
    return request


def publish(*acknowledged: tuple[int, int]) -> ua.PublishRequest:
    request = ua.PublishRequest()
    request.Parameters.SubscriptionAcknowledgements = [
        ua.SubscriptionAcknowledgement(*one) for one in acknowledged
    ]
    return request


async def next_notifications(client: Client) -> tuple[list[Any], bool]:
    """Give the changes of the next message that has any, and whether more are waiting."""
    async with within(PATIENCE_S):
        while True:
            answer = (await ask(client, publish())).Parameters
            if answer.NotificationMessage.NotificationData:
                (data,) = answer.NotificationMessage.NotificationData
                return data.MonitoredItems, answer.MoreNotifications
