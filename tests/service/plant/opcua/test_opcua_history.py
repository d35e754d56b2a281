"""The history of tags over OPC UA, asked by the library's client on a real connection."""

import math
from collections.abc import Callable, Coroutine
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asyncua import Client, ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import extensionobject_from_binary, extensionobject_to_binary
from hypothesis import given
from hypothesis import strategies as st
from opcua_requests import Unknown
from opcua_site import RING, Asset, apart, fill_seconds, inside, make_client, node_id, serving
from patience import patience

from service.plant.opcua import history
from service.plant.opcua.codes import status_code
from service.plant.opcua.history_encoding import history_data, status_codes
from service.security.keys import create_key
from service.store import Outbox, Store, StoreUnavailableError

pytestmark = pytest.mark.wires
T0 = datetime(2026, 1, 1, tzinfo=UTC)
T0_US = round(T0.timestamp()) * 1_000_000
SECOND = timedelta(seconds=1)
AVERAGE, MINIMUM, MAXIMUM, COUNT = (
    ua.ObjectIds.AggregateFunction_Average,
    ua.ObjectIds.AggregateFunction_Minimum,
    ua.ObjectIds.AggregateFunction_Maximum,
    ua.ObjectIds.AggregateFunction_Count,
)
CALCULATED, INTERPOLATED, PARTIAL = 0x401, 0x402, 0x404
Look = Callable[[Client], Coroutine[Any, Any, None]]


def at(second: float) -> datetime:
    return T0 + second * SECOND


@pytest.fixture
def stored(store: Store) -> Store:
    fill_seconds(store, T0_US + 123_456, 25)
    return store


@pytest.fixture
def asking(
    tmp_path: Path, stored: Store, outbox: Outbox
) -> Callable[[Look], Coroutine[Any, Any, None]]:
    async def ask(look: Look) -> None:
        async with serving(Asset(), tmp_path, stored, outbox) as address:

            async def work() -> None:
                async with Client(address, timeout=patience(30)) as client:
                    await look(client)

            await apart(work)

    return ask


async def request(client: Client, details: Any, *nodes: str, **more: Any) -> list[Any]:
    values = [ua.HistoryReadValueId(NodeId=ua.NodeId.from_string(node)) for node in nodes]
    for value in values:
        value.ContinuationPoint = more.get("point")
        value.IndexRange = more.get("index_range")
        value.DataEncoding = ua.QualifiedName(more.get("encoding"))
    params = ua.HistoryReadParameters(
        HistoryReadDetails=details,
        TimestampsToReturn=more.get("stamps", ua.TimestampsToReturn.Source),
        NodesToRead=values,
        ReleaseContinuationPoints=more.get("release", False),
    )
    return list(await client.uaclient.history_read(params))


def raw_of(start: Any, end: Any) -> Any:
    return ua.ReadRawModifiedDetails(IsReadModified=False, StartTime=start, EndTime=end)


def shown(data: Any) -> list[tuple[Any, int]]:
    return [(one.Value.Value, one.StatusCode.value) for one in data.DataValues]


def processed(begin: float, end: float, interval_s: float, *aggregates: int) -> Any:
    return ua.ReadProcessedDetails(
        StartTime=at(begin),
        EndTime=at(end),
        ProcessingInterval=interval_s * 1000,
        AggregateType=[ua.NodeId(one) for one in aggregates],
    )


async def test_raw_samples_forwards_backwards_and_from_the_end(asking: Any) -> None:
    async def look(client: Client) -> None:
        node = client.get_node(node_id(RING))
        level = await node.get_access_level()
        assert ua.AccessLevel.HistoryRead in level
        assert ua.AccessLevel.CurrentWrite not in level
        assert (await node.read_attribute(ua.AttributeIds.Historizing)).Value.Value is True
        other = client.get_node(node_id("model.version"))
        assert ua.AccessLevel.HistoryRead not in await other.get_access_level()

        found = await node.read_raw_history(T0, at(3600))
        assert [one.SourceTimestamp for one in found] == [at(k + 0.123456) for k in range(25)]
        assert [one.Value.Value for one in found] == [
            None if k == 5 else 20.0 + k for k in range(25)
        ]
        assert found[5].StatusCode.value == ua.StatusCodes.BadSensorFailure
        assert found[7].StatusCode.value == ua.StatusCodes.Uncertain
        assert all(one.StatusCode.value == 0 for k, one in enumerate(found) if k not in (5, 7))

        back = await node.read_raw_history(at(3600), T0)
        assert [one.SourceTimestamp for one in back] == [at(k + 0.123456) for k in range(25)][::-1]
        last = await node.read_raw_history(None, at(3600), numvalues=3)
        assert [one.Value.Value for one in last] == [44.0, 43.0, 42.0]
        first = await node.read_raw_history(T0, None, numvalues=2)
        assert [one.Value.Value for one in first] == [20.0, 21.0]
        # The end does not belong to a span; a span of one moment has that moment.
        part = await node.read_raw_history(at(1.123456), at(3.123456))
        assert [one.Value.Value for one in part] == [21.0, 22.0]
        moment = await node.read_raw_history(at(1.123456), at(1.123456))
        assert [one.Value.Value for one in moment] == [21.0]

    await asking(look)


