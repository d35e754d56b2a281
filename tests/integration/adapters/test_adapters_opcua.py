"""The OPC UA driver against real servers."""

import asyncio
import datetime as dt
import itertools
import math
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua

from adapters.samples import Quality

pytestmark = pytest.mark.wires

GOOD = int(Quality.GOOD)
STEP_US = 200_000


class RealClock:
    """Process time is the time of day, as the server's."""

    rate = 1.0

    def now_us(self) -> int:
        return time.time_ns() // 1000

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(process_seconds)


@pytest.fixture
def origin() -> dt.datetime:
    return dt.datetime.now(dt.UTC).replace(microsecond=0) - dt.timedelta(seconds=20)


@pytest.fixture
def follow(drive: Callable[..., Any], free_port: int) -> Callable[..., Any]:
    """Run the driver on nodes of the server."""

    @asynccontextmanager
    async def running(*names: str, **source: Any) -> AsyncIterator[Any]:
        settings = {
            "driver": "opcua",
            "endpoint": f"opc.tcp://127.0.0.1:{free_port}/plc",
            "sampling_interval_s": 0.05,
            **source,
        }
        channels = {name: {"node": f"nsu=urn:example:plc;s={name}"} for name in names}
        async with drive(settings, channels, clock=RealClock()) as record:
            record.clock_was_set_back = True  # history comes late
            yield record

    return running


def steps(record: Any, name: str, origin: dt.datetime) -> list[int]:
    """Numbers of the server's values that were handed over, doubles included."""
    first_us = round(origin.timestamp() * 1e6)
    return sorted(
        (one.time_us - first_us) // STEP_US
        for one in record.of(name)
        if (one.time_us - first_us) % STEP_US == 0
    )


def has_steps(record: Any, origin: dt.datetime, count: int) -> bool:
    return len(steps(record, "TIC101.PV", origin)) >= count


@pytest.mark.endurance
async def test_nothing_is_missing_or_doubled_after_a_killed_server(
    follow: Callable[..., Any], peer: Callable[..., Any], free_port: int, origin: dt.datetime
) -> None:
    server = peer("opcua_server.py", free_port, origin.isoformat())
    async with (
        follow("TIC101.PV", "TIC102.PV", "TIC103.PV") as record,
        follow("TIC101.PV", backfill=False) as without,
    ):
        # The first connection fails; it is tried again.
        await record.until(lambda: record.qualities("TIC101.PV") == [Quality.COMM_FAILURE])
        assert "refused" in record.driver.health().detail
        await asyncio.to_thread(server.start)
        for one in (record, without):
            await one.until(partial(has_steps, one, origin, 10), 60.0)
        await asyncio.to_thread(server.kill)
        count = len(record.of("TIC101.PV"))
        await record.until(lambda: record.samples[-1].quality == Quality.COMM_FAILURE)
        await asyncio.sleep(4.0)
        assert len(record.of("TIC101.PV")) <= count + 2  # marked once
        before = len(steps(without, "TIC101.PV", origin))
        await asyncio.to_thread(server.start)
        marks = record.qualities("TIC101.PV").count(int(Quality.COMM_FAILURE))
        await without.until(partial(has_steps, without, origin, before + 10), 60.0)
        await record.until(lambda: "TIC102.PV: gap of" in record.driver.health().detail, 60.0)
        stop = steps(without, "TIC101.PV", origin)[-1]
        await record.until(lambda: steps(record, "TIC101.PV", origin)[-1] >= stop, 60.0)
        blind = steps(without, "TIC101.PV", origin)
        assert max(b - a for a, b in itertools.pairwise(blind)) >= 20
        times = [one.time_us for one in without.samples]
        assert times == sorted(times)
        found = steps(record, "TIC101.PV", origin)
        assert found == list(range(found[0], found[-1] + 1))
        assert marks == 2  # before the first start, and at the loss
        # Every value as the server had it, from history and alive alike.
        first_us = round(origin.timestamp() * 1e6)
        late = 0
        newest = 0
        for one in record.of("TIC101.PV"):
            k, rest = divmod(one.time_us - first_us, STEP_US)
            if rest:
                assert one.quality in (Quality.COMM_FAILURE, GOOD, Quality.SENSOR_FAILURE)
            elif k % 25 == 24:
                assert one.quality == Quality.SENSOR_FAILURE
            else:
                assert (one.quality, one.value) == (GOOD, 20.0 + k)
            late += one.time_us < newest
            newest = max(newest, one.time_us)
        assert late >= 20  # behind what is alive, so that no twin takes it for new
        health = record.driver.health()
        assert health.reconnects == 1
        assert health.errors["history"] >= 1
        assert "bench/TIC102.PV: gap of" in health.detail
        assert "BadHistoryOperationUnsupported" in health.detail
        # What stays the same is handed over with the server's word that it stands.
        await record.until(lambda: len(record.of("TIC103.PV")) >= 4, 60.0)
        values = {one.value for one in record.of("TIC103.PV") if one.quality == GOOD}
        assert values == {33.0}
        assert abs(record.of("TIC103.PV")[-1].time_us / 1e6 - time.time()) < 60.0


