"""What a server says of the units of its nodes, however it takes the question."""

from typing import Any

import pytest
from asyncua import ua

from adapters.drivers.opcua.units import StatedUnits, stated_units
from tests.adapters.units_server import NODES, OTHER, Server


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


async def test_one_node_that_spoils_an_answer_leaves_the_others_theirs() -> None:
    server = Server()
    server.spoiling = {3}
    found = await stated_units(server, NODES)
    assert list(found.unanswered) == ["ns=2;i=3"]
    assert found.units == {name: "K" for name in NODES if name != "ns=2;i=3"}


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        (ua.EUInformation(UnitId=4932940), "K"),
        (ua.EUInformation(UnitId=4338743), "kN"),
        (ua.EUInformation(UnitId=5067851), "unit 5067851"),
        (ua.EUInformation(UnitId=-1), ""),
        (ua.EUInformation(), ""),
        (None, ""),
        (1.0, ""),
    ],
)
async def test_a_unit_without_a_name_is_known_by_its_number(unit: Any, expected: str) -> None:
    server = Server()
    server.unit = unit
    assert await stated_units(server, NODES) == StatedUnits(dict.fromkeys(NODES, expected))


async def test_a_server_that_lets_us_ask_nothing_states_none() -> None:
    server = Server(ua.uaerrors.BadUserAccessDenied())
    nodes = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(3000)}
    assert await stated_units(server, nodes) == StatedUnits(dict.fromkeys(nodes, ""))
    assert server.asked < 10


@pytest.mark.parametrize("bad", [0, 3, 6])
@pytest.mark.parametrize("status", ["BadNodeIdUnknown", "BadUserAccessDenied", "BadNotFound"])
async def test_a_node_that_is_refused_for_all_leaves_the_others_theirs(
    bad: int, status: str
) -> None:
    server = Server()
    server.most, server.spoiling = 500, {bad}
    server.spoils = ua.UaStatusCodeError(getattr(ua.StatusCodes, status))
    found = await stated_units(server, NODES)
    assert found == StatedUnits(dict.fromkeys(NODES, "K") | {f"ns=2;i={bad}": ""})


async def test_many_nodes_that_spoil_answers_keep_none_of_the_others_back() -> None:
    server = Server()
    server.most, server.spoiling = 500, set(range(0, 600, 5))
    nodes = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(600)}
    known: dict[str, str] = {}
    left = dict(nodes)
    for _ in range(60):
        found = await stated_units(server, left)
        known |= found.units
        left = {name: nodes[name] for name in found.unanswered}
    assert {nodes[name].Identifier for name in left} == server.spoiling
    assert known == {name: "K" for name in nodes if name not in left}


async def test_a_server_that_does_not_answer_is_asked_once() -> None:
    server = Server(TimeoutError())
    nodes = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(3000)}
    assert (await stated_units(server, nodes)).unanswered == dict.fromkeys(nodes, "no answer")
    assert server.asked == 1


async def test_a_server_that_fails_at_everything_is_not_asked_for_each_node() -> None:
    server = Server(ua.uaerrors.BadInternalError())
    nodes = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(3000)}
    assert (await stated_units(server, nodes)).unanswered == dict.fromkeys(
        nodes, "BadInternalError"
    )
    assert server.asked < 50


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
