"""Modbus TCP side of a fleet of benches: one unit per bench, some hundred units per port."""

import asyncio
import socket
import struct
from collections.abc import Callable
from functools import partial
from typing import cast

from adapters.virtual_bench.fleet import REGISTERS, BenchFleet
from adapters.virtual_bench.modbus_server import PortInUseError, check_port

#: Units behind one port: those that Modbus knows, 1 to 247.
UNITS = 247
#: Where a unit's answers are counted, two registers, high word first.
COUNTER_ADDRESS = 10

_READ_INPUT = 4
_HEADER = struct.Struct(">HHHB")
_REQUEST = struct.Struct(">BHH")
_LONGEST = 254
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_COUNT, _NO_RESPONSE = 1, 2, 3, 0x0B


class FleetModbusServer:
    """Serves benches over Modbus TCP: number n is unit ``n % units + 1`` of port ``n // units``.

    All registers of one answer belong to one moment: `now_s`, process time since the start.
    """

    def __init__(self, fleet: BenchFleet, now_s: Callable[[], float], units: int = UNITS) -> None:
        self.units = units
        self._fleet = fleet
        self._now_s = now_s
        self._answers = [0] * fleet.size
        self._servers: list[asyncio.Server] = []
        self._open: set[asyncio.Transport] = set()

    async def start(self, host: str, port: int) -> list[tuple[str, int]]:
        """Listen on as many ports as the benches need, from `port` on; 0 takes free ones.

        Raises `PortInUseError`.
        """
        loop = asyncio.get_running_loop()
        found = []
        for number, first in enumerate(range(0, self._fleet.size, self.units)):
            wanted = port + number if port else 0
            address = check_port("modbus port", host, wanted)
            try:
                server = await loop.create_server(
                    partial(_Connection, self, first), address, wanted
                )
            except OSError as error:  # taken since the check
                raise PortInUseError(f"modbus port {host}:{wanted}: cannot listen") from error
            self._servers.append(server)
            found.append((address, int(server.sockets[0].getsockname()[1])))
        return found

    async def stop(self) -> None:
        """Close the ports and every connection."""
        for server in self._servers:
            server.close()
        for transport in list(self._open):
            transport.abort()
        for server in self._servers:
            await server.wait_closed()
        self._servers = []

    def answer(self, bench: int, function: int, address: int, count: int) -> bytes:
        """Give the answer to one request, without its header."""
        if bench >= self._fleet.size:
            return bytes((function | 0x80, _NO_RESPONSE))
        if function != _READ_INPUT:
            return bytes((function | 0x80, _ILLEGAL_FUNCTION))
        if not 1 <= count <= 125:
            return bytes((function | 0x80, _ILLEGAL_COUNT))
        end = address + count
        if end <= REGISTERS:
            self._fleet.advance(self._now_s())
            self._answers[bench] += 1
            data = self._fleet.row(bench)[2 * address : 2 * end]
        elif address >= COUNTER_ADDRESS and end <= COUNTER_ADDRESS + 2:
            counter = struct.pack(">I", self._answers[bench] & 0xFFFFFFFF)
            data = counter[2 * (address - COUNTER_ADDRESS) : 2 * (end - COUNTER_ADDRESS)]
        else:
            return bytes((function | 0x80, _ILLEGAL_ADDRESS))
        return bytes((function, len(data))) + data


class _Connection(asyncio.Protocol):
    """One client of one port."""

    def __init__(self, server: FleetModbusServer, first: int) -> None:
        self._server = server
        self._first = first
        self._received = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.get_extra_info("socket").setsockopt(
            socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
        )
        self._server._open.add(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._server._open.discard(self._transport)

    def data_received(self, data: bytes) -> None:
        assert self._transport is not None  # noqa: S101
        self._received += data
        while len(self._received) >= _HEADER.size:
            number, protocol, length, unit = _HEADER.unpack_from(self._received)
            if protocol != 0 or not 2 <= length <= _LONGEST:
                self._transport.abort()  # not Modbus: nothing that follows can be read
                return
            if len(self._received) < 6 + length:
                return
            request, self._received = self._received[7 : 6 + length], self._received[6 + length :]
            body = self._answer(unit, request)
            self._transport.write(_HEADER.pack(number, 0, len(body) + 1, unit) + body)

    def _answer(self, unit: int, request: bytes) -> bytes:
        if not 1 <= unit <= self._server.units:
            return bytes((request[0] | 0x80, _NO_RESPONSE))
        if len(request) < _REQUEST.size:
            return bytes((request[0] | 0x80, _ILLEGAL_FUNCTION))
        return self._server.answer(self._first + unit - 1, *_REQUEST.unpack_from(request))
