"""Subscriptions that belong to one session, and deadbands that know a tag without a value."""

import secrets
from collections.abc import Callable, Iterable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_server import InternalServer
from asyncua.server.monitored_item_service import MonitoredItemService, MonitoredItemValues
from asyncua.server.subscription_service import SubscriptionService

MOST_SUBSCRIPTIONS = 20
MOST_ITEMS = 20_000
SHORTEST_INTERVAL_MS = 50.0


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
        wanted_ms = params.RequestedPublishingInterval
        # Also what is no number.
        if not wanted_ms >= SHORTEST_INTERVAL_MS:
            params.RequestedPublishingInterval = SHORTEST_INTERVAL_MS
        result = await super().create_subscription(params, callback, session_id, request_callback)
        made = self.subscriptions[result.SubscriptionId]
        made.monitored_item_srv = _Items(made, self.aspace)
        return result

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


class _Items(MonitoredItemService):  # type: ignore[misc]
    def _create_events_monitored_item(
        self, params: ua.MonitoredItemCreateRequest
    ) -> ua.MonitoredItemCreateResult:
        """Refuse: there are no events, and a list of them that stays empty looks healthy."""
        return _refused(ua.StatusCodes.BadAttributeIdInvalid)

    async def _create_data_change_monitored_item(
        self, params: ua.MonitoredItemCreateRequest
    ) -> ua.MonitoredItemCreateResult:
        params.RequestedParameters.Filter = given = _given(params.RequestedParameters.Filter)
        status = _status_of_filter(given)
        if status is not None:
            return _refused(status)
        return await super()._create_data_change_monitored_item(params)

    def _modify_monitored_item(
        self, params: ua.MonitoredItemModifyRequest
    ) -> ua.MonitoredItemModifyResult:
        params.RequestedParameters.Filter = given = _given(params.RequestedParameters.Filter)
        status = _status_of_filter(given)
        if params.MonitoredItemId not in self._monitored_items:
            status = ua.StatusCodes.BadMonitoredItemIdInvalid
        if status is not None:
            return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(status))
        return super()._modify_monitored_item(params)

    def _is_deadband_exceeded(self, values: MonitoredItemValues, flt: ua.DataChangeFilter) -> bool:
        """Compare with what was reported last.

        The library compares with the last change, reported or not, so that a slow rise is never
        reported; and it loses the change between a value and none.
        """
        old, current = values.get_old_datavalue(), values.get_current_datavalue()
        if flt.DeadbandType != ua.DeadbandType.Absolute or old is None or current is None:
            return True
        if old.StatusCode != current.StatusCode:
            return True
        before, now = _number(old), _number(current)
        if before is None or now is None or abs(now - before) > flt.DeadbandValue:
            return True
        values.current_dvalue = old
        return False


def _refused(status: int) -> ua.MonitoredItemCreateResult:
    return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(status))


def _given(filter: Any) -> Any:
    """A filter, or None: one that was not sent comes as an empty extension object."""
    empty = isinstance(filter, ua.ExtensionObject) and filter.Body is None
    return None if empty else filter


def _status_of_filter(filter: Any) -> int | None:
    """Why a filter cannot be used; None for one that can."""
    if filter is None:
        return None
    # Not by its class: the library makes one again when it reads the types of the standard.
    kind = getattr(filter, "DeadbandType", None)
    if kind is None or kind == ua.DeadbandType.Percent:  # of a range that no variable has
        return int(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
    if kind not in (ua.DeadbandType.None_, ua.DeadbandType.Absolute):
        return int(ua.StatusCodes.BadDeadbandFilterInvalid)
    # Also what is no number.
    if kind == ua.DeadbandType.Absolute and not filter.DeadbandValue >= 0.0:
        return int(ua.StatusCodes.BadDeadbandFilterInvalid)
    return None


def _number(value: ua.DataValue) -> float | None:
    number = None if value.Value is None else value.Value.Value
    return float(number) if isinstance(number, int | float) else None
