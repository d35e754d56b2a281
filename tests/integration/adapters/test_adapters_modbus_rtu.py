"""The Modbus driver on a serial line: a real server at the other end of a pair of terminals."""

import asyncio
import contextlib
import os
import tty
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adapters.configuration import ConfigurationError
from adapters.registry import driver_spec
from adapters.samples import Quality

pytestmark = pytest.mark.wires

GOOD = int(Quality.GOOD)
COMM = int(Quality.COMM_FAILURE)
NOBODY = 9
"""Address of a unit that is not on the line."""


class Line:
    """A serial line between two terminals that can be cut, or spoil what it carries."""

    def __init__(self) -> None:
        self._masters: list[int] = []
        self.ends: list[str] = []
        for _ in range(2):
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._masters.append(master)
            self.ends.append(os.ttyname(slave))
            self._slaves = [*getattr(self, "_slaves", []), slave]
        self.cut = False
        self.spoil = False
        loop = asyncio.get_running_loop()
        for here, there in (self._masters, self._masters[::-1]):
            loop.add_reader(here, self._carry, here, there)

    def _carry(self, here: int, there: int) -> None:
        with contextlib.suppress(BlockingIOError):
            data = bytearray(os.read(here, 4096))
            if self.spoil and here == self._masters[1]:
                data[-3] ^= 0x10
            if not self.cut and data[0] != NOBODY:
                os.write(there, bytes(data))

    def close(self) -> None:
        for master in self._masters:
            asyncio.get_running_loop().remove_reader(master)
            os.close(master)
        for slave in self._slaves:
            os.close(slave)


def unit(number: int) -> SimDevice:
    registers = [SimData(0, values=[215 + number, 0x8000], datatype=DataType.REGISTERS)]
    bits = [SimData(0, values=[True], datatype=DataType.BITS)]
    return SimDevice(number, simdata=(bits, bits, registers, registers))


@pytest.fixture
async def line() -> AsyncIterator[Line]:
    line = Line()
    server = ModbusSerialServer(
        [unit(1), unit(2)], framer=FramerType.RTU, port=line.ends[1], baudrate=115200
    )
    await server.serve_forever(background=True)
    yield line
    await server.shutdown()
    line.close()


@pytest.fixture
def source(line: Line) -> dict[str, Any]:
    return {
        "driver": "modbus-rtu",
        "device": line.ends[0],
        "baudrate": 115200,
        "parity": "N",  # a terminal that is no serial port takes no other
        "poll_interval_s": 0.1,
        "timeout_s": 5.0,  # a slow machine is no dead device
    }


CHANNELS = {
    "t_inner_ring_c": {"register": 0, "kind": "input", "scale": 0.1},
    "t_outer_ring_c": {"register": 0, "kind": "input", "scale": 0.1, "unit_id": 2},
    "ambient_c": {"register": 1, "kind": "input", "scale": 0.1, "sentinels": [-32768]},
}


def newest(record: Any, channel: str) -> Any:
    samples = [one for batch in record.batches for one in batch.samples if one.channel == channel]
    return samples[-1] if samples else None


async def test_units_on_one_line_are_read(
    source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: len(record.batches) >= 3)
        assert newest(record, "t_inner_ring_c").value == pytest.approx(21.6)
        assert newest(record, "t_outer_ring_c").value == pytest.approx(21.7)
        assert newest(record, "t_outer_ring_c").quality == GOOD
        assert newest(record, "ambient_c").quality == Quality.SENSOR_FAILURE
        assert record.driver.health().up
        assert record.driver.health().driver == "modbus-rtu"


@pytest.mark.parametrize("fault", ["cut", "spoil"])
async def test_a_disturbed_line_gives_no_value_and_comes_back(
    line: Line, source: dict[str, Any], drive: Callable[..., Any], fault: str
) -> None:
    async with drive(source | {"timeout_s": 1.0}, CHANNELS) as record:
        await record.until(lambda: len(record.batches) >= 2)
        setattr(line, fault, True)
        await record.until(lambda: newest(record, "t_inner_ring_c").quality == COMM)
        await record.until(lambda: newest(record, "t_outer_ring_c").quality == COMM)
        assert not record.driver.health().up
        assert newest(record, "t_inner_ring_c").value != newest(record, "t_inner_ring_c").value
        setattr(line, fault, False)
        await record.until(lambda: newest(record, "t_inner_ring_c").quality == GOOD)
        await record.until(lambda: newest(record, "t_outer_ring_c").quality == GOOD)
        values = {
            one.value
            for batch in record.batches
            for one in batch.samples
            if one.channel == "t_inner_ring_c" and one.quality == GOOD
        }
        assert sorted(values) == [pytest.approx(21.6)], "nothing spoilt was ever taken"


async def test_a_unit_that_is_not_there_does_not_silence_the_others(
    source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    missing = {"t_node_1_c": {"register": 0, "kind": "input", "unit_id": NOBODY}}
    async with drive(source | {"timeout_s": 1.0}, CHANNELS | missing) as record:
        await record.until(lambda: newest(record, "t_node_1_c") is not None)
        assert newest(record, "t_node_1_c").quality == COMM
        seen = len(record.batches)
        await record.until(lambda: len(record.batches) >= seen + 5)
        await record.until(lambda: newest(record, "t_inner_ring_c").quality == GOOD)
        assert "unit 9" in record.driver.health().detail


async def test_a_port_that_appears_later_is_found(
    line: Line, source: dict[str, Any], drive: Callable[..., Any], tmp_path: Path
) -> None:
    plugged = tmp_path / "ttyUSB0"
    async with drive(source | {"device": str(plugged)}, CHANNELS) as record:
        await record.until(lambda: "cannot connect" in record.driver.health().detail)
        plugged.symlink_to(line.ends[0])
        await record.until(lambda: newest(record, "t_inner_ring_c") is not None)
        await record.until(lambda: newest(record, "t_inner_ring_c").quality == GOOD)


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"baudrate": 12}, "baudrate"),
        ({"parity": "even"}, "parity"),
        ({"device": ""}, "device"),
        ({"host": "127.0.0.1"}, "host"),
    ],
)
def test_a_wrong_key_is_named(keys: dict[str, Any], complaint: str) -> None:
    spec = driver_spec("modbus-rtu")
    given = {"name": "line", "driver": "modbus-rtu", "device": "/dev/ttyS0"} | keys
    with pytest.raises((ValueError, ConfigurationError), match=complaint):
        spec.source_model.model_validate(given)


async def test_a_port_that_refuses_the_settings_is_no_end(
    source: dict[str, Any], drive: Callable[..., Any]
) -> None:
    async with drive(source | {"parity": "E"}, CHANNELS) as record:
        await record.until(lambda: "cannot connect" in record.driver.health().detail)
        await record.until(lambda: newest(record, "t_inner_ring_c") is not None)
        assert newest(record, "t_inner_ring_c").quality == COMM
