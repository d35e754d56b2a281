"""CAN side of the virtual bench: a LAWICEL (slcan) adapter on a TCP port.

Every client is an adapter of its own on the same bus, so several may listen at once. The frames are
described by the packaged ``bench.dbc``.
"""

import asyncio
import logging
import math
import socket
from pathlib import Path
from typing import cast

import cantools
from cantools.database.can import Database, Signal

from adapters.virtual_bench.live import LiveBench
from adapters.virtual_bench.modbus_server import check_port

_LOGGER = logging.getLogger(__name__)
_OK = b"\r"
_BELL = b"\a"
_MAX_COMMAND = 128  # the longest slcan command is far shorter
_MAX_UNSENT = 64 * 1024  # about 2900 frames
_BITRATES = frozenset("0123456789")


def dbc_path() -> Path:
    """Path of the DBC file that describes the frames of the bench."""
    return Path(__file__).with_name("bench.dbc")


class _SlcanAdapter(asyncio.Protocol):
    """One client: understands the ASCII commands, is given frames while its channel is open."""

    def __init__(self, clients: "set[_SlcanAdapter]") -> None:
        self._clients = clients
        self._transport: asyncio.Transport | None = None
        self._pending = b""
        self.open = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        # stale frames must not pile up in the kernel for a client that does not read
        connection = transport.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MAX_UNSENT)
        self._clients.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._clients.discard(self)
        self.open = False
        self._transport = None

    def data_received(self, data: bytes) -> None:
        *commands, self._pending = (self._pending + data).split(b"\r")
        answer = b"".join(self._answer(command.decode("ascii", "replace")) for command in commands)
        if len(self._pending) > _MAX_COMMAND:
            self._pending = b""
            answer += _BELL
        self.send(answer)

    def _answer(self, command: str) -> bytes:
        match command[:1]:
            case "":
                return _OK
            case "O" | "L":
                if self.open:
                    return _BELL
                self.open = True
                return _OK
            case "C":
                self.open = False
                return _OK
            case "S" if command[1:] in _BITRATES and not self.open:
                return _OK
            case "s" | "M" | "m" | "W" | "Q" | "X" | "Z" | "Y":
                return _OK  # bit timing, filters, time stamps: accepted, without effect here
            case "V":
                return b"V1013\r"
            case "v":
                return b"v0100\r"
            case "N":
                return b"NBT01\r"
            case "F":
                return b"F00\r" if self.open else _BELL
            case "t" | "r" if self.open:
                return b"z\r"
            case "T" | "R" if self.open:
                return b"Z\r"
        return _BELL

    def send(self, data: bytes) -> None:
        """Write, or drop the client when it does not keep up."""
        if self._transport is None or not data:
            return
        if self._transport.get_write_buffer_size() > _MAX_UNSENT:
            _LOGGER.warning(
                "CAN client %s does not read: dropped", self._transport.get_extra_info("peername")
            )
            self.abort()
            return
        self._transport.write(data)

    def abort(self) -> None:
        """Cut the connection."""
        if self._transport is not None:
            self._transport.abort()


class BenchCanSender:
    """Sends the CAN frames of a bench to everybody whose channel is open."""

    def __init__(self, bench: LiveBench) -> None:
        self._bench = bench
        database = cast(Database, cantools.database.load_file(dbc_path()))
        self._drive = database.get_message_by_name("DriveStatus")
        self._load_cell = database.get_message_by_name("LoadCell")
        self._clients: set[_SlcanAdapter] = set()
        self._server: asyncio.Server | None = None
        self._counter = 0

    async def start(self, host: str, port: int) -> tuple[str, int]:
        """Listen; port 0 takes a free one. Raises `PortInUseError`."""
        address = check_port("can port", host, port)
        self._server = await asyncio.get_running_loop().create_server(
            lambda: _SlcanAdapter(self._clients), address, port
        )
        return address, int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close the port and every connection."""
        if self._server is None:
            return
        self._server.close()
        for client in tuple(self._clients):
            client.abort()
        await self._server.wait_closed()
        self._server = None

    def send_frames(self) -> None:
        """Send one DriveStatus and one LoadCell frame of the present moment."""
        listeners = [client for client in self._clients if client.open]
        if not listeners:
            return
        counter = self._counter = (self._counter + 1) % 256
        state = int(self._bench.controller_state().run_state)
        drive = {
            "Speed": _raw(self._drive.get_signal_by_name("Speed"), self._bench.speed_rpm()),
            "State": state,
            "Counter": counter,
        }
        load = {
            "RadialLoad": _raw(
                self._load_cell.get_signal_by_name("RadialLoad"), self._bench.load_n()
            ),
            "Counter": counter,
        }
        frames = b""
        for message, raw in ((self._drive, drive), (self._load_cell, load)):
            data = message.encode(raw, scaling=False, padding=True, strict=False)
            frames += f"t{message.frame_id:03X}{len(data)}{data.hex().upper()}\r".encode()
        for client in listeners:
            client.send(frames)


def _raw(signal: Signal, value: float | None) -> int:
    """Raw signal value; all ones, "not available", for a broken sensor."""
    if value is None:
        return (1 << int(signal.length)) - 1
    largest = float(signal.maximum or math.inf)
    return round(min(value, largest) / float(signal.scale))
