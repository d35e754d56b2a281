"""Subscriptions that belong to one session, and deadbands that know a tag without a value."""

import secrets
from collections.abc import Callable
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

    Parameters
    ----------
    aspace
        The address space.
    server
        Holds the limits.
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


class _Items(MonitoredItemService):  # type: ignore[misc]
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


def _number(value: ua.DataValue) -> float | None:
    number = None if value.Value is None else value.Value.Value
    return float(number) if isinstance(number, int | float) else None
