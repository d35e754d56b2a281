"""Monitored items: what of a change is queued, what is lost, and how a client learns of it."""

from copy import copy
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.monitored_item_service import MonitoredItemService, MonitoredItemValues

from service.plant.opcua import PERIOD_S
from service.plant.opcua.codes import with_overflow
from service.plant.opcua.reading import (
    RefusedError,
    check_stamps,
    part_of,
    ranges_asked,
    with_times,
)

#: Each change of a tag is queued, and the tags are looked at so often.
SAMPLING_INTERVAL_MS = PERIOD_S * 1000.0


class MonitoredItems(MonitoredItemService):  # type: ignore[misc]  # the library has no types
    """The monitored items of one subscription.

    The library gives the whole value with both times whatever is asked for, reports what is to be
    sampled only, and loses values without a word.
    """

    def __init__(self, subscription: InternalSubscription, space: AddressSpace) -> None:
        super().__init__(subscription, space)
        # Queues of items that sample only; those that report have theirs in the subscription.
        self._held: dict[int, list[ua.MonitoredItemNotification]] = {}

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Watch more; each item has a status of its own."""
        check_stamps(params.TimestampsToReturn)
        results = []
        for wanted in params.ItemsToCreate:
            try:
                results.append(await self._create(wanted, params.TimestampsToReturn))
            except RefusedError as error:
                status = ua.StatusCode(error.status)
                results.append(ua.MonitoredItemCreateResult(StatusCode=status))
        return results

    async def _create(
        self, wanted: ua.MonitoredItemCreateRequest, stamps: ua.TimestampsToReturn
    ) -> ua.MonitoredItemCreateResult:
        place = wanted.ItemToMonitor
        if place.AttributeId == ua.AttributeIds.EventNotifier:
            # There are no events, and a list of them that stays empty looks healthy.
            raise RefusedError(ua.StatusCodes.BadAttributeIdInvalid)
        wanted.RequestedParameters.Filter = _filter_of(wanted.RequestedParameters)
        ranges = ranges_asked(place)
        value = self.aspace.read_attribute_value(place.NodeId, place.AttributeId)
        if part_of(value, ranges).StatusCode.value == ua.StatusCodes.BadIndexRangeNoData:
            raise RefusedError(ua.StatusCodes.BadIndexRangeNoData)
        status, handle = self.aspace.add_datachange_callback(
            place.NodeId, place.AttributeId, self.datachange_callback
        )
        if not status.is_good():
            raise RefusedError(status.value)
        result, item = self._make_monitored_item_common(wanted)
        result.RevisedSamplingInterval = SAMPLING_INTERVAL_MS
        item.callback_handle = handle
        item.ranges, item.stamps = ranges, stamps
        item.discard_oldest = wanted.RequestedParameters.DiscardOldest
        self._monitored_items[result.MonitoredItemId] = item
        self._monitored_datachange[handle] = result.MonitoredItemId
        await self.datachange_callback(handle, value)
        return result

    def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        """Change items; each has a status of its own."""
        check_stamps(params.TimestampsToReturn)
        results = []
        for wanted in params.ItemsToModify:
            try:
                results.append(self._modify(wanted, params.TimestampsToReturn))
            except RefusedError as error:
                status = ua.StatusCode(error.status)
                results.append(ua.MonitoredItemModifyResult(StatusCode=status))
        return results

    def _modify(
        self, wanted: ua.MonitoredItemModifyRequest, stamps: ua.TimestampsToReturn
    ) -> ua.MonitoredItemModifyResult:
        item = self._monitored_items.get(wanted.MonitoredItemId)
        parameters = wanted.RequestedParameters
        if item is None:
            raise RefusedError(ua.StatusCodes.BadMonitoredItemIdInvalid)
        item.filter = _filter_of(parameters)
        item.stamps = stamps
        item.client_handle = parameters.ClientHandle
        item.discard_oldest = parameters.DiscardOldest
        item.queue_size = self._revise_queue_size(parameters.QueueSize)
        _trim(self._queues(item).get(wanted.MonitoredItemId, []), item)
        return ua.MonitoredItemModifyResult(
            RevisedSamplingInterval=SAMPLING_INTERVAL_MS, RevisedQueueSize=item.queue_size
        )

    async def _set_monitoring_mode(self, mode: ua.MonitoringMode, mid: int) -> ua.StatusCode:
        item = self._monitored_items.get(mid)
        if item is None:
            return ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
        queue = self._queues(item).pop(mid, None)
        before, item.mode = item.mode, mode
        if mode == ua.MonitoringMode.Disabled:
            item.mvalue = MonitoredItemValues()  # enabled again, it begins with the value of then
        elif before == ua.MonitoringMode.Disabled:
            place = item.read_value_id
            await self.trigger_datachange(item.callback_handle, place.NodeId, place.AttributeId)
        elif queue:
            self._queues(item)[mid] = queue
        return ua.StatusCode()

    def _delete_monitored_items(self, mid: int) -> ua.StatusCode:
        if mid in self._monitored_items:
            self._queues(self._monitored_items[mid]).pop(mid, None)
        return super()._delete_monitored_items(mid)

    async def datachange_callback(
        self, handle: int, value: ua.DataValue, error: ua.StatusCode | None = None
    ) -> None:
        """Queue a value, if it is a change for the item."""
        item = self._monitored_items[self._monitored_datachange[handle]]
        if item.mode == ua.MonitoringMode.Disabled:
            return
        part = part_of(value, item.ranges)
        item.mvalue.set_current_datavalue(part)
        trigger = item.filter.Trigger if item.filter else ua.DataChangeTrigger.StatusValue
        if not self._is_data_changed(item.mvalue, trigger):
            return
        if item.filter and not self._is_deadband_exceeded(item.mvalue, item.filter):
            return
        queue = self._queues(item).setdefault(item.monitored_item_id, [])
        queue.append(
            ua.MonitoredItemNotification(item.client_handle, with_times(part, item.stamps))
        )
        _trim(queue, item)

    def _queues(self, item: Any) -> dict[int, list[ua.MonitoredItemNotification]]:
        """Queues of the items that have the mode of this one."""
        if item.mode != ua.MonitoringMode.Reporting:
            return self._held
        queues: dict[int, list[ua.MonitoredItemNotification]] = self.isub._triggered_datachanges
        return queues

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


def _trim(queue: list[ua.MonitoredItemNotification], item: Any) -> None:
    """Remove what a queue has too much; the value next to the loss says so.

    Not in a queue of one: there each value replaces the one before, which is no loss.
    """
    too_many = len(queue) - item.queue_size
    if too_many <= 0:
        return
    at = 0 if item.discard_oldest else item.queue_size - 1
    del queue[at : at + too_many]
    if item.queue_size > 1:
        marked = copy(queue[at].Value)
        marked.StatusCode = ua.StatusCode(with_overflow(marked.StatusCode.value))
        queue[at].Value = marked


def _filter_of(parameters: ua.MonitoringParameters) -> Any:
    """Give the filter that is asked for, or None.

    Raises `RefusedError` for one that cannot be used.
    """
    filter = parameters.Filter
    # One that was not sent comes as an empty extension object.
    if filter is None or (isinstance(filter, ua.ExtensionObject) and filter.Body is None):
        return None
    # Not by its class: the library makes one again when it reads the types of the standard.
    kind = getattr(filter, "DeadbandType", None)
    if kind is None or kind == ua.DeadbandType.Percent:  # of a range that no variable has
        raise RefusedError(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
    if kind not in (ua.DeadbandType.None_, ua.DeadbandType.Absolute):
        raise RefusedError(ua.StatusCodes.BadDeadbandFilterInvalid)
    # Also what is no number.
    if kind == ua.DeadbandType.Absolute and not filter.DeadbandValue >= 0.0:
        raise RefusedError(ua.StatusCodes.BadDeadbandFilterInvalid)
    return filter


def _number(value: ua.DataValue) -> float | None:
    number = None if value.Value is None else value.Value.Value
    return float(number) if isinstance(number, int | float) else None