@pytest.mark.parametrize("backwards", [False, True])
async def test_what_is_longer_than_a_page_comes_in_pages(
    asking: Any, backwards: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history, "MOST_VALUES", 7)

    async def look(client: Client) -> None:
        span = (at(3600), T0) if backwards else (T0, at(3600))
        details = raw_of(*span)
        times: list[Any] = []
        sizes = []
        point = None
        while point is not None or not sizes:
            (result,) = await request(client, details, node_id(RING), point=point)
            times += [one.SourceTimestamp for one in result.HistoryData.DataValues]
            sizes.append(len(result.HistoryData.DataValues))
            point = result.ContinuationPoint
        assert sizes == [7, 7, 7, 4]
        expected = [at(k + 0.123456) for k in range(25)]
        assert times == (expected[::-1] if backwards else expected)
        (released,) = await request(client, details, node_id(RING), point=b"12345678", release=True)
        assert released.StatusCode.is_good()

    await asking(look)


async def test_aggregates_of_intervals(asking: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    async def look(client: Client) -> None:
        ring = node_id(RING)
        (mean,) = await request(client, processed(0, 30, 10, AVERAGE), ring)
        good = [20, 21, 22, 23, 24, 26, 28, 29]  # neither the bad nor the uncertain one
        assert shown(mean.HistoryData) == [
            (sum(good) / len(good), CALCULATED),
            (34.5, CALCULATED),
            (42.0, CALCULATED),
        ]
        assert [one.SourceTimestamp for one in mean.HistoryData.DataValues] == [
            at(0), at(10), at(20),
        ]  # fmt: skip
        low, high, count = await request(
            client, processed(0, 10, 0, MINIMUM, MAXIMUM, COUNT), ring, ring, ring
        )
        assert shown(low.HistoryData) == [(20.0, CALCULATED)]
        assert shown(high.HistoryData) == [(29.0, CALCULATED)]
        assert shown(count.HistoryData) == [(8, CALCULATED)]
        kind = count.HistoryData.DataValues[0].Value.VariantType
        assert kind == ua.VariantType.Int32
        # From any moment; the last interval is cut, one without a good sample is bad.
        (cut,) = await request(client, processed(4.5, 8, 2, AVERAGE), ring)
        assert shown(cut.HistoryData) == [
            (26.0, CALCULATED),
            (None, ua.StatusCodes.Bad),
        ]
        (cut,) = await request(client, processed(5.5, 8.5, 2, MAXIMUM), ring)
        assert shown(cut.HistoryData) == [(26.0, CALCULATED), (28.0, CALCULATED | PARTIAL)]
        empty, none = await request(client, processed(100, 130, 20, AVERAGE, COUNT), ring, ring)
        assert shown(empty.HistoryData) == [(None, ua.StatusCodes.BadNoData)] * 2
        assert shown(none.HistoryData) == [(0, CALCULATED), (0, CALCULATED | PARTIAL)]

        monkeypatch.setattr(history, "MOST_VALUES", 4)
        details, point, pages = processed(0, 25, 2.5, COUNT), None, []
        while point is not None or not pages:
            (page,) = await request(client, details, ring, point=point)
            pages.append([value for value, _ in shown(page.HistoryData)])
            point = page.ContinuationPoint
        assert [len(one) for one in pages] == [4, 4, 2]
        assert sum(map(sum, pages)) == 23
        # Several nodes share what is read; each has its own point to go on from.
        two = await request(client, processed(0, 25, 2.5, COUNT, AVERAGE), ring, ring)
        assert [len(one.HistoryData.DataValues) for one in two] == [2, 2]

    await asking(look)


async def test_the_value_at_a_time_is_the_last_one_before(asking: Any) -> None:
    async def look(client: Client) -> None:
        moments = [at(3.123456), at(4), at(-1), at(5.5), at(20 + 3600), at(30 + 3600)]
        (found,) = await request(client, ua.ReadAtTimeDetails(ReqTimes=moments), node_id(RING))
        assert shown(found.HistoryData) == [
            (23.0, 0),
            (23.0, INTERPOLATED),
            (None, ua.StatusCodes.BadNoData),
            (None, ua.StatusCodes.BadSensorFailure | INTERPOLATED),
            (44.0, INTERPOLATED),
            (None, ua.StatusCodes.BadNoData),  # nobody knows after an hour
        ]
        assert [one.SourceTimestamp for one in found.HistoryData.DataValues] == moments

    await asking(look)


async def test_what_cannot_be_read_is_refused_for_its_node(
    asking: Any, monkeypatch: pytest.MonkeyPatch, stored: Store
) -> None:
    codes = ua.StatusCodes

    async def look(client: Client) -> None:
        ring = node_id(RING)
        raw = raw_of(T0, at(60))
        nodes = (ring, node_id("model.version"), node_id("none"), "i=2253", "ns=2;s=bench-1")
        statuses = [one.StatusCode.value for one in await request(client, raw, *nodes)]
        refused = codes.BadHistoryOperationUnsupported
        assert statuses == [0, refused, codes.BadNodeIdUnknown, refused, refused]
        own = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=False)
        configured = processed(0, 60, 10, AVERAGE)
        configured.AggregateConfiguration = own
        open_span = raw_of(ua.get_win_epoch(), ua.get_win_epoch())
        changed = ua.ReadRawModifiedDetails(IsReadModified=True, StartTime=T0, EndTime=at(60))
        many = ua.ReadAtTimeDetails(ReqTimes=[T0] * (history.MOST_TIMES + 1))
        unknown = processed(0, 60, 10, ua.ObjectIds.AggregateFunction_Range)
        for details, point, status in (
            (open_span, None, codes.BadHistoryOperationInvalid),
            (raw, b"short", codes.BadContinuationPointInvalid),
            (raw, b"\xff" * 8, codes.BadContinuationPointInvalid),
            (processed(0, 60, 10, AVERAGE), b"\1" * 7 + b"\0", codes.BadContinuationPointInvalid),
            (unknown, None, codes.BadAggregateNotSupported),
            (configured, None, codes.BadAggregateConfigurationRejected),
            (processed(0, 0, 10, AVERAGE), None, codes.BadInvalidArgument),
            (processed(0, 60, -1, AVERAGE), None, codes.BadInvalidArgument),
            (processed(0, 60, 1e-4, AVERAGE), None, codes.BadInvalidArgument),
            (processed(0, 60, math.nan, AVERAGE), None, codes.BadInvalidArgument),
            (processed(0, 60, math.inf, AVERAGE), None, codes.BadInvalidArgument),
            (processed(60, 0, 10, AVERAGE), None, codes.BadHistoryOperationUnsupported),
            (many, None, codes.BadInvalidArgument),
            (ua.ReadAtTimeDetails(ReqTimes=[]), None, codes.BadInvalidArgument),
            (changed, None, codes.BadHistoryOperationUnsupported),
            (ua.ReadEventDetails(), None, codes.BadHistoryOperationUnsupported),
        ):
            (result,) = await request(client, details, ring, point=point)
            assert result.StatusCode.value == status, details
        server = ua.TimestampsToReturn.Server
        (result,) = await request(client, raw, ring, stamps=server)
        assert result.StatusCode.value == codes.BadTimestampNotSupported
        for asked, status in (
            ({"index_range": "0"}, codes.BadIndexRangeNoData),
            ({"index_range": "3:1"}, codes.BadIndexRangeInvalid),
            ({"encoding": "Default XML"}, codes.BadDataEncodingUnsupported),
            ({"encoding": "Default Binary"}, codes.Good),
        ):
            (result,) = await request(client, raw, ring, **asked)
            assert result.StatusCode.value == status, asked
        two = processed(0, 60, 10, AVERAGE, AVERAGE)
        for details, nodes, stamps, status in (
            (two, (ring,), 0, codes.BadAggregateListMismatch),
            (raw, (), 0, codes.BadNothingToDo),
            (raw, (ring,) * (history.MOST_NODES + 1), 0, codes.BadTooManyOperations),
            (raw, (ring,), 3, codes.BadTimestampsToReturnInvalid),
            (raw, (ring,), 4, codes.BadTimestampsToReturnInvalid),
            (raw, (ring,), 5, codes.BadTimestampsToReturnInvalid),
        ):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await request(client, details, *nodes, stamps=Unknown(stamps))
            assert error.value.code == status, details

        def away(*_: Any) -> None:
            raise StoreUnavailableError("away")

        with monkeypatch.context() as patch:
            patch.setattr(stored.channel_history, "samples", away)
            (result,) = await request(client, raw, ring)
        assert result.StatusCode.value == codes.BadResourceUnavailable
        (result,) = await request(client, raw, ring)
        assert len(result.HistoryData.DataValues) == 25
        later = raw_of(at(100), at(160))
        (nothing,) = await request(client, later, ring)
        assert nothing.StatusCode.value == codes.GoodNoData

    await asking(look)


