"""Devices with limits of their own: short reads, holes, gaps, several intervals, one connection."""

import asyncio
import itertools
import random
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adapters.samples import Quality

pytestmark = pytest.mark.wires

GOOD = int(Quality.GOOD)
READS = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}


class Wire:
    """A pymodbus server, and every frame that came over its wire. Register n holds n."""

    def __init__(self, holes: set[int] | None = None, most: int = 125) -> None:
        self.holes = holes or set()
        self.most = most
        self.frames: list[tuple[float, bytes]] = []
        self.unheard: bytes | None = None  # first byte of the frames that nobody answers
        self.answered_at = 0.0
        self.gaps_s: list[float] = []
        self.opened: list[float] = []
        self.refused = 0

    def trace(self, sending: bool, data: bytes) -> bytes:
        now = time.monotonic()
        if sending:
            self.answered_at = now
        elif data:
            if self.answered_at:
                self.gaps_s.append(now - self.answered_at)
            self.frames.append((now, data))
            if data[:1] == self.unheard:
                return b""
        return data

    def connect(self, connected: bool) -> None:
        if connected:
            self.opened.append(time.monotonic())
        self.answered_at = 0.0

    @property
    def requests(self) -> list[tuple[float, int, int, int, int]]:
        """Time, unit, function code, address, count of all that came as Modbus TCP."""
        found = []
        for at, data in self.frames:
            while data:
                length = 6 + int.from_bytes(data[4:6], "big")
                unit, function, address, count = struct.unpack(">BBHH", data[6:12])
                assert length == 12
                found.append((at, unit, function, address, count))
                data = data[length:]
        return found

    def unit(self, number: int) -> SimDevice:
        async def action(
            function: int, start: int, address: int, count: int, values: list[Any], _: Any
        ) -> ExcCodes | None:
            wanted = range(address, address + count)
            if self.holes.intersection(wanted) or count > self.most * (16 if function < 3 else 1):
                self.refused += 1
                return ExcCodes.ILLEGAL_ADDRESS
            return None

        registers = [SimData(0, values=list(range(600)), datatype=DataType.REGISTERS)]
        bits = [SimData(0, values=[n % 2 == 0 for n in range(2400)], datatype=DataType.BITS)]
        return SimDevice(number, simdata=(bits, bits, registers, registers), action=action)

    @asynccontextmanager
    async def served(
        self, port: int, framer: FramerType = FramerType.SOCKET
    ) -> AsyncIterator[None]:
        server = ModbusTcpServer(
            [self.unit(1), self.unit(2)],
            framer=framer,
            address=("127.0.0.1", port),
            trace_packet=self.trace,
            trace_connect=self.connect,
        )
        await server.serve_forever(background=True)
        try:
            yield
        finally:
            await server.shutdown()


def at(port: int, **keys: Any) -> dict[str, Any]:
    return {
        "driver": "modbus-tcp",
        "host": "127.0.0.1",
        "port": port,
        "poll_interval_s": 0.05,
        "timeout_s": 20.0,  # a slow machine is no dead device
        **keys,
    }


def random_channels(dice: random.Random) -> dict[str, dict[str, Any]]:
    channels: dict[str, dict[str, Any]] = {}
    for number in range(dice.randint(1, 25)):
        kind = dice.choice(list(READS.values()))
        channels[f"channel-{number}"] = {
            "kind": kind,
            "type": "bool" if kind in ("coil", "discrete") else "uint16",
            "register": dice.randint(0, 599),
            "unit_id": dice.choice([1, 2]),
            "poll_interval_s": dice.choice([None, 0.1, 0.2]),
        }
    return channels


async def all_read(record: Any, names: Iterable[str]) -> None:
    await record.until(lambda: all(len(record.of(name)) > 1 for name in names))


async def test_whatever_is_configured_only_reads_go_over_the_wire(
    free_port: int, drive: Callable[..., Any]
) -> None:
    dice = random.Random(7)
    for _ in range(15):
        most = dice.choice([1, 2, 10, 50, 125])
        wire = Wire(holes=set(dice.sample(range(600), dice.choice([0, 5, 60]))), most=most)
        channels = random_channels(dice)
        gap = dice.choice([None, 0, 3, 100])
        source = at(
            free_port,
            registers_per_read_max=most,
            register_gap_max=gap,
            request_gap_s=dice.choice([0.0, 0.0002]),
        )
        plan = {"register": 40, "rows": 3} if most >= 6 else None
        async with wire.served(free_port), drive(source, channels, plan) as record:
            await all_read(record, channels)
        for name, keys in channels.items():
            address = keys["register"]
            expected = address if keys["type"] == "uint16" else float(address % 2 == 0)
            for sample in record.of(name):
                if address in wire.holes:
                    assert sample.quality == Quality.CONFIG_ERROR
                else:
                    assert (sample.quality, sample.value) == (GOOD, expected)
        assert wire.requests
        for _, unit, function, address, count in wire.requests:
            assert function in READS
            assert 1 <= count <= (most * 16 if function < 3 else most)
            wanted = {
                keys["register"]
                for keys in channels.values()
                if (keys["unit_id"], keys["kind"]) == (unit, READS[function])
            }
            if (unit, function) == (1, 3) and plan:
                wanted |= set(range(40, 58))
            inside = sorted(wanted.intersection(range(address, address + count)))
            assert inside[0] == address
            assert inside[-1] == address + count - 1
            allowed = gap if gap is not None else 64 if function < 3 else 8
            assert all(b - a - 1 <= allowed for a, b in itertools.pairwise(inside))


