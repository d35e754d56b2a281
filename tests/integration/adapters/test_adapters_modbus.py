"""The Modbus driver against real servers."""

import asyncio
import contextlib
import itertools
import logging
import statistics
import struct
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from integration.adapters.modbus_device import Device
from patience import wait_for
from pymodbus.constants import ExcCodes
from pymodbus.framer.rtu import FramerRTU
from pymodbus.server import ModbusTcpServer

from adapters.samples import PlanStep, Quality

pytestmark = pytest.mark.wires

GOOD = int(Quality.GOOD)
COMM = int(Quality.COMM_FAILURE)


@pytest.fixture
async def device(free_port: int) -> AsyncIterator[Device]:
    one = Device()
    server = ModbusTcpServer([one.unit(1), one.unit(2)], address=("127.0.0.1", free_port))
    await server.serve_forever(background=True)
    yield one
    await server.shutdown()


@pytest.fixture
def source(free_port: int) -> dict[str, Any]:
    return {
        "driver": "modbus-tcp",
        "host": "127.0.0.1",
        "port": free_port,
        "poll_interval_s": 0.05,
        "timeout_s": 5.0,  # a slow machine is no dead device
    }


def temperature(register: int, **keys: Any) -> dict[str, Any]:
    return {"register": register, "kind": "input", "type": "int16", "scale": 0.1, **keys}


