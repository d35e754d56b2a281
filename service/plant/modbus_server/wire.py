"""Modbus TCP, reading only: there is no code here that could write anything.

The library of the Modbus driver has a server too, but one without a bound on connections and on
answers that no client takes, and with registers that every client may write unless it is held back.
"""

import asyncio
import contextlib
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import structlog

from service.live.guard import Guard
from service.security.sites import site_of

MOST_CONNECTIONS: Final = 32
#: Of one address (of one IPv6 network /64).
MOST_OF_ONE: Final = 8
#: A client that asks nothing for so long has gone.
IDLE_S: Final = 300.0
#: A request that has begun comes whole, and its answer is taken, within so long.
WHOLE_S: Final = 10.0
#: Between two requests of one client: none keeps this process from its other work.
PAUSE_S: Final = 0.002
_CLOSE_S: Final = 1.0
_UNTAKEN_BYTES: Final = 4096

_HEAD: Final = struct.Struct(">HHHB")
_LONGEST_PDU: Final = 253
_READ_COILS, _READ_DISCRETE, _READ_HOLDING, _READ_INPUT = 1, 2, 3, 4
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _DEVICE_FAILURE = 1, 2, 3, 4
_MOST_BITS, _MOST_REGISTERS = 2000, 125

_log = structlog.get_logger(__name__)

Registers = Callable[[int, int], Sequence[int] | None]
Bits = Callable[[int, int], Sequence[bool] | None]


@dataclass(eq=False)
class _Connection:
    site: str
    writer: asyncio.StreamWriter
    asked_s: float = field(default_factory=time.monotonic)


class ReadingServer:
    """Answers the function codes 1 to 4, for every unit; all others with "illegal function".

    - ``registers``: gives registers from an address on, as many as asked for; None beyond their
      end.
    - ``bits``: the same for bits.
    """

    def __init__(self, registers: Registers, bits: Bits) -> None:
        self._registers = registers
        self._bits = bits
        self._guard = Guard("modbus_server_request", "")
        self._connections: dict[asyncio.Task[None], _Connection] = {}
        self._server: asyncio.Server | None = None

    async def listen(self, host: str, port: int) -> None:
        """Listen. Raises `OSError` if the address cannot be had."""
        self._server = await asyncio.start_server(self._accept, host, port, limit=_LONGEST_PDU + 7)

    async def close(self) -> None:
        """End all connections, and listen no more."""
        if self._server is not None:
            self._server.close()
            self._server = None
        tasks = list(self._connections)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=_CLOSE_S)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        peer = writer.get_extra_info("peername")
        if task is None or peer is None or self._server is None:
            writer.transport.abort()
            return
        connection = _Connection(site_of(peer[0]), writer)
        self._make_room(connection.site)
        self._connections[task] = connection
        writer.transport.set_write_buffer_limits(high=_UNTAKEN_BYTES)
        try:
            with contextlib.suppress(EOFError, OSError, TimeoutError, asyncio.CancelledError):
                await self._serve(reader, connection)
        finally:
            self._connections.pop(task, None)
            writer.transport.abort()

    def _make_room(self, site: str) -> None:
        """Give up the connection that is silent for longest: a PLC that comes back gets in.

        It is one of the same address where that has too many, else one of the address with most.
        """
        by_site: dict[str, list[_Connection]] = {}
        for connection in self._connections.values():
            by_site.setdefault(connection.site, []).append(connection)
        crowd = by_site.get(site, [])
        if len(crowd) < MOST_OF_ONE:
            if len(self._connections) < MOST_CONNECTIONS:
                return
            crowd = max(by_site.values(), key=len)
        silent = min(crowd, key=lambda one: one.asked_s)
        _log.info("modbus_server_closed", peer=silent.site, reason="too many connections")
        for task, one in list(self._connections.items()):
            if one is silent:
                del self._connections[task]
                task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, connection: _Connection) -> None:
        while True:
            async with asyncio.timeout(IDLE_S):
                first = await reader.readexactly(1)
            async with asyncio.timeout(WHOLE_S):
                head = first + await reader.readexactly(_HEAD.size - 1)
                transaction, protocol, length, unit = _HEAD.unpack(head)
                if protocol != 0 or not 2 <= length <= _LONGEST_PDU + 1:
                    return  # not Modbus: nothing that follows can be understood
                request = await reader.readexactly(length - 1)
                connection.asked_s = time.monotonic()
                answer = self.answer(request)
                connection.writer.write(_HEAD.pack(transaction, 0, len(answer) + 1, unit) + answer)
                await connection.writer.drain()
            await asyncio.sleep(PAUSE_S)

    def answer(self, request: bytes) -> bytes:
        """Give the answer to a request, both without their head (function code first)."""
        function = request[0]
        error = _DEVICE_FAILURE
        with self._guard():
            answered = self._read(function, request)
            if isinstance(answered, bytes):
                return bytes((function, len(answered))) + answered
            error = answered
        return bytes((function | 0x80, error))

    def _read(self, function: int, request: bytes) -> bytes | int:
        """The data of an answer, or the code of an error."""
        if function not in (_READ_COILS, _READ_DISCRETE, _READ_HOLDING, _READ_INPUT):
            return _ILLEGAL_FUNCTION
        if len(request) != 5:
            return _ILLEGAL_VALUE
        _, first, count = struct.unpack(">BHH", request)
        of_bits = function in (_READ_COILS, _READ_DISCRETE)
        if not 1 <= count <= (_MOST_BITS if of_bits else _MOST_REGISTERS):
            return _ILLEGAL_VALUE
        if of_bits:
            bits = self._bits(first, count)
            return _ILLEGAL_ADDRESS if bits is None else _packed(bits)
        words = self._registers(first, count)
        return _ILLEGAL_ADDRESS if words is None else struct.pack(f">{count}H", *words)


def _packed(bits: Sequence[bool]) -> bytes:
    """Eight bits in a byte, the first one lowest."""
    packed = bytearray((len(bits) + 7) // 8)
    for number, bit in enumerate(bits):
        packed[number // 8] |= bit << number % 8
    return bytes(packed)