async def test_beyond_loopback_a_history_needs_a_key(
    tmp_path: Path, stored: Store, outbox: Outbox
) -> None:
    viewer, gateway = (create_key(stored, role).text for role in ("viewer", "gateway"))
    async with serving(Asset(), tmp_path, stored, outbox, host="0.0.0.0") as address:

        async def count(password: str | None) -> int:
            async with await make_client(address, password, encrypted=True) as client:
                node = client.get_node(node_id(RING))
                return len(await node.read_raw_history(T0, at(60)))

        async def without_activation() -> None:
            client = await make_client(address, viewer, encrypted=True)
            await client.connect_socket()
            try:
                await client.send_hello()
                await client.open_secure_channel()
                await client.create_session()
                details = raw_of(T0, at(60))
                await request(client, details, node_id(RING))
            finally:
                client.disconnect_socket()

        assert await apart(lambda: count(viewer)) == 25
        for password in (None, gateway):
            with pytest.raises(ua.UaStatusCodeError):
                await apart(lambda key=password: count(key))  # type: ignore[misc]
        with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
            await apart(without_activation)


async def test_a_history_goes_with_its_tag(tmp_path: Path, stored: Store, outbox: Outbox) -> None:
    asset = Asset()
    async with inside(asset, tmp_path, stored, outbox) as served:

        async def statuses() -> list[int]:
            async with Client(served.address, timeout=patience(30)) as client:
                details = raw_of(T0, at(60))
                return [
                    one.StatusCode.value for one in await request(client, details, node_id(RING))
                ]

        assert await apart(statuses) == [0]
        del asset.tags[RING]
        await served.rounds.publish_tags()
        assert await apart(statuses) == [ua.StatusCodes.BadNodeIdUnknown]
        asset.tell(RING, 50.0)
        await served.rounds.publish_tags()
        assert await apart(statuses) == [0]