async def test_values_qualities_and_grouped_reads(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    channels = {
        "t_inner_ring_c": temperature(0),
        "t_outer_ring_c": temperature(1, sentinels=[-32768]),
        "ambient_c": temperature(2, valid_range=[-20, 25]),
        "load_n": {"register": 3, "kind": "input", "type": "float32"},
        "speed_rpm": {"register": 5, "kind": "input", "type": "float32"},
        "phase": {"register": 2, "kind": "coil"},
        "t_node_5_c": temperature(0, status={"register": 7, "bits": {"5": "wire break"}}),
    }
    async with drive(source, channels) as record:
        await record.until(lambda: len(record.batches) >= 4)
        first = {sample.channel: sample for sample in record.batches[0].samples}
        assert {name: (s.quality, s.value) for name, s in first.items() if s.value == s.value} == {
            "t_inner_ring_c": (GOOD, pytest.approx(21.5)),
            "ambient_c": (Quality.EU_EXCEEDED, pytest.approx(30.0)),
            "load_n": (GOOD, 87.5),
            "phase": (GOOD, 1.0),
            "t_node_5_c": (GOOD, pytest.approx(21.5)),
        }
        assert first["t_outer_ring_c"].quality == Quality.SENSOR_FAILURE
        assert first["speed_rpm"].quality == Quality.SENSOR_FAILURE
        health = record.driver.health()
        assert health.up
        assert health.errors["sentinel"] >= 4
        assert "bench/t_outer_ring_c: no value (sentinel -32768)" in health.detail
        assert "bench/speed_rpm: not a number" in health.detail
        polls = record.driver.health().polls
        assert polls <= len(device.requests) / 2 <= polls + 1  # one request per kind
        assert all(0.0 < batch.poll_s < 5.0 for batch in record.batches)
    assert device.most_at_once == 1


async def test_a_register_that_does_not_exist_does_not_blind_the_others(
    device: Device,
    source: dict[str, Any],
    drive: Callable[..., Any],
    caplog: pytest.LogCaptureFixture,
) -> None:
    channels = {f"t_node_{i + 1}_c": temperature(i) for i in range(6)}
    channels["t_inner_ring_c"] = temperature(9)  # the device has 0 to 8 and 40 on
    channels["t_outer_ring_c"] = temperature(12)
    with caplog.at_level(logging.WARNING):
        async with drive(source, channels) as record:
            await record.until(lambda: record.driver.health().polls >= 10)
            for i in range(6):
                assert set(record.qualities(f"t_node_{i + 1}_c")) == {GOOD}
            for wrong in ("t_inner_ring_c", "t_outer_ring_c"):
                assert set(record.qualities(wrong)) == {int(Quality.CONFIG_ERROR)}
            requests = len(device.requests)
            await record.until(lambda: record.driver.health().polls >= 20)
            assert len(device.requests) - requests <= 25  # found once, not searched every time
            health = record.driver.health()
    assert health.up
    assert "bench/t_inner_ring_c: register 9 (input, unit 1) does not exist" in health.detail
    lines = [r.getMessage() for r in caplog.records if "register 9" in r.getMessage()]
    assert lines == [
        "source s: channel bench/t_inner_ring_c: register 9 (input, unit 1) does not exist: "
        "illegal data address"
    ]


async def test_a_device_failure_of_one_register_does_not_blind_the_others(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    device.exceptions[1, 3] = ExcCodes.DEVICE_FAILURE  # what some devices say of a gap
    channels = {f"t_node_{i + 1}_c": temperature(i) for i in range(6)}
    async with drive(source, channels) as record:
        await record.until(lambda: record.driver.health().polls >= 10)
        for i in (0, 1, 2, 4, 5):
            assert set(record.qualities(f"t_node_{i + 1}_c")) == {GOOD}
        assert set(record.qualities("t_node_4_c")) == {int(Quality.DEVICE_FAILURE)}
        assert record.driver.health().up
        device.exceptions.clear()
        await record.until(lambda: record.qualities("t_node_4_c")[-1] == GOOD)


async def test_busy_keeps_the_last_value_as_uncertain_and_never_becomes_zero(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    device.exceptions[1, 0] = ExcCodes.DEVICE_BUSY
    async with drive(source, {"t_inner_ring_c": temperature(0)}) as record:
        await record.until(lambda: record.samples)
        assert record.samples[0].quality == Quality.WAITING_FOR_INITIAL_DATA
        device.exceptions.clear()
        await record.until(lambda: GOOD in record.qualities("t_inner_ring_c"))
        device.exceptions[1, 0] = ExcCodes.DEVICE_BUSY
        await record.until(lambda: Quality.LAST_USABLE in record.qualities("t_inner_ring_c"))
        device.exceptions[1, 0] = ExcCodes.DEVICE_FAILURE
        await record.until(lambda: Quality.DEVICE_FAILURE in record.qualities("t_inner_ring_c"))
        assert {s.value for s in record.samples if s.quality >= 64} == {21.5}


@pytest.mark.parametrize("fault", ["timeout", "gateway"])
async def test_a_dead_unit_stalls_the_others_once_and_comes_back_by_itself(
    device: Device, source: dict[str, Any], drive: Callable[..., Any], fault: str
) -> None:
    channels = {
        "t_inner_ring_c": temperature(0),
        "t_outer_ring_c": temperature(0, unit_id=2),
    }
    source["timeout_s"] = 2.0
    async with drive(source, channels) as record:
        await record.until(lambda: len(record.of("t_outer_ring_c")) >= 3)
        alive_before = len(record.of("t_inner_ring_c"))
        if fault == "timeout":
            device.delay_s[2] = 30.0
        else:
            device.exceptions[2, 0] = ExcCodes.GATEWAY_NO_RESPONSE
        await record.until(lambda: COMM in record.qualities("t_outer_ring_c"))
        asked, polls = device.asked(2), record.driver.health().polls
        await record.until(lambda: device.asked(2) >= asked + 2)  # it is tried again
        await record.until(lambda: record.driver.health().polls >= polls + 20)
        alive = record.of("t_inner_ring_c")[alive_before:]
        assert {s.quality for s in alive} == {GOOD}
        health = record.driver.health()
        assert health.up
        assert health.errors["no_answer"] == 1  # the others have waited once
        assert "unit 2:" in health.detail
        assert record.qualities("t_outer_ring_c").count(COMM) == 1  # the gap is marked once
        device.delay_s.clear()
        device.exceptions.clear()
        await record.until(lambda: record.qualities("t_outer_ring_c")[-1] == GOOD)
        assert record.qualities("t_outer_ring_c").count(COMM) == 1


async def test_the_plan_is_read_and_its_faults_leave_the_channels_alone(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    plan = {"register": 40, "rows": 10}
    async with drive(source, {"t_inner_ring_c": temperature(0)}, plan) as record:
        await record.until(lambda: record.plans)
        assert record.plans[0].asset == "bench"
        assert record.plans[0].steps == (
            PlanStep(600.0, 4200.0, 2650.0),
            PlanStep(1800.0, 6200.0, 5500.0),
        )
        device.exceptions[1, 40] = ExcCodes.ILLEGAL_ADDRESS
        await record.until(lambda: record.driver.health().errors.get("plan"))
        assert "plan of bench: exception 02" in record.driver.health().detail
        assert set(record.qualities("t_inner_ring_c")) == {GOOD}


async def test_a_plan_of_the_wrong_word_order_is_no_plan(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    plan = {"register": 40, "rows": 10, "word_order": "little"}
    async with drive(source, {"t_inner_ring_c": temperature(0)}, plan) as record:
        await record.until(lambda: record.driver.health().errors.get("plan"))
        assert not record.plans
        assert "implausible row 0" in record.driver.health().detail


async def test_the_process_clock_sets_the_pace(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    source["poll_interval_s"] = 1.0
    async with drive(source, {"t_inner_ring_c": temperature(0)}, rate=10.0) as record:
        began = time.monotonic()
        await record.until(lambda: len(record.samples) >= 30)
        assert time.monotonic() - began > 2.0  # of thirty
        times = [sample.time_us for sample in record.samples]
        polls = 1 + record.driver.health().skipped + len(times)
        assert (times[-1] - times[0]) / 1e6 == pytest.approx(polls - 2, abs=10.0)


async def test_cycles_that_come_too_late_are_skipped_and_never_queue(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    device.delay_s[1] = 0.1
    source["poll_interval_s"] = 0.02
    async with drive(source, {"t_inner_ring_c": temperature(0)}) as record:
        await record.until(lambda: len(record.samples) >= 8)
        health = record.driver.health()
        assert health.skipped >= 3 * health.polls
    assert device.most_at_once == 1


async def test_a_clock_that_is_set_back_does_not_stop_the_polling(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    async with drive(source, {"t_inner_ring_c": temperature(0)}) as record:
        await record.until(lambda: len(record.samples) >= 3)
        before = len(record.samples)
        record.clock.began += 3600.0
        record.clock_was_set_back = True
        await record.until(lambda: len(record.samples) >= before + 10)
        times = [sample.time_us for sample in record.samples[before + 1 :]]
        assert times[-1] <= record.clock.now_us()
        pauses = [later - earlier for earlier, later in itertools.pairwise(times)]
        assert statistics.median(pauses) > 25_000  # nothing is made up for


async def test_a_foreign_server_is_read_alike(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    peer("pymodbustcp_server.py", free_port).start()
    channels = {
        "t_inner_ring_c": temperature(0),
        "ambient_c": temperature(1),
        "speed_rpm": {
            "register": 2,
            "kind": "input",
            "type": "float32",
            "word_order": "little",
        },
        "load_n": {"register": 4, "kind": "input", "type": "uint32"},
        "phase": {"register": 1, "kind": "discrete"},
        "t_outer_ring_c": temperature(12),
    }
    async with drive(source, channels) as record:
        await record.until(lambda: len(record.batches) >= 3)
        values = {s.channel: s.value for s in record.samples if s.quality == GOOD}
        assert values == {
            "t_inner_ring_c": pytest.approx(21.5),
            "ambient_c": pytest.approx(-0.5),
            "speed_rpm": 87.5,
            "load_n": 70000.0,
            "phase": 1.0,
        }
        assert set(record.qualities("t_outer_ring_c")) == {int(Quality.CONFIG_ERROR)}


@pytest.mark.parametrize("script", ["pymodbus_server.py", "pymodbustcp_server.py"])
async def test_comes_back_by_itself_from_a_killed_server_also_at_the_first_start(
    source: dict[str, Any],
    free_port: int,
    drive: Callable[..., Any],
    peer: Callable[..., Any],
    script: str,
) -> None:
    server = peer(script, free_port)
    async with drive(source, {"a": temperature(0), "b": temperature(3)}) as record:
        await record.until(lambda: len(record.samples) == 2)
        assert [s.quality for s in record.samples] == [COMM, COMM]
        assert not record.driver.health().up
        await asyncio.sleep(0.5)
        assert len(record.samples) == 2  # the gap is marked once
        for restart in (1, 2):
            await asyncio.to_thread(server.start)
            await record.until(lambda: record.qualities("b")[-1] == GOOD)
            assert record.driver.health().up
            await asyncio.to_thread(server.kill)
            await record.until(lambda: record.qualities("a")[-1] == COMM)
            assert record.qualities("a").count(COMM) == restart + 1
            assert "cannot connect to 127.0.0.1" in record.driver.health().detail
    assert record.driver.health().reconnects == 1


Answer = Callable[[int, bytes], bytes | None]


@pytest.fixture
async def raw_server(free_port: int) -> AsyncIterator[list[Any]]:
    """A server that sends what the test puts in as answer(connection number, request)."""
    script: list[Any] = [None, 0, contextlib.nullcontext()]
    tasks = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tasks.add(asyncio.current_task())
        script[1] += 1
        number = script[1]
        try:
            async with script[2]:
                while request := await reader.read(260):
                    answer = script[0](number, request)
                    if asyncio.iscoroutine(answer):
                        answer = await answer
                    if answer is None:
                        break
                    writer.write(answer)
        except ConnectionError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", free_port)
    yield script
    server.close()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def registers_answer(request: bytes, *registers: int) -> bytes:
    payload = struct.pack(
        f">BBB{len(registers)}H", request[6], request[7], 2 * len(registers), *registers
    )
    return request[:4] + struct.pack(">H", len(payload)) + payload


async def test_a_late_reply_is_never_taken_for_the_answer_to_a_newer_request(
    raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    asked_again = asyncio.Event()

    async def late(number: int, request: bytes) -> bytes:
        if number == 1:
            # A next request that came the same way would be answered by this one.
            with contextlib.suppress(TimeoutError):
                await wait_for(asked_again.wait(), 4.0)
            # simple devices do not return the transaction number, so it cannot help
            return b"\0\0" + registers_answer(request, 111)[2:]
        asked_again.set()
        return registers_answer(request, 222)

    source["timeout_s"] = 1.0
    raw_server[0] = late
    async with drive(source, {"c": {"register": 0}}) as record:
        await record.until(lambda: len(record.samples) >= 10)
        assert record.qualities("c")[0] == COMM
        assert {s.value for s in record.samples[1:]} == {222.0}


async def test_a_gateway_that_serves_one_connection_gets_its_dead_unit_back(
    raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    dead = True

    async def gateway(number: int, request: bytes) -> bytes:
        if request[6] == 2 and dead:
            await asyncio.sleep(2.0)
            return b""
        return registers_answer(request, request[6])

    source["timeout_s"] = 1.0
    raw_server[2] = asyncio.Lock()  # a second connection is accepted, but has to wait
    raw_server[0] = gateway
    channels = {"a": {"register": 0}, "b": {"register": 0, "unit_id": 2}}
    async with drive(source, channels) as record:
        await record.until(lambda: len(record.of("a")) >= 20)
        assert record.qualities("b") == [COMM]
        dead = False
        await record.until(lambda: record.qualities("b")[-1] == GOOD)


async def test_a_server_that_closes_after_every_answer_costs_no_sample(
    raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    answered: set[int] = set()

    def once(number: int, request: bytes) -> bytes | None:
        if number in answered:
            return None
        answered.add(number)
        return registers_answer(request, number)

    raw_server[0] = once
    async with drive(source, {"c": {"register": 0}}) as record:
        await record.until(lambda: len(record.samples) >= 10)
        assert set(record.qualities("c")) == {GOOD}


def rtu(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


@pytest.mark.parametrize("framing", ["tcp", "tcp without transaction numbers", "rtu"])
async def test_an_answer_of_another_length_costs_its_register_and_not_its_unit(
    framing: str, raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    is_odd = True

    def registers_from(start: int, count: int) -> range:
        odd = is_odd and start <= 3 < start + count
        return range(start, start + count - odd)

    def answer(number: int, request: bytes) -> bytes:
        if framing == "rtu":
            unit, function, start, count = struct.unpack(">BBHH", request[:6])
            if function != 3:
                return rtu(bytes((unit, function | 0x80, 1)))
            values = registers_from(start, count)
            size = len(values)
            return rtu(struct.pack(f">BBB{size}H", unit, function, 2 * size, *values))
        values = registers_from(*struct.unpack(">HH", request[8:12]))
        complete = registers_answer(request, *values)
        return complete if framing == "tcp" else b"\0\0" + complete[2:]

    raw_server[0] = answer
    if framing == "rtu":
        source |= {"framing": "rtu", "timeout_s": 0.3}
    channels = {f"c{i}": {"register": i} for i in range(6)}
    async with drive(source, channels) as record:
        await record.until(lambda: record.driver.health().polls >= 10)
        for name in ("c0", "c1", "c2", "c4", "c5"):
            assert set(record.qualities(name)) == {GOOD}
            assert {one.value for one in record.of(name)} == {float(name[1:])}
        assert record.qualities("c3") == [COMM], "the gap is marked once"
        health = record.driver.health()
        assert health.up
        assert health.detail == (
            "bench/c3: register 3 (holding, unit 1): the answer has another length or function "
            "than was asked for"
        )
        if framing == "tcp":
            assert health.reconnects == 0
        is_odd = False
        await record.until(lambda: record.qualities("c3")[-1] == GOOD)
        assert record.of("c3")[-1].value == 3.0
        assert record.driver.health().detail == "ok"


async def test_bits_of_another_length_are_none(
    raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    number_of_transaction, sent = b"", b"\x01\x01"

    def answer(number: int, request: bytes) -> bytes:
        payload = request[6:8] + bytes((len(sent),)) + sent
        head = number_of_transaction or request[:2]
        return head + request[2:4] + struct.pack(">H", len(payload)) + payload

    raw_server[0] = answer
    async with drive(source, {"c": {"register": 0, "kind": "coil"}}) as record:
        await record.until(lambda: record.samples)
        assert record.samples[-1].value == 1.0, "some devices send whole words"
        number_of_transaction = b"\0\0"  # whose answer is it?
        await record.until(lambda: record.driver.health().polls >= 10)
        assert record.qualities("c")[-1] == COMM
        assert record.qualities("c").count(COMM) == 1, "the gap is marked once"
        sent = b"\x01"
        await record.until(lambda: record.samples[-1].value == 1.0)


async def test_an_answer_of_an_odd_length_is_none(
    raw_server: list[Any], source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    def answer(number: int, request: bytes) -> bytes:
        payload = request[6:8] + b"\x03\x00\x07\x07"
        return request[:4] + struct.pack(">H", len(payload)) + payload

    raw_server[0] = answer
    async with drive(source, {"c": {"register": 0}}) as record:
        await record.until(lambda: record.driver.health().polls >= 3)
        assert record.qualities("c") == [COMM]


async def test_what_was_refused_comes_back_together(
    device: Device, source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    """Not one after another, each after its own wait."""
    for address in range(8):
        device.exceptions[1, address] = ExcCodes.DEVICE_FAILURE
    channels = {f"c{i}": {"register": i} for i in range(8)}
    async with drive(source, channels) as record:
        await record.until(lambda: record.driver.health().polls >= 5)
        assert {one.quality for one in record.samples} == {int(Quality.DEVICE_FAILURE)}
        device.exceptions.clear()
        await record.until(lambda: any(one.quality == GOOD for one in record.samples))
        polls = record.driver.health().polls
        await record.until(lambda: all(record.qualities(name)[-1] == GOOD for name in channels))
        assert record.driver.health().polls <= polls + 3


def byte_count_lies(request: bytes) -> bytes:
    answer = bytearray(registers_answer(request, 7))
    answer[8] = 200
    return bytes(answer)


FOREIGN = {
    "byte count lies": byte_count_lies,
    "too few registers": lambda request: registers_answer(request),
    "too many registers": lambda request: registers_answer(request, 7, 7),
    "another function": lambda request: registers_answer(request[:7] + b"\x04", 7),
    "not Modbus": lambda request: b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "unknown function": lambda request: request[:4] + b"\x00\x04" + request[6:7] + b"\x63\x01\x02",
}


@pytest.mark.parametrize("answer", FOREIGN.values(), ids=FOREIGN)
async def test_a_foreign_answer_gives_no_value_and_no_traceback(
    raw_server: list[Any],
    source: dict[str, Any],
    drive: Callable[..., Any],
    caplog: pytest.LogCaptureFixture,
    answer: Callable[[bytes], bytes],
) -> None:
    source["timeout_s"] = 1.0
    raw_server[0] = lambda number, request: answer(request)
    with caplog.at_level(logging.INFO):
        async with drive(source, {"c": {"register": 0}}) as record:
            await record.until(lambda: record.samples)
            await asyncio.sleep(0.3)
            assert record.qualities("c") == [COMM]
            assert not record.driver.health().up
            raw_server[0] = lambda number, request: registers_answer(request, 42)
            await record.until(lambda: record.samples[-1].value == 42.0)
    assert not [r for r in caplog.records if r.name == "asyncio" and r.levelno >= logging.WARNING]
    assert not [r for r in caplog.records if r.exc_info]
