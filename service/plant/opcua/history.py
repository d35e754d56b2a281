"""History over OPC UA (Part 11): raw samples, values at single times, aggregates of intervals.

Everything is read from the store at the moment of the request, in a thread of its own; nothing is
copied, and nothing can be changed. What the library would do with a history it holds itself:
it asks for any node, whether it exists or not, and knows raw reads only.
"""

import asyncio
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final

import numpy as np
from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.history import HistoryManager
from asyncua.server.internal_server import InternalServer
from numpy.typing import NDArray

from service.clock import HOUR_US
from service.domain.times import LATEST_US
from service.plant.opcua.history_encoding import history_data, status_codes
from service.plant.opcua.reading import RefusedError, ranges_asked
from service.store import StoreUnavailableError
from service.store.blocks import ChannelSamples
from service.store.buckets import Bucket
from service.store.channel_history import ChannelHistory

#: Values of one answer, shared by all nodes of the request.
MOST_VALUES: Final = 10_000
MOST_NODES: Final = 100
#: Single times that are asked for at once, for one node.
MOST_TIMES: Final = 1000
#: Of processed reads all nodes of a request share so much history, where raw samples are read ...
_MOST_SPAN_US: Final = 7 * 24 * HOUR_US
#: ... and so many long intervals.
_MOST_LONG: Final = 500
_SHORTEST_MS: Final = 1.0
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_POINT: Final = struct.Struct("<q")

_CALCULATED, _INTERPOLATED, _PARTIAL = 0x0401, 0x0402, 0x0404

AGGREGATES: Final[Mapping[int, Callable[[Bucket], float | None]]] = {
    ua.ObjectIds.AggregateFunction_Average: lambda bucket: bucket.mean,
    ua.ObjectIds.AggregateFunction_Minimum: lambda bucket: bucket.low,
    ua.ObjectIds.AggregateFunction_Maximum: lambda bucket: bucket.high,
    ua.ObjectIds.AggregateFunction_Count: lambda bucket: bucket.good,
}
"""Number of an aggregate function, and what it takes of the statistics of an interval."""


@dataclass(frozen=True, slots=True)
class _Page:
    """Values of one node, in the order of the answer."""

    times_us: NDArray[np.int64]
    values: NDArray[np.float64] | NDArray[np.int32]
    statuses: NDArray[np.uint32]
    #: Where the next page begins.
    next_us: int | None = None


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What is read of one node: where it is, from when it goes on, how many values at most."""

    store: ChannelHistory
    asset: str
    channel: str
    point_us: int | None
    most: int


class StoreHistory(HistoryManager):  # type: ignore[misc]  # the library has no types
    """Answers reads of history from the store.

    ``channels``: asset and channel of each node that has a history.
    """

    def __init__(self, server: InternalServer, store: ChannelHistory) -> None:
        super().__init__(server)
        self.channels: dict[ua.NodeId, tuple[str, str]] = {}
        self._store = store
        # One node at a time: no client makes the tags of the others late.
        self._turn = asyncio.Lock()

    async def init(self) -> None:
        """Do nothing: the store is open."""

    async def stop(self) -> None:
        """Do nothing: the store is closed by who opened it."""

    async def read_history(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Answer a request; each node has a status of its own.

        Raises `ServiceError` if the request as a whole cannot be answered.
        """
        nodes, details = params.NodesToRead, params.HistoryReadDetails
        if not nodes:
            raise ServiceError(ua.StatusCodes.BadNothingToDo)
        if len(nodes) > MOST_NODES:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        if params.ReleaseContinuationPoints:  # they hold nothing
            return [ua.HistoryReadResult() for _ in nodes]
        stamps = params.TimestampsToReturn
        if stamps not in (
            ua.TimestampsToReturn.Source,
            ua.TimestampsToReturn.Server,
            ua.TimestampsToReturn.Both,
        ):
            raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)
        reads = _reads(details, len(nodes))
        if stamps == ua.TimestampsToReturn.Server:
            reads = [_without_server_times] * len(nodes)
        most = MOST_VALUES // len(nodes)
        return [
            await self._answer(node, read, most) for node, read in zip(nodes, reads, strict=True)
        ]

    async def _answer(
        self, node: ua.HistoryReadValueId, read: "_Read", most: int
    ) -> ua.HistoryReadResult:
        result = ua.HistoryReadResult()
        try:
            wanted = _Wanted(self._store, *self._channel(node), _point(node), most)
            async with self._turn:
                page = await asyncio.to_thread(read, wanted)
        except RefusedError as error:
            result.StatusCode = ua.StatusCode(error.status)
            return result
        except StoreUnavailableError:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadResourceUnavailable)
            return result
        if not page.times_us.size:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.GoodNoData)
        if page.next_us is not None:
            result.ContinuationPoint = _POINT.pack(page.next_us)
        result.HistoryData = history_data(page.times_us, page.values, page.statuses)
        return result

    def _channel(self, node: ua.HistoryReadValueId) -> tuple[str, str]:
        if node.NodeId not in self.iserver.aspace:
            raise RefusedError(ua.StatusCodes.BadNodeIdUnknown)
        if node.NodeId not in self.channels:
            raise RefusedError(ua.StatusCodes.BadHistoryOperationUnsupported)
        if ranges_asked(node):  # of single numbers
            raise RefusedError(ua.StatusCodes.BadIndexRangeNoData)
        return self.channels[node.NodeId]