async def test_strange_values_are_never_good(
    follow: Callable[..., Any], peer: Callable[..., Any], free_port: int, origin: dt.datetime
) -> None:
    server = peer("opcua_server.py", free_port, origin.isoformat())
    await asyncio.to_thread(server.start)
    expected = {
        "text": Quality.CONFIG_ERROR,
        "array": Quality.CONFIG_ERROR,
        "time": Quality.CONFIG_ERROR,
        "missing": Quality.CONFIG_ERROR,
        "nan": Quality.SENSOR_FAILURE,
        "infinite": Quality.SENSOR_FAILURE,
        "null": Quality.SENSOR_FAILURE,
        "future": Quality.UNCERTAIN,
        "untimed": Quality.UNCERTAIN,
        "huge": Quality.GOOD,
        "flag": Quality.GOOD,
        "overflow": Quality.GOOD,
    }
    async with follow(*expected) as record:
        await record.until(lambda: all(record.of(name) for name in expected))
        await record.until(lambda: len(record.of("untimed")) >= 5)
        now_us = time.time_ns() // 1000
        for name, quality in expected.items():
            for one in record.of(name):
                assert one.quality == quality, name
                assert math.isnan(one.value) == (quality < 64)
                assert abs(one.time_us - now_us) < 120e6
        assert record.of("huge")[0].value == 2.0**63
        problems = record.driver.health().problems
        assert problems["bench/text"] == "node holds a str, expected a number"
        assert problems["bench/missing"].endswith("BadNodeIdUnknown")
        assert problems["bench/untimed"] == "no source time"
        assert record.driver.health().errors["overflow"] >= 1


async def test_values_are_turned_from_the_unit_that_the_server_states(
    follow: Callable[..., Any], peer: Callable[..., Any], free_port: int, origin: dt.datetime
) -> None:
    server = peer("opcua_server.py", free_port, origin.isoformat())
    await asyncio.to_thread(server.start)
    expected = {
        "t_kelvin_c": (23.0, Quality.GOOD),
        "load_n": (2650.0, Quality.GOOD),
        "t_pressure_c": (3.0, Quality.UNCERTAIN),
    }
    async with follow(*expected) as record:
        await record.until(lambda: all(record.of(name) for name in expected))
        for name, (value, quality) in expected.items():
            for one in record.of(name):
                assert (one.value, one.quality) == (pytest.approx(value), quality), name
        assert record.driver.health().problems == {
            "bench/t_pressure_c": "the server has it in 'bar'; expected °C, K, °F, or scale"
        }