async def test_holes_are_not_touched_where_the_configuration_says_so(
    free_port: int, drive: Callable[..., Any]
) -> None:
    wire = Wire(holes={n for n in range(100) if n % 3 == 2})
    channels = {
        f"channel-{n}": {"register": n, "type": "uint16"} for n in range(30) if n not in wire.holes
    }
    async with wire.served(free_port), drive(at(free_port, register_gap_max=0), channels) as record:
        await record.until(lambda: record.driver.health().polls >= 3)
        assert not wire.refused
        assert {sample.quality for sample in record.samples} == {GOOD}
        assert len(record.batches[0].samples) == len(channels)


async def test_a_fast_channel_keeps_its_rate_beside_many_slow_ones_and_gaps(
    free_port: int, drive: Callable[..., Any]
) -> None:
    gap_s, fast_s = 0.02, 0.25
    wire = Wire()
    channels: dict[str, dict[str, Any]] = {
        f"slow-{n}": {"register": 20 * n, "type": "uint16", "poll_interval_s": 2.0}
        for n in range(1, 29)
    }
    channels["fast"] = {"register": 0, "type": "uint16"}
    source = at(free_port, request_gap_s=gap_s, poll_interval_s=fast_s)
    async with wire.served(free_port), drive(source, channels) as record:
        await record.until(lambda: len(record.of("slow-28")) >= 3, timeout_s=60.0)
        health = record.driver.health()
        # Each as often as its interval asks for; what the machine was too slow for is counted.
        fast, slow = len(record.of("fast")), len(record.of("slow-28"))
        assert fast + health.skipped >= (slow - 1) * 2.0 / fast_s
        assert {sample.quality for sample in record.samples} == {GOOD}
    assert len(wire.opened) == 1
    # The event loop's timer may end a little early.
    assert min(wire.gaps_s) >= gap_s - 0.002
    # A slow round of 28 requests is interrupted by the fast channel as soon as that is due.
    between = 0
    for _, _, _, address, _ in wire.requests:
        between = 0 if address == 0 else between + 1
        assert between <= fast_s / gap_s + 2


async def test_a_pause_after_the_connection_and_frames_of_a_serial_line_over_tcp(
    free_port: int, drive: Callable[..., Any]
) -> None:
    wire = Wire()
    wire.unheard = bytes([9])
    channels = {
        "first": {"register": 5, "type": "uint16", "unit_id": 1},
        "second": {"register": 7, "type": "uint16", "unit_id": 2},
        "nobody": {"register": 7, "type": "uint16", "unit_id": 9},
    }
    source = at(free_port, framing="rtu", connect_pause_s=0.3, timeout_s=1.0)
    async with wire.served(free_port, FramerType.RTU), drive(source, channels) as record:
        await record.until(lambda: len(record.of("second")) >= 3)
        for name, value in (("first", 5.0), ("second", 7.0)):
            assert {one.value for one in record.of(name) if one.quality == GOOD} == {value}
        assert set(record.qualities("nobody")) == {int(Quality.COMM_FAILURE)}
    assert wire.frames[0][0] - wire.opened[0] >= 0.29
    # A silent unit is tried on the one connection: two would meet on the serial line.
    first_after = [next((at for at, _ in wire.frames if at > one), None) for one in wire.opened]
    assert all(
        at is None or at - one >= 0.29 for at, one in zip(first_after, wire.opened, strict=True)
    )


async def test_after_a_loss_a_slow_channel_is_read_at_once(
    free_port: int, drive: Callable[..., Any]
) -> None:
    channels = {
        "fast": {"register": 1, "type": "uint16"},
        "slow": {"register": 2, "type": "uint16", "poll_interval_s": 3600.0},
    }
    wire = Wire()
    async with drive(at(free_port), channels) as record:
        async with wire.served(free_port):
            await record.until(lambda: GOOD in record.qualities("slow"))
        await record.until(lambda: record.qualities("slow")[-1] == Quality.COMM_FAILURE)
        async with wire.served(free_port):
            await record.until(lambda: record.qualities("slow")[-1] == GOOD)
            await asyncio.sleep(0.2)
        assert record.qualities("slow").count(GOOD) == 2
