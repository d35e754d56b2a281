"""What a server says of the units of its nodes, however it takes the question."""

import asyncio
from typing import Any

import pytest
from asyncua import ua

from adapters.drivers.opcua.config import OpcUaChannel, OpcUaSource
from adapters.drivers.opcua.driver import OpcUaDriver
from adapters.drivers.opcua.units import StatedUnits, stated_units
from adapters.drivers.opcua.values import moment_of
from adapters.protocol import ChannelBinding
from adapters.samples import Quality

NODES = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(7)}
NODE, OTHER, *_ = NODES
NOW_US = 1_800_000_000_000_000


class Server:
    """A client of a server that takes two paths in a request, and states K for every node.

    Parameters
    ----------
    refusal : exception, optional
        What becomes of every question.
    paths, properties : dict of int to StatusCode
        What it says of single nodes instead, by their numbers.
    """

    def __init__(
        self,
        refusal: Exception | None = None,
        paths: dict[int, int] | None = None,
        properties: dict[int, int] | None = None,
    ) -> None:
        self.refusal, self.paths, self.properties = refusal, paths or {}, properties or {}

    async def translate_browsepaths_to_nodeids(self, paths: list[Any]) -> list[Any]:
        if self.refusal is not None:
            raise self.refusal
        if len(paths) > 2:
            raise ua.uaerrors.BadTooManyOperations
        found = []
        for path in paths:
            number = path.StartingNode.Identifier
            target = ua.BrowsePathTarget(ua.ExpandedNodeId(number, 2), 0)
            status = ua.StatusCode(self.paths.get(number, 0))
            found.append(ua.BrowsePathResult(status, [target] if status.is_good() else []))
        return found

    async def read(self, request: Any) -> list[Any]:
        unit = ua.EUInformation(DisplayName=ua.LocalizedText("K"))
        found = []
        for item in request.NodesToRead:
            status = ua.StatusCode(self.properties.get(item.NodeId.Identifier, 0))
            value = ua.Variant(unit) if status.is_good() else None
            found.append(ua.DataValue(value, StatusCode=status))
        return found


async def test_units_are_asked_for_as_a_server_takes_it() -> None:
    assert await stated_units(Server(), NODES) == StatedUnits(dict.fromkeys(NODES, "K"))


@pytest.mark.parametrize("status", ["BadNoMatch", "BadNotFound", "BadNotSupported"])
async def test_a_node_whose_path_leads_nowhere_states_none(status: str) -> None:
    found = await stated_units(Server(paths={1: getattr(ua.StatusCodes, status)}), NODES)
    assert found == StatedUnits(dict.fromkeys(NODES, "K") | {OTHER: ""})


@pytest.mark.parametrize("status", ["BadNotReadable", "BadUserAccessDenied", "BadNodeIdUnknown"])
async def test_a_property_that_is_not_for_us_states_none(status: str) -> None:
    found = await stated_units(Server(properties={1: getattr(ua.StatusCodes, status)}), NODES)
    assert found == StatedUnits(dict.fromkeys(NODES, "K") | {OTHER: ""})


@pytest.mark.parametrize(
    "status",
    ["BadInternalError", "BadWaitingForInitialData", "BadTimeout", "UncertainInitialValue"],
)
@pytest.mark.parametrize("where", ["paths", "properties"])
async def test_an_odd_status_of_one_node_leaves_that_alone_without_an_answer(
    where: str, status: str
) -> None:
    server = Server(**{where: {1: getattr(ua.StatusCodes, status)}})
    found = await stated_units(server, NODES)
    assert found.unanswered == {OTHER: status}
    assert found.units == {name: "K" for name in NODES if name != OTHER}


async def test_a_server_without_the_service_states_none() -> None:
    found = await stated_units(Server(ua.uaerrors.BadServiceUnsupported()), NODES)
    assert found == StatedUnits(dict.fromkeys(NODES, ""))


@pytest.mark.parametrize(
    ("refusal", "reason"),
    [
        (ua.uaerrors.BadTimeout(), "BadTimeout"),
        (ua.UaStatusCodeError(ua.StatusCodes.BadUnexpectedError), "BadUnexpectedError"),
        (TimeoutError(), "no answer"),
        (ValueError("two answers for one question"), "two answers for one question"),
    ],
)
async def test_a_service_that_fails_is_no_reason_to_lose_the_values(
    refusal: Exception, reason: str
) -> None:
    assert await stated_units(Server(refusal), NODES) == StatedUnits(
        {}, dict.fromkeys(NODES, reason)
    )


async def test_a_lost_connection_is_no_answer() -> None:
    with pytest.raises(ConnectionResetError):
        await stated_units(Server(ConnectionResetError()), NODES)


class Clock:
    rate = 1.0

    def now_us(self) -> int:
        return NOW_US

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(process_seconds)


def test_a_value_is_good_only_while_its_unit_is_known() -> None:
    source = OpcUaSource(name="plc", endpoint="opc.tcp://127.0.0.1:1/plc")
    channels = [
        ChannelBinding("bench", "t_a_c", OpcUaChannel(source="plc", node=NODE), "°C"),
        ChannelBinding("bench", "t_b_c", OpcUaChannel(source="plc", node=OTHER, scale=0.1), "°C"),
    ]
    driver = OpcUaDriver(source, channels, [], Clock())
    moment = moment_of(NOW_US)

    def taken(*stated: dict[str, str]) -> dict[str, tuple[float, int]]:
        driver._take_units(StatedUnits(*stated))
        value = ua.DataValue(ua.Variant(300.0), SourceTimestamp=moment)
        found = driver._take([(NODE, value), (OTHER, value)], stands=True)
        return {one.channel: (round(one.value, 2), one.quality) for one in found}

    silent = dict.fromkeys((NODE, OTHER), "BadTimeout")
    good, uncertain = int(Quality.GOOD), int(Quality.UNCERTAIN)
    assert taken({}, silent) == {"t_a_c": (300.0, uncertain), "t_b_c": (30.0, good)}
    reason = "the server does not say its unit: BadTimeout; expected one, or scale"
    assert driver.health().problems == {"bench/t_a_c": reason}
    # The value itself need not change for it.
    assert taken(dict.fromkeys((NODE, OTHER), "K")) == {
        "t_a_c": (26.85, good),
        "t_b_c": (30.0, good),
    }
    assert driver.health().problems == {}
    # Its unit of before is the best that is known.
    assert taken({}, silent)["t_a_c"] == (26.85, uncertain)
    assert taken(dict.fromkeys((NODE, OTHER), ""))["t_a_c"] == (300.0, good)