_Read = Callable[[_Wanted], _Page]


def _reads(details: Any, count: int) -> Sequence[_Read]:
    """Give how each node of a request is read."""
    if isinstance(details, ua.ReadRawModifiedDetails) and not details.IsReadModified:
        return [partial(_raw, details)] * count
    if isinstance(details, ua.ReadRawModifiedDetails | ua.ReadEventDetails):
        return [_not_kept] * count
    if isinstance(details, ua.ReadAtTimeDetails):
        return [partial(_at_times, details)] * count
    if isinstance(details, ua.ReadProcessedDetails):
        if len(details.AggregateType) != count:
            raise ServiceError(ua.StatusCodes.BadAggregateListMismatch)
        return [partial(_processed, details, one) for one in details.AggregateType]
    raise ServiceError(ua.StatusCodes.BadHistoryOperationUnsupported)


def _not_kept(wanted: _Wanted) -> _Page:
    """Refuse: the store keeps neither what was changed nor events."""
    raise RefusedError(ua.StatusCodes.BadHistoryOperationUnsupported)


def _without_server_times(wanted: _Wanted) -> _Page:
    """Refuse: the store has the times of the sources alone."""
    raise RefusedError(ua.StatusCodes.BadTimestampNotSupported)


def _raw(details: ua.ReadRawModifiedDetails, wanted: _Wanted) -> _Page:
    """Read samples as they are stored; from the end backwards when the start is later, or open."""
    start_us, end_us = _time_us(details.StartTime), _time_us(details.EndTime)
    if start_us is None and end_us is None:
        raise RefusedError(ua.StatusCodes.BadHistoryOperationInvalid)
    store, point_us = wanted.store, wanted.point_us
    most = min(details.NumValuesPerNode or wanted.most, wanted.most)
    if start_us is None or (end_us is not None and start_us > end_us):
        first_us = 0 if start_us is None else (end_us or 0) + 1
        given = (one for one in (point_us, start_us, end_us) if one is not None)
        found = store.last_samples(
            wanted.asset, wanted.channel, first_us, next(given) + 1, most + 1
        )
        found = found.taken(slice(None, None, -1))
    else:
        # The end does not belong to the span, but start = end is a span of one moment.
        before_us = LATEST_US if end_us is None else max(end_us, start_us + 1)
        begin_us = start_us if point_us is None else point_us
        found = store.samples(wanted.asset, wanted.channel, begin_us, before_us, most + 1)
    return _Page(
        found.times_us[:most],
        found.values[:most],
        status_codes(found.qualities[:most]),
        int(found.times_us[most]) if found.times_us.size > most else None,
    )


def _at_times(details: ua.ReadAtTimeDetails, wanted: _Wanted) -> _Page:
    """Read the value that holds at each time: the last one before, for an hour at most."""
    times_us = [_time_us(one) or 0 for one in details.ReqTimes or ()]
    if not times_us or len(times_us) > min(MOST_TIMES, wanted.most):
        raise RefusedError(ua.StatusCodes.BadInvalidArgument)
    found: ChannelSamples = wanted.store.at_times(wanted.asset, wanted.channel, times_us)
    asked_us = np.array(times_us, np.int64)
    statuses = status_codes(found.qualities)
    statuses[found.times_us != asked_us] |= _INTERPOLATED
    statuses[found.times_us < 0] = ua.StatusCodes.BadNoData
    return _Page(asked_us, found.values, statuses)


