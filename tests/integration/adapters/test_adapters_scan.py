"""What a stranger's device gives, on a real Modbus server and real CAN frames."""

import asyncio
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import free_port
from strange_bench import (
    AMBIENT_C,
    DBC,
    FIRST_REGISTER,
    INNER_C,
    LOAD_N,
    OUTER_C,
    SPEED_RPM,
    UNIT,
    StrangeBench,
    registers,
    running_strange_bench,
)

from adapters.drivers.can.config import CanSource
from adapters.drivers.can.scan import listen
from adapters.drivers.modbus.config import ModbusTcpSource
from adapters.drivers.modbus.link import LinkLostError
from adapters.drivers.modbus.scan import ORDERS, in_every_way, read_registers, scan_units

pytestmark = pytest.mark.wires
_FORMATS = {"float32": "f", "int32": "i", "uint32": "I"}


@pytest.fixture(scope="module")
def bench() -> Iterator[StrangeBench]:
    with running_strange_bench() as bench:
        yield bench


def modbus(port: int) -> ModbusTcpSource:
    return ModbusTcpSource(name="s", host="127.0.0.1", port=port, timeout_s=5.0)


def test_the_unit_that_is_there_is_found(bench: StrangeBench) -> None:
    found = asyncio.run(scan_units(modbus(bench.modbus_port), range(UNIT - 2, UNIT + 2)))
    assert [one.unit for one in found if one.answers] == [UNIT]


def test_registers_are_found_between_those_that_are_not_there(bench: StrangeBench) -> None:
    source = modbus(bench.modbus_port)
    found = asyncio.run(read_registers(source, UNIT, "holding", 32, 32))
    there = {one.register: one for one in found if one.word is not None}
    assert [one.word for one in there.values()] == registers()
    first = FIRST_REGISTER
    assert there[first].values["float32 CDAB"] == OUTER_C
    assert there[first + 2].values["int16"] == INNER_C * 10
    assert there[first + 3].values["float32 CDAB"] == AMBIENT_C
    assert "float32 CDAB" not in there[first + 4].values  # the next register is not there


def test_nobody_there_is_said(bench: StrangeBench) -> None:
    with pytest.raises(LinkLostError, match="no connection"):
        asyncio.run(scan_units(modbus(free_port()), [1]))


@given(data=st.binary(min_size=4, max_size=4))
def test_every_order_is_the_bytes_in_that_order(data: bytes) -> None:
    words = struct.unpack(">2H", data)
    [first, last] = in_every_way("holding", 10, words)
    assert (first.register, last.register) == (10, 11)
    by_letter = dict(zip("ABCD", data, strict=True))
    for order in ORDERS:
        # A device that writes a value in this order has put its bytes A to D on the wire so.
        meant = bytes(by_letter["ABCD"[order.index(letter)]] for letter in "ABCD")
        for name, letter in _FORMATS.items():
            [value] = struct.unpack(f">{letter}", meant)
            shown = first.values[f"{name} {order}"]
            assert shown == value or (math.isnan(shown) and not math.isfinite(value))
    assert last.values.keys() == {"int16", "uint16"}


def test_signals_that_arrive_are_told_from_those_that_do_not(
    bench: StrangeBench, tmp_path: Path
) -> None:
    dbc = tmp_path / "bench.dbc"
    dbc.write_text(DBC.replace("BO_ 528", "BO_ 529"))  # the force comes under another identifier
    source = CanSource.model_validate(
        {
            "name": "drive",
            "interface": "socketcand",
            "channel": "can0",
            "dbc": dbc,
            "host": "127.0.0.1",
            "port": bench.can_port,
        }
    )
    seen = listen(source, 2.0)
    values = {one.signal: one.value for one in seen.signals}
    assert values == {
        "ShaftRpm": SPEED_RPM,
        "RunHours": 1234.0,
        "RadialForce": None,
        "Velocity": None,
    }
    assert seen.unknown == ("210",)
    dbc.write_text(DBC)
    assert {one.signal: one.value for one in listen(source, 2.0).signals}["RadialForce"] == LOAD_N
