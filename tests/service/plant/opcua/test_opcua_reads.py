"""Reads over OPC UA give what was asked for, and no good status otherwise (Part 4)."""

import math
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_requests import Unknown, ask, read_of, status_of
from opcua_site import BEGAN, RING, Asset, apart, node_id, serving
from patience import patience

from adapters.samples import Quality
from service.clock import from_rfc3339
from service.plant.opcua.reading import part_of, ranges_of
from service.store import Outbox, Store

pytestmark = pytest.mark.wires
Stamps = ua.TimestampsToReturn
RING_NODE = ua.NodeId.from_string(node_id(RING))
BROKEN_NODE = ua.NodeId.from_string(node_id("load_n"))
NAMESPACES = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
MAKER = ua.NodeId(ua.ObjectIds.Server_ServerStatus_BuildInfo_ManufacturerName)
NO_DATA, INVALID = "BadIndexRangeNoData", "BadIndexRangeInvalid"


def of(node: ua.NodeId, attribute: int = 13, **more: Any) -> ua.ReadValueId:
    return ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds(attribute), **more)


async def test_an_index_range_gives_that_part_or_says_why_not(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset = Asset()
    asset.tell("load_n", None, Quality.SENSOR_FAILURE)
    uris = ["http://opcfoundation.org/UA/", "urn:freeopcua:python:server", "urn:bearing-twin"]
    async with serving(asset, tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:

                async def part(node: ua.NodeId, text: str, attribute: int = 13) -> Any:
                    request = read_of(of(node, attribute, IndexRange=text))
                    (found,) = (await ask(client, request)).Results
                    if found.StatusCode.is_good():
                        return found.Value.Value
                    assert found.Value is None or found.Value.Value is None
                    return found.StatusCode.name

                whole = await part(NAMESPACES, "")
                assert [whole[0], whole[2]] == [uris[0], uris[2]]
                for text, expected in (
                    ("0", whole[:1]),
                    ("1:2", whole[1:]),
                    ("2:9", whole[2:]),  # what there is of it
                    ("2,0:2", ["urn"]),  # of the texts themselves
                    ("3", NO_DATA),
                    ("0,0,0", NO_DATA),
                ):
                    assert await part(NAMESPACES, text) == expected, text
                assert await part(RING_NODE, "") == 61.5
                for text in ("0", "0:1", "0,0"):
                    assert await part(RING_NODE, text) == NO_DATA, text
                for text in ("a:b", "3:1", "1:1", "-1", "1:", ":1", "0,", " 0", "٣", "9" * 30):
                    assert await part(RING_NODE, text) == INVALID, text
                assert await part(MAKER, "0:6") == "Bearing"
                name = int(ua.AttributeIds.DisplayName)
                assert await part(RING_NODE, "0", name) == NO_DATA
                assert await part(BROKEN_NODE, "0") == "BadSensorFailure"
                gone = ua.NodeId("bench-1/nothing", 2)
                assert await part(gone, "0") == "BadNodeIdUnknown"

        await apart(look)


def test_bytes_have_parts_too_and_the_value_that_is_kept_stays_whole() -> None:
    for value, text, expected in (
        (b"bearing", "0:3", b"bear"),
        ([b"bearing", b"twin"], "1,0", [b"t"]),
        ([1, 2, 3], "2", [3]),
    ):
        kept = ua.DataValue(ua.Variant(value))
        found = part_of(kept, ranges_of(text))
        assert found.Value is not None
        assert found.Value.Value == expected
        assert found.Value.VariantType == kept.Value.VariantType
        assert kept.Value.Value == value


async def test_times_come_as_they_are_asked_for(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:
                for stamps, source, server in (
                    (Stamps.Source, True, False),
                    (Stamps.Server, False, True),
                    (Stamps.Both, True, True),
                    (Stamps.Neither, False, False),
                ):
                    request = read_of(of(RING_NODE), of(NAMESPACES), stamps=stamps)
                    ring, namespaces = (await ask(client, request)).Results
                    assert (ring.Value.Value, ring.StatusCode.value) == (61.5, 0)
                    assert (ring.SourceTimestamp is not None) == source, stamps
                    assert (ring.ServerTimestamp is not None) == server, stamps
                    # Also of a value that was written without one.
                    assert (namespaces.ServerTimestamp is not None) == server, stamps
                    if source:
                        seen_us = round(ring.SourceTimestamp.timestamp() * 1e6)
                        assert seen_us == from_rfc3339(BEGAN)

        await apart(look)


async def test_what_no_read_can_mean_is_refused_as_a_whole(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address, timeout=patience(30)) as client:
                ring = of(RING_NODE)
                for stamps in (Stamps.Invalid, Unknown(5), Unknown(-1)):
                    request = read_of(ring, stamps=stamps)
                    assert await status_of(client, request) == "BadTimestampsToReturnInvalid"
                for age in (-1.0, math.nan):
                    request = read_of(ring, max_age=age)
                    assert await status_of(client, request) == "BadMaxAgeInvalid"
                for age in (0.0, 1e9):
                    assert await status_of(client, read_of(ring, max_age=age)) == "Good"
                for name, status in (
                    ("Default Binary", "Good"),
                    ("Default XML", "BadDataEncodingUnsupported"),
                    ("of my own", "BadDataEncodingUnsupported"),
                ):
                    request = read_of(of(RING_NODE, DataEncoding=ua.QualifiedName(name)))
                    (found,) = (await ask(client, request)).Results
                    assert found.StatusCode.name == status

        await apart(look)
