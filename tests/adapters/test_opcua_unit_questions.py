"""Values follow the units that a server states, also where it states them late or others."""

import asyncio
import itertools
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua import ua
from asyncua.client.ua_client import UaClientState

from adapters.drivers.opcua.config import OpcUaChannel, OpcUaSource
from adapters.drivers.opcua.driver import OpcUaDriver
from adapters.drivers.opcua.session import Session, SessionError
from adapters.drivers.opcua.units import StatedUnits
from adapters.drivers.opcua.values import STANDS, moment_of
from adapters.protocol import ChannelBinding
from adapters.samples import Quality
from tests.adapters.units_server import NODE, NODES, OTHER, Server

NOW_US = 1_800_000_000_000_000


class Clock:
    rate = 1.0

    def now_us(self) -> int:
        return NOW_US

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(process_seconds)


def driver_of(*channels: OpcUaChannel) -> OpcUaDriver:
    source = OpcUaSource(name="plc", endpoint="opc.tcp://127.0.0.1:1/plc")
    bindings = [
        ChannelBinding("bench", f"t_{number}_c", channel, "°C")
        for number, channel in enumerate(channels)
    ]
    return OpcUaDriver(source, bindings, [], Clock())


def value_of(number: float) -> ua.DataValue:
    return ua.DataValue(ua.Variant(number), SourceTimestamp=moment_of(NOW_US))


def test_a_value_is_good_only_while_its_unit_is_known() -> None:
    driver = driver_of(
        OpcUaChannel(source="plc", node=NODE), OpcUaChannel(source="plc", node=OTHER, scale=0.1)
    )

    def taken(*stated: dict[str, str]) -> dict[str, tuple[float, int]]:
        driver._unit_questions.take(StatedUnits(*stated))
        value = value_of(300.0)
        found = driver._take([(NODE, value), (OTHER, value)], stands=True)
        return {one.channel: (round(one.value, 2), one.quality) for one in found}

    silent = dict.fromkeys((NODE, OTHER), "BadTimeout")
    good, uncertain = int(Quality.GOOD), int(Quality.UNCERTAIN)
    assert taken({}, silent) == {"t_0_c": (300.0, uncertain), "t_1_c": (30.0, good)}
    reason = "the server does not say its unit: BadTimeout; expected one, or scale"
    assert driver.health().problems == {"bench/t_0_c": reason}
    # The value itself need not change for it.
    assert taken(dict.fromkeys((NODE, OTHER), "K")) == {
        "t_0_c": (26.85, good),
        "t_1_c": (30.0, good),
    }
    assert driver.health().problems == {}
    # Its unit of before is the best that is known.
    for unknown in ({}, silent), (dict.fromkeys((NODE, OTHER), ""),):
        assert taken(*unknown)["t_0_c"] == (26.85, uncertain)
    assert taken(dict.fromkeys((NODE, OTHER), "°C"))["t_0_c"] == (300.0, good)


def test_a_unit_that_becomes_known_ends_no_other_doubt() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    for number in range(3):  # the time of its source stands still
        (sample,) = driver._take([(NODE, value_of(300.0 + number))], stands=True)
    assert driver.health().problems == {"bench/t_0_c": STANDS}
    driver._unit_questions.take(StatedUnits({NODE: "K"}))
    (sample,) = driver._take([(NODE, value_of(302.0))], stands=True)
    assert (round(sample.value, 2), sample.quality) == (28.85, Quality.UNCERTAIN)


def test_bits_that_only_inform_make_no_value_another_one() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    driver._unit_questions.take(StatedUnits({NODE: "°C"}))
    for code in (0x480, 0):
        value = value_of(40.0)
        value.StatusCode = ua.StatusCode(code)
        (sample,) = driver._take([(NODE, value)], stands=True)
        assert sample.quality == Quality.GOOD


async def asked_again(driver: OpcUaDriver, session: Session, *names: str) -> None:
    """Let it be time for a question, and wait for the answer."""
    questions = driver._unit_questions
    for name in names or ("_ask_at", "_check_at"):
        setattr(questions, name, 0.0)
    questions.go_on(session)
    assert questions._asking is not None
    await questions._asking


