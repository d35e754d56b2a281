"""Subscriptions that belong to one session, and are as their answers say."""

import asyncio
import secrets
from collections.abc import Callable, Iterable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.subscription_service import SubscriptionService

from service.plant.opcua.monitored_items import MonitoredItems

MOST_SUBSCRIPTIONS = 20
MOST_ITEMS = 20_000
SHORTEST_INTERVAL_MS = 50.0
#: Of a subscription whose client is silent, in keep-alive counts (Part 4).
_LEAST_LIFETIME = 3


class OwnSubscriptions(SubscriptionService):  # type: ignore[misc]  # the library has no types
    """The subscriptions of one session.

    The library keeps those of all sessions in one place, by numbers that follow each other, and
    does not ask whose they are: any client could end or take over any other's.
    """

    def __init__(self, aspace: AddressSpace, server: InternalServer) -> None:
        super().__init__(aspace, iserver=server)
        # One in a session may not have the number of one in another.
        self._sub_id_counter = secrets.randbits(31)

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: ua.NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Make one; no client makes the event loop publish without a pause."""
        if len(self.subscriptions) >= MOST_SUBSCRIPTIONS:
            raise ServiceError(ua.StatusCodes.BadTooManySubscriptions)
        self._sub_id_counter += 1
        number = self._sub_id_counter
        result = ua.CreateSubscriptionResult(SubscriptionId=number)
        self._revise(result, params)
        made = _Subscription(
            result,
            self.aspace,
            callback,
            session_id,
            request_callback,
            delete_callback=lambda: self.subscriptions.pop(number, None),
            no_acks_limit=self.iserver.max_unacked_messages_per_subscription,
            max_queue_size=self.iserver.max_monitored_item_queue_size,
            publishing_enabled=params.PublishingEnabled,
        )
        made.most_in_message = params.MaxNotificationsPerPublish
        await made.start()
        self.subscriptions[number] = made
        return result

    def modify_subscription(
        self, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Publish in another rhythm from now on."""
        subscription = self.subscriptions.get(params.SubscriptionId)
        if subscription is None:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        data = subscription.data
        self._revise(data, params)
        subscription.most_in_message = params.MaxNotificationsPerPublish
        subscription.begin_again()
        return ua.ModifySubscriptionResult(
            data.RevisedPublishingInterval, data.RevisedLifetimeCount, data.RevisedMaxKeepAliveCount
        )

    def _revise(
        self,
        data: ua.CreateSubscriptionResult,
        wanted: ua.CreateSubscriptionParameters | ua.ModifySubscriptionParameters,
    ) -> None:
        """Set a subscription's rhythm, as near to what is wanted as the server goes."""
        interval_ms = wanted.RequestedPublishingInterval
        # Also what is no number.
        if not interval_ms >= SHORTEST_INTERVAL_MS:
            interval_ms = SHORTEST_INTERVAL_MS
        keep_alive = self._clamp_keep_alive_count(wanted.RequestedMaxKeepAliveCount)
        lifetime = self._clamp_lifetime_count(wanted.RequestedLifetimeCount)
        data.RevisedPublishingInterval = interval_ms
        data.RevisedMaxKeepAliveCount = keep_alive
        data.RevisedLifetimeCount = max(lifetime, _LEAST_LIFETIME * keep_alive)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Watch more; a session has a limit."""
        there = sum(
            len(one.monitored_item_srv._monitored_items) for one in self.subscriptions.values()
        )
        if there + len(params.ItemsToCreate) > MOST_ITEMS:
            raise ServiceError(ua.StatusCodes.BadTooManyMonitoredItems)
        created: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        return created

    def publish(
        self, acks: Iterable[ua.SubscriptionAcknowledgement]
    ) -> tuple[int, list[ua.StatusCode]]:
        """Take acknowledgements; one of a message that is not kept is not good."""
        if not self.subscriptions:
            raise ServiceError(ua.StatusCodes.BadNoSubscription)
        return len(self.subscriptions), [ua.StatusCode(self._acknowledge(ack)) for ack in acks]

    def _acknowledge(self, ack: ua.SubscriptionAcknowledgement) -> int:
        subscription = self.subscriptions.get(ack.SubscriptionId)
        if subscription is None:
            return int(ua.StatusCodes.BadSubscriptionIdInvalid)
        if subscription._not_acknowledged_results.pop(ack.SequenceNumber, None) is None:
            return int(ua.StatusCodes.BadSequenceNumberUnknown)
        return int(ua.StatusCodes.Good)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Give a message again; it is kept until it is acknowledged.

        The library answers what it does not have with an empty message and a good status. A client
        that asks for one message after another until there are no more never ends then.
        """
        subscription = self.subscriptions.get(params.SubscriptionId)
        if subscription is None:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        kept = subscription._not_acknowledged_results.get(params.RetransmitSequenceNumber)
        if kept is None:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return kept.NotificationMessage

    async def transfer_subscriptions(
        self,
        params: ua.TransferSubscriptionsParameters,
        session_id: ua.NodeId,
        callback: Callable[..., Any],
    ) -> list[ua.TransferResult]:
        """Move none: those of other sessions are not known here, and one's own are here."""
        codes = ua.StatusCodes
        statuses = (
            codes.BadNothingToDo if one in self.subscriptions else codes.BadSubscriptionIdInvalid
            for one in params.SubscriptionIds
        )
        return [ua.TransferResult(StatusCode=ua.StatusCode(one)) for one in statuses]


class _Subscription(InternalSubscription):  # type: ignore[misc]
    """One subscription; ``most_in_message``: values of one message, 0 for all there are."""

    most_in_message: int = 0
    _task: asyncio.Task[None] | None

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.monitored_item_srv = MonitoredItems(self, arguments[1])

    def begin_again(self) -> None:
        """Take over a changed rhythm; the library would wait for the end of the interval."""
        if self._task is not None:
            self._task.cancel()  # it waits: a message is sent without a pause
        self._publish_cycles_count = 0
        self._task = asyncio.create_task(self._subscription_loop())

    async def publish_results(self, requestdata: Any = None) -> bool:
        """Publish what there is, in more than one message if need be."""
        sent = published = bool(await super().publish_results(requestdata))
        while published and self._has_more():
            published = bool(await super().publish_results())
        return sent

    def _pop_publish_result(self) -> ua.PublishResult:
        result = super()._pop_publish_result()
        result.MoreNotifications = self._has_more()
        return result

    def _has_more(self) -> bool:
        return self._publishing_enabled and bool(self._triggered_datachanges)

    def _pop_triggered_datachanges(self, result: ua.PublishResult) -> None:
        queues = self._triggered_datachanges
        found: list[ua.MonitoredItemNotification] = []
        for item in list(queues):
            room = self.most_in_message - len(found) if self.most_in_message else None
            if room == 0:
                break
            found += queues[item][:room]
            del queues[item][:room]
            if not queues[item]:
                del queues[item]
        if found:
            changes = ua.DataChangeNotification(MonitoredItems=found)
            result.NotificationMessage.NotificationData.append(changes)
