"""What a Modbus server and a clock can do to the driver, each with a real server."""

import asyncio
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from faults.hall import SteppedClock
from processes import free_port
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adapters.drivers.modbus.config import ModbusChannel, ModbusTcpSource
from adapters.drivers.modbus.driver import ModbusDriver
from adapters.protocol import ChannelBinding
from adapters.samples import Quality, Sample

pytestmark = [pytest.mark.wires, pytest.mark.endurance]

VALUE = 215.0


class Line:
    """A driver that reads some registers, and what it has handed over."""

    def __init__(self, port: int, registers: int = 1, units: int = 1) -> None:
        self.clock = SteppedClock()
        source = ModbusTcpSource(
            name="s", host="127.0.0.1", port=port, poll_interval_s=0.05, timeout_s=0.3
        )
        bindings = [
            ChannelBinding(
                "a",
                f"c{register}",
                ModbusChannel.model_validate(
                    {"source": "s", "register": 0 if units > 1 else register}
                    | {"unit_id": 1 + register % units}
                ),
            )
            for register in range(registers)
        ]
        self.driver = ModbusDriver(source, bindings, [], self.clock)
        self.samples: list[Sample] = []

    async def run(self) -> None:
        async with self.driver:
            async for batch in self.driver.batches():
                self.samples += batch.samples

    async def until(self, quality: int, count: int = 1) -> None:
        """Wait for so many further samples of a quality."""
        end = time.monotonic() + 10
        begin = len(self.samples)
        while sum(one.quality == quality for one in self.samples[begin:]) < count:
            assert time.monotonic() < end, (quality, self.driver.health())
            await asyncio.sleep(0.01)