def stated(unit: str) -> Any:
    return ua.EUInformation(DisplayName=ua.LocalizedText(unit))


def answering(driver: OpcUaDriver) -> tuple[Session, Server]:
    session, server = Session(driver._source), Server()
    session._nodes = dict(NODES)
    server.state = UaClientState.CONNECTED
    session._client = SimpleNamespace(uaclient=server)
    return session, server


async def test_a_unit_that_changes_while_connected_is_followed() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    session, server = answering(driver)
    await driver._unit_questions.begin(session)
    times = itertools.count()

    def taken(number: float, code: int = 0) -> tuple[float, int]:
        at = moment_of(NOW_US - 1000 + next(times))
        value = ua.DataValue(ua.Variant(number), ua.StatusCode(code), SourceTimestamp=at)
        (sample,) = driver._take([(NODE, value)], stands=True)
        return round(sample.value, 2), sample.quality

    assert taken(300.0) == (26.85, Quality.GOOD)
    server.unit = stated("°C")
    # The server says with one value that the meaning is another one.
    assert taken(26.9, 0x4000)[1] == Quality.UNCERTAIN
    assert taken(27.0)[1] == Quality.UNCERTAIN
    reason = "the server does not say its unit: it has changed, no answer yet; "
    assert driver.health().problems == {"bench/t_0_c": f"{reason}expected one, or scale"}
    await asked_again(driver, session)
    assert taken(27.0) == (27.0, Quality.GOOD)
    # Another server does not say it: it is asked now and then.
    server.unit = stated("K")
    await asked_again(driver, session)
    assert taken(300.0) == (26.85, Quality.GOOD)


async def test_a_node_without_an_answer_holds_up_no_check_of_the_others() -> None:
    driver = driver_of(
        OpcUaChannel(source="plc", node=NODE), OpcUaChannel(source="plc", node=OTHER)
    )
    session, server = answering(driver)
    server.properties = {1: ua.StatusCodes.BadInternalError}
    await driver._unit_questions.begin(session)
    silent = dict(driver._unit_questions._unasked)
    assert list(silent) == [OTHER]
    server.unit = stated("°C")
    for _ in range(3):  # the one that is silent is asked for all the time
        await asked_again(driver, session, "_ask_at")
    await asked_again(driver, session, "_check_at")
    (sample,) = driver._take([(NODE, value_of(26.9))], stands=True)
    assert (sample.value, sample.quality) == (26.9, Quality.GOOD)
    assert driver._unit_questions._unasked == silent


async def test_a_change_while_others_are_asked_for_is_doubted() -> None:
    driver = driver_of(
        OpcUaChannel(source="plc", node=NODE), OpcUaChannel(source="plc", node=OTHER)
    )
    session, server = answering(driver)
    server.properties = {1: ua.StatusCodes.BadInternalError}
    questions = driver._unit_questions
    await questions.begin(session)
    questions._ask_at = 0.0
    questions.go_on(session)  # for the other node; before it is put, the change comes
    value = value_of(26.9)
    value.StatusCode = ua.StatusCode(0x4000)
    driver._take([(NODE, value)], stands=True)
    assert questions._asking is not None
    await questions._asking
    (sample,) = driver._take([(NODE, value_of(26.9))], stands=True)
    assert sample.quality == Quality.UNCERTAIN
    server.unit = stated("°C")
    await asked_again(driver, session)
    (sample,) = driver._take([(NODE, value_of(26.9))], stands=True)
    assert (sample.value, sample.quality) == (26.9, Quality.GOOD)
    assert set(questions._unasked) == {OTHER}


async def test_an_answer_from_before_the_change_ends_no_doubt() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    session, server = answering(driver)
    await driver._unit_questions.begin(session)
    value = value_of(26.9)
    value.StatusCode = ua.StatusCode(0x4000)
    ask = session.stated_units

    async def change(nodes: Any) -> StatedUnits:
        found = await ask(nodes)
        driver._take([(NODE, value)], stands=True)
        return found

    session.stated_units = change  # type: ignore[method-assign]
    await asked_again(driver, session)
    assert driver.health().problems
    server.unit = stated("°C")
    session.stated_units = ask  # type: ignore[method-assign]
    await asked_again(driver, session)
    (sample,) = driver._take([(NODE, value_of(26.9))], stands=True)
    assert (sample.value, driver.health().problems) == (26.9, {})


