"""Opening and closing a CAN bus so that neither can hang or leak."""

import contextlib
import logging
import os
import re
import select
import socket
import time
from collections.abc import Iterator
from typing import Any

import can
import serial
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcand import SocketCanDaemonBus, socketcand
from serial.urlhandler import protocol_socket

from adapters.drivers.can.config import CanSource

logger = logging.getLogger(__name__)

PORT_TIMEOUT_S = 0.1  # of one wait for bytes; data ends it at once
WRITE_TIMEOUT_S = 1.0
#: Wall seconds for a connection, and for each answer when a bus is opened.
OPEN_TIMEOUT_S = 1.5
CHUNK_BYTES = 65536
LONGEST_MESSAGE = 1024  # far more than a frame takes
_ASCII_ONLY = bytes(range(128)) + b"?" * 128  # line noise must spoil its own line only

_END_OF_MESSAGE = re.compile(rb"[\r\a]")


def _connect(connection: socket.socket, host: str, port: int) -> None:
    connection.settimeout(OPEN_TIMEOUT_S)
    connection.connect((host, port))


# pyserial waits 5 s for a connection, python-can tries a refused one for 10 s without a pause;
# nothing may hold up a stop for so long.
protocol_socket.POLL_TIMEOUT = OPEN_TIMEOUT_S
socketcand.connect_to_server = _connect


class ChunkedPort:
    """A serial port that is read in chunks.

    python-can's slcan reads byte by byte, with two system calls for each, which limits it to some
    7000 frames per second and makes the thread wait for the interpreter lock dozens of times per
    frame. Read in chunks and message by message it does twenty times as much.
    """

    def __init__(self, port: Any) -> None:
        self._port = port
        self._descriptor: int = port.fileno()
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._chunk = b""
        self._position = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def read_piece(self) -> bytes:
        """Read to the end of a message, or what has come of it, waiting if there is nothing."""
        if self._position >= len(self._chunk):
            timeout_s = self._port.timeout
            if not self._poll.poll(None if timeout_s is None else 1e3 * timeout_s):
                return b""
            try:
                self._chunk = os.read(self._descriptor, CHUNK_BYTES).translate(_ASCII_ONLY)
            except BlockingIOError:  # the wait may end without need
                return b""
            self._position = 0
            if not self._chunk:
                raise serial.SerialException("the peer closed the connection")
        start = self._position
        end = _END_OF_MESSAGE.search(self._chunk, start)
        self._position = len(self._chunk) if end is None else end.end()
        return self._chunk[start : self._position]

    def reset_input_buffer(self) -> None:
        """Forget what has been received."""
        self._chunk = b""
        self._position = 0
        self._port.reset_input_buffer()


class SlcanBus(slcanBus):
    """python-can's slcan bus, read in chunks and closed for good whatever happens."""

    def __init__(self, channel: str, **options: Any) -> None:
        try:
            super().__init__(channel, **options)
            port: Any = self.serialPortOrig
            port.write_timeout = WRITE_TIMEOUT_S
            try:
                self.serialPortOrig = ChunkedPort(port)
            except (OSError, NotImplementedError):
                logger.debug("port %s has no descriptor, reading byte by byte", channel)
        except BaseException:
            with self._socket_closed():
                if hasattr(self, "serialPortOrig"):
                    self.serialPortOrig.close()
            raise

    def _read(self, timeout: float | None) -> str | None:
        port = self.serialPortOrig
        if not isinstance(port, ChunkedPort):
            return super()._read(timeout)
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            with error_check("Could not read from serial device"):
                self._buffer += port.read_piece()
            if len(self._buffer) > LONGEST_MESSAGE:
                self._buffer.clear()
                raise ValueError(f"no end of a message within {LONGEST_MESSAGE} bytes")
            if self._buffer.endswith((self._OK, self._ERROR)):
                message = self._buffer.decode()
                self._buffer.clear()
                return message
            if deadline is not None and time.monotonic() >= deadline:
                return None

    def shutdown(self) -> None:
        """Close the channel and the port, also when the other side is gone."""
        with self._socket_closed():
            try:
                super().shutdown()
            finally:
                self.serialPortOrig.close()

    @contextlib.contextmanager
    def _socket_closed(self) -> Iterator[None]:
        """Close the socket in the end: pyserial forgets it when the peer has gone first."""
        connection = getattr(getattr(self, "serialPortOrig", None), "_socket", None)
        try:
            yield
        finally:
            if connection is not None:
                connection.close()


class SocketcandBus(SocketCanDaemonBus):
    """python-can's socketcand bus, opened also where frames come right behind the last answer.

    python-can wants each answer alone in one packet: a busy bus is opened by chance only.
    """

    _SocketCanDaemonBus__socket: socket.socket

    def __init__(self, channel: str, **options: Any) -> None:
        try:
            super().__init__(channel, **options)  # type: ignore[no-untyped-call]
        except BaseException:
            if hasattr(self, "_SocketCanDaemonBus__socket"):
                self._SocketCanDaemonBus__socket.close()
            raise
        self._SocketCanDaemonBus__socket.settimeout(None)  # `recv` waits with `select`

    def _expect_msg(self, msg: str) -> None:
        answer = b""
        while not answer.endswith(b">") and len(answer) < LONGEST_MESSAGE:
            try:
                byte = self._SocketCanDaemonBus__socket.recv(1)  # what is behind it stays unread
            except TimeoutError:
                raise can.CanError(f"no {msg!r} within {OPEN_TIMEOUT_S:g} s") from None
            except ConnectionError:
                byte = b""
            if not byte:
                raise can.CanError(f"the server closed the connection instead of {msg!r}")
            answer += byte
        if answer.strip() != msg.encode():
            raise can.CanError(f"expected {msg!r}, got {answer.decode('ascii', 'replace')!r}")


def open_bus(source: CanSource) -> can.BusABC:
    """Open the source's bus; raises whatever the interface's library raises."""
    options = source.bus_options
    if source.interface == "slcan":
        channel = str(source.channel)
        options.setdefault("timeout", PORT_TIMEOUT_S)
        if channel.startswith("socket://"):
            options.setdefault("sleep_after_open", 0.0)  # meant for adapters that boot when opened
        return SlcanBus(channel, **options)
    if source.interface == "socketcand":
        return SocketcandBus(str(source.channel), **options)
    # can.conf files and CAN_* variables of the machine are none of our business
    return can.Bus(
        channel=source.channel, interface=source.interface, ignore_config=True, **options
    )


def close_bus(bus: can.BusABC) -> None:
    """Close a bus that may be broken."""
    try:
        bus.shutdown()
    except Exception as error:  # interfaces raise whatever their libraries raise; it is closed
        logger.debug("closing %s: %s", bus, error)