@contextmanager
def listening(port: int) -> Iterator[subprocess.Popen[str]]:
    """Serve register 0 from a process of its own."""
    script = f"""
from pyModbusTCP.server import DataBank, ModbusServer
bank = DataBank(h_regs_size=4)
bank.set_holding_registers(0, [{int(VALUE)}, 2, 3, 4])
server = ModbusServer(host="127.0.0.1", port={port}, no_block=True, data_bank=bank)
server.start()
print("listening", flush=True)
import threading
threading.Event().wait()
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "listening\n"
        try:
            yield process
        finally:
            process.kill()


def assert_sound(samples: list[Sample]) -> None:
    assert {one.value for one in samples if one.quality >= 64} == {VALUE}
    assert all(math.isnan(one.value) for one in samples if one.quality < 64)
    assert len({(one.channel, one.time_us) for one in samples}) == len(samples)


async def test_a_frozen_server_gives_one_bad_sample_and_comes_back() -> None:
    port = free_port()
    with listening(port) as server:
        line = Line(port)
        task = asyncio.create_task(line.run())
        await line.until(Quality.GOOD, 3)
        for _ in range(2):
            os.kill(server.pid, signal.SIGSTOP)
            await line.until(Quality.COMM_FAILURE)
            count = len(line.samples)
            await asyncio.sleep(0.5)
            assert len(line.samples) == count, "the gap is marked once"
            os.kill(server.pid, signal.SIGCONT)
            await line.until(Quality.GOOD, 3)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert_sound(line.samples)
    assert [one.time_us for one in line.samples] == sorted(one.time_us for one in line.samples)


async def test_a_clock_set_back_and_forward_stops_nothing_and_stamps_nothing_twice() -> None:
    port = free_port()
    with listening(port):
        line = Line(port)
        task = asyncio.create_task(line.run())
        for hours in (0, 1, -1, 24, 0):
            line.clock.step_us = hours * 3_600_000_000
            await line.until(Quality.GOOD, 5)
            behind_us = line.clock.now_us() - line.samples[-1].time_us
            assert abs(behind_us) < 2_000_000, "the clock is followed"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert_sound(line.samples)
    assert {one.quality for one in line.samples} == {int(Quality.GOOD)}


AFTER = {
    1: Quality.CONFIG_ERROR,
    2: Quality.CONFIG_ERROR,
    3: Quality.CONFIG_ERROR,
    4: Quality.DEVICE_FAILURE,
    5: Quality.LAST_USABLE,
    6: Quality.LAST_USABLE,
    7: Quality.DEVICE_FAILURE,
    8: Quality.DEVICE_FAILURE,
    10: Quality.COMM_FAILURE,
    11: Quality.COMM_FAILURE,
}


@pytest.mark.parametrize("code", AFTER)
async def test_an_exception_never_becomes_a_value(
    code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The longest wait after a refusal is shortened: it is not what is tested.
    monkeypatch.setattr("adapters.drivers.modbus.driver.REFUSED_READ_S", 0.2)
    answer: list[ExcCodes] = []

    async def action(*_: object) -> ExcCodes | None:
        return answer[0] if answer else None

    registers = [SimData(0, values=[int(VALUE)] * 4, datatype=DataType.REGISTERS)]
    bits = [SimData(0, values=[True] * 8, datatype=DataType.BITS)]
    device = SimDevice(1, simdata=(bits, bits, registers, registers), action=action)
    port = free_port()
    server = ModbusTcpServer([device], address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    line = Line(port)
    task = asyncio.create_task(line.run())
    try:
        await line.until(Quality.GOOD, 2)
        answer.append(ExcCodes(code))
        await line.until(AFTER[code])
        if code < 10:  # 10 and 11: the gateway speaks, the whole unit does not
            end = time.monotonic() + 10
            while not line.driver.health().problems.get("a/c0"):
                assert time.monotonic() < end, "health says what is wrong with the channel"
                await asyncio.sleep(0.01)
        answer.clear()
        await line.until(Quality.GOOD, 2)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await server.shutdown()
    assert_sound(line.samples)
    assert {one.quality for one in line.samples} == {int(Quality.GOOD), int(AFTER[code])}


async def test_what_was_split_by_a_refusal_is_read_in_one_request_again() -> None:
    refusing, requests = [True], [0]

    async def action(*_: object) -> ExcCodes | None:
        requests[0] += 1
        return ExcCodes(2) if refusing else None

    registers = [SimData(0, values=[int(VALUE)] * 4, datatype=DataType.REGISTERS)]
    bits = [SimData(0, values=[True] * 8, datatype=DataType.BITS)]
    device = SimDevice(1, simdata=(bits, bits, registers, registers), action=action)
    port = free_port()
    server = ModbusTcpServer([device], address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    line = Line(port, registers=3)
    (unit,) = (part for one in line.driver._units for part in one.maps)
    unit.join_backoff.wait_s = 0.5
    task = asyncio.create_task(line.run())
    try:
        await line.until(Quality.CONFIG_ERROR, 3)
        assert len(unit.groups) == 3
        refusing.clear()
        for group in unit.groups:
            group.retry_at = 0.0
        await line.until(Quality.GOOD, 3)
        end = time.monotonic() + 20
        while len(unit.groups) > 1:
            assert time.monotonic() < end, "joined again"
            await asyncio.sleep(0.05)
        asked, polled = requests[0], line.driver.health().polls
        await line.until(Quality.GOOD, 15)
        assert requests[0] - asked <= line.driver.health().polls - polled + 1
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await server.shutdown()
    assert_sound(line.samples)


async def test_units_that_all_fell_silent_are_not_left_out_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("adapters.drivers.modbus.driver.RECONNECT_LAST_S", 0.3)
    port = free_port()

    def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    gateway = await asyncio.start_server(hang_up, "127.0.0.1", port)
    line = Line(port, registers=2, units=2)
    task = asyncio.create_task(line.run())
    try:
        await line.until(Quality.COMM_FAILURE, 2)
        for unit in line.driver._units:
            unit.retry_at = time.monotonic() + 60  # as after a long outage
        gateway.close()
        await gateway.wait_closed()
        with listening(port):
            await line.until(Quality.GOOD, 4)
            assert {one.channel for one in line.samples if one.quality >= 192} == {"c0", "c1"}
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