async def test_clients_find_what_the_server_can(asking: Any) -> None:
    async def look(client: Client) -> None:
        names = ua.ObjectIds
        most = client.get_node(names.HistoryServerCapabilities_MaxReturnDataValues)
        assert await most.read_value() == history.MOST_VALUES
        update = client.get_node(names.HistoryServerCapabilities_UpdateDataCapability)
        assert await update.read_value() is False
        folder = client.get_node(names.HistoryServerCapabilities_AggregateFunctions)
        found = {one.nodeid.Identifier for one in await folder.get_children()}
        assert found == {AVERAGE, MINIMUM, MAXIMUM, COUNT}
        node = client.get_node(node_id(RING))
        (settings,) = await node.get_referenced_nodes(names.HasHistoricalConfiguration)
        assert await (await settings.get_child("0:Stepped")).read_value() is True
        path = ["0:AggregateConfiguration", "0:PercentDataGood"]
        assert await (await settings.get_child(path)).read_value() == 1

    await asking(look)


@given(
    rows=st.lists(
        st.tuples(
            st.integers(0, 2**52),
            st.one_of(st.floats(allow_infinity=False), st.just(math.nan)),
            st.integers(0, 255),
        ),
        max_size=20,
    )
)
def test_a_page_is_encoded_as_the_library_does(rows: list[tuple[int, float, int]]) -> None:
    columns: Any = zip(*rows, strict=True) if rows else ((), (), ())
    times_us, values, qualities = columns
    ours = history_data(
        np.array(times_us, np.int64),
        np.array(values, np.float64),
        status_codes(np.array(qualities, np.uint16)),
    )
    decoded = extensionobject_from_binary(Buffer(extensionobject_to_binary(ours)))
    epoch = datetime(1970, 1, 1, tzinfo=UTC)
    for one, (time_us, value, quality) in zip(decoded.DataValues, rows, strict=True):
        assert one.SourceTimestamp == epoch + timedelta(microseconds=time_us)
        assert one.StatusCode.value == status_code(quality)
        kind = ua.VariantType.Null if math.isnan(value) else ua.VariantType.Double
        shown_value = None if math.isnan(value) else value
        assert (one.Value.Value, one.Value.VariantType) == (shown_value, kind)