async def test_a_unit_that_the_server_does_not_say_is_asked_for_again(
    follow: Callable[..., Any],
    peer: Callable[..., Any],
    free_port: int,
    origin: dt.datetime,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("adapters.drivers.opcua.unit_questions.AGAIN_FIRST_S", 0.2)
    server = peer("opcua_server.py", free_port, origin.isoformat())
    await asyncio.to_thread(server.start)
    async with (
        follow("t_silent_c", "t_kelvin_c") as record,
        Client(f"opc.tcp://127.0.0.1:{free_port}/plc") as plc,
    ):
        await record.until(lambda: bool(record.of("t_silent_c") and record.of("t_kelvin_c")), 60.0)
        assert {(one.value, one.quality) for one in record.of("t_silent_c")} == {
            (296.15, Quality.UNCERTAIN)
        }
        assert {one.quality for one in record.of("t_kelvin_c")} == {GOOD}
        assert record.driver.health().problems == {
            "bench/t_silent_c": "the server does not say its unit: BadInternalError; "
            "expected one, or scale"
        }
        space = await plc.get_namespace_index("urn:example:plc")
        unit = ua.EUInformation(DisplayName=ua.LocalizedText("K"))
        await plc.get_node(ua.NodeId("t_silent_c/eu", space)).write_value(unit)
        # The value stands still all the time.
        await record.until(lambda: record.of("t_silent_c")[-1].quality == GOOD, 60.0)
        assert record.of("t_silent_c")[-1].value == pytest.approx(23.0)
        assert record.driver.health().problems == {}


async def test_a_unit_that_changes_while_the_driver_follows_is_found(
    follow: Callable[..., Any],
    peer: Callable[..., Any],
    free_port: int,
    origin: dt.datetime,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("adapters.drivers.opcua.unit_questions.CHECK_S", 0.2)
    server = peer("opcua_server.py", free_port, origin.isoformat())
    await asyncio.to_thread(server.start)
    async with (
        follow("t_kelvin_c") as record,
        Client(f"opc.tcp://127.0.0.1:{free_port}/plc") as plc,
    ):
        await record.until(lambda: bool(record.of("t_kelvin_c")), 60.0)
        assert record.of("t_kelvin_c")[-1].value == pytest.approx(23.0)
        space = await plc.get_namespace_index("urn:example:plc")
        (unit,) = await plc.get_node(ua.NodeId("t_kelvin_c", space)).get_properties()
        await unit.write_value(ua.EUInformation(DisplayName=ua.LocalizedText("°C")))
        await record.until(lambda: record.of("t_kelvin_c")[-1].value > 200.0, 60.0)
        assert record.of("t_kelvin_c")[-1].value == pytest.approx(296.15)


@pytest.mark.parametrize("begins", ["before the driver connects", "while the driver follows"])
async def test_every_change_is_taken_though_the_source_time_stands_still(
    begins: str,
    follow: Callable[..., Any],
    peer: Callable[..., Any],
    free_port: int,
    origin: dt.datetime,
) -> None:
    server = peer("opcua_server.py", free_port, origin.isoformat())
    await asyncio.to_thread(server.start)
    async with Client(f"opc.tcp://127.0.0.1:{free_port}/plc") as plc:
        space = await plc.get_namespace_index("urn:example:plc")
        node = plc.get_node(ua.NodeId("TIC104.PV", space))
        an_hour_ago = origin - dt.timedelta(hours=1)

        async def write(value: float) -> None:
            await node.write_value(ua.DataValue(ua.Variant(value), SourceTimestamp=an_hour_ago))

        if begins == "before the driver connects":
            await write(1.0)
        async with follow("TIC104.PV") as record:
            await record.until(lambda: bool(record.of("TIC104.PV")), 60.0)
            await write(2.0)
            for value in (3.0, 4.0, 5.0):
                await record.until(partial(has_value, record, value - 1.0), 60.0)
                await write(value)
            await record.until(partial(has_value, record, 5.0), 60.0)
            changes = [one for one in record.of("TIC104.PV") if one.value in (3.0, 4.0, 5.0)]
            problem = record.driver.health().problems["bench/TIC104.PV"]
    assert {one.quality for one in changes} == {Quality.UNCERTAIN}
    assert sorted({one.value for one in changes}) == [3.0, 4.0, 5.0]
    times = [one.time_us for one in changes]
    assert times == sorted(set(times))
    now_us = time.time_ns() // 1000
    assert all(now_us - 300e6 < one <= now_us for one in times), "the hour-old time is not taken"
    assert problem == "source time stands still while the value changes"


def has_value(record: Any, value: float) -> bool:
    return any(one.value == value for one in record.of("TIC104.PV"))


async def test_encrypted_only_with_the_pinned_server(
    follow: Callable[..., Any],
    peer: Callable[..., Any],
    free_port: int,
    origin: dt.datetime,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = peer("opcua_server.py", free_port, origin.isoformat(), tmp_path)
    await asyncio.to_thread(server.start)
    security = {
        "security_policy": "Basic256Sha256",
        "server_certificate": str(tmp_path / "server.der"),
        "certificate": str(tmp_path / "client.der"),
        "private_key": str(tmp_path / "client.pem"),
        "user": "twin",
        "password_variable": "PLC_PASSWORD",
    }
    monkeypatch.setenv("PLC_PASSWORD", "secret")
    async with follow("TIC101.PV", **security) as record:
        await record.until(lambda: GOOD in record.qualities("TIC101.PV"), 60.0)
    wrong = {**security, "server_certificate": str(tmp_path / "other.der")}
    async with follow("TIC101.PV", **wrong) as record:
        await record.until(lambda: record.driver.health().errors.get("connect", 0) >= 2)
        health = record.driver.health()
        assert not health.up
        assert "is not the pinned one, other.der" in health.detail
        assert set(record.qualities("TIC101.PV")) == {int(Quality.COMM_FAILURE)}
    monkeypatch.setenv("PLC_PASSWORD", "wrong")
    async with follow("TIC101.PV", **security) as record:
        await record.until(lambda: record.driver.health().errors.get("connect", 0) >= 2)
        assert "User does not have permission" in record.driver.health().detail
    async with follow("TIC101.PV") as record:  # the server takes no connection in the clear
        await record.until(lambda: record.driver.health().errors.get("connect", 0) >= 2)
        assert GOOD not in record.qualities("TIC101.PV")