async def test_a_check_without_an_answer_ends_no_trust_and_a_bit_that_stays_no_value() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    session, server = answering(driver)
    await driver._unit_questions.begin(session)
    server.refusal = ua.uaerrors.BadTimeout()
    await asked_again(driver, session)
    (sample,) = driver._take([(NODE, value_of(300.0))], stands=True)
    assert (round(sample.value, 2), sample.quality) == (26.85, Quality.GOOD)
    server.refusal = None
    for number in range(4):  # a server that never takes the bit back
        value = value_of(300.0 + number)
        value.StatusCode = ua.StatusCode(0x4000)
        driver._take([(NODE, value)], stands=True)
        if number == 0:
            await asked_again(driver, session)
    assert driver.health().problems.get("bench/t_0_c", STANDS) == STANDS


def test_a_reconnection_ends_no_doubt_about_a_source_whose_time_stands() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    driver._unit_questions.take(StatedUnits({NODE: "°C"}))
    driver._take([(NODE, value_of(40.0))], stands=True)
    driver._unit_questions._doubt({NODE: "no answer yet"})
    driver._unit_questions.take(StatedUnits({NODE: "°C"}))
    (sample,) = driver._take([(NODE, value_of(70.0))], stands=True)
    assert (sample.value, sample.quality) == (70.0, Quality.UNCERTAIN)


async def test_a_question_that_ends_the_connection_comes_after_the_values_the_next_time() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    for ends in (True, False):
        session = Session(driver._source)
        session._nodes = dict(NODES)
        client = Server(ua.uaerrors.BadTcpMessageTooLarge())
        client.state = UaClientState.DISCONNECTED
        session._client = SimpleNamespace(uaclient=client)
        if ends:
            with pytest.raises(SessionError):
                await driver._unit_questions.begin(session)
        else:
            await driver._unit_questions.begin(session)
            assert not client.asked
    assert driver.health().problems == {}
    (sample,) = driver._take([(NODE, value_of(300.0))], stands=True)
    assert (sample.value, sample.quality) == (300.0, Quality.UNCERTAIN)


async def test_a_unit_that_appears_a_little_later_is_taken() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    session = Session(driver._source)
    session._nodes = dict(NODES)
    server = Server(paths={0: ua.StatusCodes.BadNoMatch})
    server.state = UaClientState.CONNECTED
    session._client = SimpleNamespace(uaclient=server)
    await driver._unit_questions.begin(session)
    assert [one.quality for one in driver._take([(NODE, value_of(300.0))], stands=True)] == [192]
    server.paths = {}
    driver._unit_questions._ask_at = 0.0
    driver._unit_questions.go_on(session)
    assert driver._unit_questions._asking is not None
    await driver._unit_questions._asking
    (sample,) = driver._take([(NODE, value_of(300.0))], stands=True)
    assert (round(sample.value, 2), sample.quality) == (26.85, Quality.GOOD)
    assert not driver._unit_questions._without


async def test_only_units_that_matter_are_asked_for() -> None:
    scaled = OpcUaChannel(source="plc", node=OTHER, scale=0.1)
    driver = driver_of(OpcUaChannel(source="plc", node=NODE), scaled)
    driver._points[0].unit = ""
    await driver._unit_questions.begin(Session(driver._source))
    assert driver._unit_questions._asking is None


async def test_a_question_that_ends_the_connection_ends_the_session() -> None:
    driver = driver_of(OpcUaChannel(source="plc", node=NODE))
    session = Session(driver._source)
    session._nodes = dict(NODES)
    client = Server(ua.uaerrors.BadTcpMessageTooLarge())
    session._client = SimpleNamespace(uaclient=client)
    client.state = UaClientState.DISCONNECTED
    with pytest.raises(SessionError, match="BadTcpMessageTooLarge"):
        await driver._unit_questions.begin(session)
    assert session.lost == "BadTcpMessageTooLarge"