def _processed(details: ua.ReadProcessedDetails, aggregate: ua.NodeId, wanted: _Wanted) -> _Page:
    """Aggregate the good samples of each interval."""
    take = AGGREGATES.get(aggregate.Identifier) if aggregate.NamespaceIndex == 0 else None
    if take is None:
        raise RefusedError(ua.StatusCodes.BadAggregateNotSupported)
    if not details.AggregateConfiguration.UseServerCapabilitiesDefaults:
        raise RefusedError(ua.StatusCodes.BadAggregateConfigurationRejected)
    start_us, end_us, interval_us = _intervals(details)
    begin_us = start_us if wanted.point_us is None else wanted.point_us
    if not start_us <= begin_us < end_us or (begin_us - start_us) % interval_us:
        raise RefusedError(ua.StatusCodes.BadContinuationPointInvalid)
    bound = _MOST_LONG if interval_us >= HOUR_US else _MOST_SPAN_US // interval_us
    most = max(min(wanted.most, bound * wanted.most // MOST_VALUES), 1)
    whole, rest_us = divmod(end_us - begin_us, interval_us)
    read = partial(wanted.store.intervals, wanted.asset, wanted.channel)
    buckets = read(begin_us, interval_us, min(whole, most))
    cut = rest_us > 0 and whole < most  # the last interval ends before its time
    if cut:
        buckets += read(begin_us + whole * interval_us, rest_us, 1)
    count = min(whole, most) + cut
    is_count = aggregate.Identifier == ua.ObjectIds.AggregateFunction_Count
    values = np.full(count, 0.0 if is_count else np.nan)
    statuses = np.full(
        count, _CALCULATED if is_count else ua.StatusCodes.BadNoData, dtype=np.uint32
    )
    for bucket in buckets:
        at = (bucket.time_us - begin_us) // interval_us
        value = take(bucket)
        if value is None:
            statuses[at] = ua.StatusCodes.Bad  # samples, and no good one among them
        else:
            values[at], statuses[at] = value, _CALCULATED
    if cut and statuses[-1] == _CALCULATED:
        statuses[-1] |= _PARTIAL
    next_us = begin_us + count * interval_us
    return _Page(
        begin_us + interval_us * np.arange(count, dtype=np.int64),
        values.astype(np.int32) if is_count else values,
        statuses,
        next_us if next_us < end_us else None,
    )


def _intervals(details: ua.ReadProcessedDetails) -> tuple[int, int, int]:
    """Start, end and length of the intervals that are asked for, microseconds."""
    start_us, end_us = _time_us(details.StartTime), _time_us(details.EndTime)
    interval_ms = details.ProcessingInterval  # 0: the whole span
    if not (interval_ms == 0 or _SHORTEST_MS <= interval_ms < math.inf):
        raise RefusedError(ua.StatusCodes.BadInvalidArgument)
    if start_us is None or end_us is None or start_us == end_us:
        raise RefusedError(ua.StatusCodes.BadInvalidArgument)
    if start_us > end_us:
        raise RefusedError(ua.StatusCodes.BadHistoryOperationUnsupported)
    span_us = end_us - start_us
    return start_us, end_us, min(round(interval_ms * 1000) or span_us, span_us)


def _point(node: ua.HistoryReadValueId) -> int | None:
    """Time at which a client goes on; continuation points hold nothing else."""
    if not node.ContinuationPoint:
        return None
    if len(node.ContinuationPoint) != _POINT.size:
        raise RefusedError(ua.StatusCodes.BadContinuationPointInvalid)
    (time_us,) = _POINT.unpack(node.ContinuationPoint)
    if not 0 <= time_us < LATEST_US:
        raise RefusedError(ua.StatusCodes.BadContinuationPointInvalid)
    return int(time_us)


def _time_us(time: datetime | None) -> int | None:
    """UTC microseconds; None for "no time", which arrives as the year 1601."""
    if time is None or time == ua.get_win_epoch():
        return None
    return max((time - _EPOCH) // timedelta(microseconds=1), 0)
