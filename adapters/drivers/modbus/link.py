"""One connection to a Modbus server or line: a read gives what was asked for or says why not."""

import asyncio
import logging
import struct
import termios
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any

from pymodbus import FramerType
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU

from adapters import AdapterError
from adapters.drivers.modbus.config import BIT_KINDS, Kind, ModbusRtuSource, ModbusSource
from adapters.drivers.modbus.groups import MISFIT
from adapters.drivers.modbus.serial_line import (
    AMBIGUOUS_BITS,
    DoubtError,
    OtherLengthError,
    Request,
    SerialLine,
    SilenceError,
    sealed,
)

# Whatever goes wrong comes back from here as an exception and is reported once, by the driver;
# pymodbus would log every single failed attempt as an error.
if logging.getLogger("pymodbus").level == logging.NOTSET:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

_FUNCTION_CODES: dict[Kind, int] = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
_BIT_FUNCTIONS = (1, 2)
_HEADER_SIZE = 7  # of a Modbus TCP frame, up to and with the unit
_LONGEST = 254  # unit and PDU
_SILENT_CHARACTERS = 3.5  # between two frames of a serial line
_CHARACTER_BITS = 11
_SILENCE_S = 0.002  # at any speed: what was heard must have come up to here


class NoAnswerError(AdapterError):
    """The unit did not answer in time, or a gateway says that it cannot reach it."""


class LinkLostError(AdapterError):
    """The connection broke, or carried something that is not Modbus."""


class DeviceRefusedError(AdapterError):
    """The device answered with an exception; `code` says which."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code:02X}")
        self.code = code
        self.busy = code in (5, 6)


class MisfitError(DeviceRefusedError):
    """The unit answered with another function or length than it was asked for."""

    def __init__(self) -> None:
        super().__init__(MISFIT)
        self.args = ("the answer does not fit the request",)


class WriteRefusedError(AdapterError):
    """Something asked for a request that is no read."""


class _ReadOnly:
    """In front of a pymodbus client: requests that are no reads end here."""

    def execute(self, no_response_expected: bool, request: ModbusPDU) -> Any:
        if request.function_code not in _FUNCTION_CODES.values():
            raise WriteRefusedError(f"function code {request.function_code} is no read")
        return super().execute(no_response_expected, request)  # type: ignore[misc]


class _TcpClient(_ReadOnly, AsyncModbusTcpClient):
    pass


class _SerialClient(_ReadOnly, AsyncModbusSerialClient):
    pass


def _hear(line: SerialLine, data: bytes, addr: tuple[Any, ...] | None = None) -> int:
    """Hand all that came to the line; gives how much of it is done with."""
    line.hear(data)
    return len(data)


class Link:
    """A connection that is thrown away after every doubt.

    A late reply must never be taken for the answer to a newer request, so a time-out or a foreign
    frame drops the connection; the next `connect` starts with a new client. Where frames have no
    transaction number, `SerialLine` keeps answers apart over all connections. Nothing can be
    written over it: the clients refuse every request that is no read.
    """

    def __init__(self, source: ModbusSource) -> None:
        self.source = source
        self.timeout_s = source.timeout_s
        self._client: _TcpClient | _SerialClient | None = None
        self._reads: dict[Kind, Callable[..., Awaitable[ModbusPDU]]] = {}
        self._waiting = False
        self._garbage = False
        self._is_odd = False  # registers of a length that no number of them has
        self._free_at = 0.0  # wall (monotonic) time from which the next request may go out
        self._line: SerialLine | None = None
        if isinstance(source, ModbusRtuSource):
            silence_s = _SILENT_CHARACTERS * _CHARACTER_BITS / source.baudrate
            self._line = SerialLine(source.timeout_s, max(silence_s, _SILENCE_S))
        elif source.framing == "rtu":
            self._line = SerialLine(source.timeout_s, _SILENCE_S)

    @property
    def connected(self) -> bool:
        """Whether the connection stands, as far as is known."""
        return self._client is not None and self._client.connected

    async def connect(self) -> bool:
        """Connect again; returns whether it worked."""
        self.drop()
        client = self._new_client()
        self._client = client
        self._reads = {
            "coil": client.read_coils,
            "discrete": client.read_discrete_inputs,
            "holding": client.read_holding_registers,
            "input": client.read_input_registers,
        }
        try:
            connected = bool(await client.connect())
            if connected and self.source.connect_pause_s:
                await asyncio.sleep(self.source.connect_pause_s)
            return connected and self.connected
        except asyncio.CancelledError:
            self.drop()
            raise
        except (OSError, termios.error):
            # A port that does not take these settings, or went away while it was opened.
            self.drop()
            return False

    def _new_client(self) -> _TcpClient | _SerialClient:
        source = self.source
        client: _TcpClient | _SerialClient
        if isinstance(source, ModbusRtuSource):
            client = _SerialClient(
                source.device,
                baudrate=source.baudrate,
                bytesize=source.bytesize,
                parity=source.parity,
                stopbits=source.stopbits,
                timeout=source.timeout_s,
                retries=0,
                reconnect_delay=0,
                trace_connect=self._connection_changed,
            )
        else:
            client = _TcpClient(
                source.host,
                port=source.port,
                timeout=source.timeout_s,
                retries=0,
                reconnect_delay=0,
                framer=FramerType.RTU if source.framing == "rtu" else FramerType.SOCKET,
                trace_packet=None if source.framing == "rtu" else self._inspect,
                trace_connect=self._connection_changed,
            )
        if self._line is not None:
            # What comes is for the line alone: pymodbus takes any sound frame for an answer.
            client.ctx.callback_data = partial(_hear, self._line)  # type: ignore[method-assign]
        return client

    def drop(self) -> None:
        """Close the connection, if any, without waiting."""
        self._fail(ConnectionException("closed"))
        client, self._client = self._client, None
        self._garbage = False
        if client is not None:
            client.close()

    async def read(self, kind: Kind, unit: int, address: int, count: int) -> Sequence[int | bool]:
        """Read registers or bits.

        Raises `NoAnswerError`: no answer in time, or exception 0A or 0B; `LinkLostError`: the
        connection broke and was dropped; `DeviceRefusedError`: any other exception response;
        `MisfitError`: another length or function, and if the answer may be one to an earlier
        request, the connection was dropped.
        """
        if self._client is None:
            raise LinkLostError("not connected")
        if self._line is not None and kind in BIT_KINDS and count in AMBIGUOUS_BITS:
            most = AMBIGUOUS_BITS.start - 1
            first = await self.read(kind, unit, address, most)
            return [*first, *await self.read(kind, unit, address + most, count - most)]
        if (wait_s := self._free_at - time.monotonic()) > 0.0:
            await asyncio.sleep(wait_s)
        self._waiting, self._is_odd = True, False
        try:
            if self._line is None:
                response = await self._reads[kind](address, count=count, device_id=unit)
            else:
                response = await self._ask_line(
                    self._client, self._line, _FUNCTION_CODES[kind], unit, address, count
                )
        except asyncio.CancelledError:
            self.drop()
            raise
        except ConnectionException as error:
            self.drop()
            raise LinkLostError("connection lost") from error
        except ModbusIOException as error:
            garbage = self._garbage
            self.drop()
            if garbage:
                raise LinkLostError("answer is not Modbus") from error
            raise NoAnswerError(f"no answer within {self.timeout_s:g} s") from error
        except OtherLengthError as error:
            self.drop()
            raise MisfitError from error
        except SilenceError as error:
            self.drop()
            raise NoAnswerError(str(error)) from error
        except (DoubtError, ConnectionError, ModbusException) as error:
            self.drop()
            raise LinkLostError(str(error)) from error
        finally:
            self._waiting = False
            if self.source.request_gap_s:
                self._free_at = time.monotonic() + self.source.request_gap_s
        if response.isError():
            code = int(response.exception_code)
            if code in (0x0A, 0x0B):
                raise NoAnswerError(f"gateway cannot reach it (exception {code:02X})")
            raise DeviceRefusedError(code)
        function = _FUNCTION_CODES[kind]
        values: Sequence[int | bool]
        if function in _BIT_FUNCTIONS:
            values, size = response.bits, -(-count // 8) * 8
            # Some devices send whole words; only a transaction number says whose they are.
            fits = len(values) == size or (len(values) > size and response.transaction_id)
        else:
            values = response.registers
            fits = len(values) == count and not self._is_odd
        if response.function_code != function or not fits:
            if not response.transaction_id:  # simple devices do not return it
                self.drop()
            raise MisfitError
        return values[:count]

    @staticmethod
    async def _ask_line(
        client: _TcpClient | _SerialClient,
        line: SerialLine,
        function: int,
        unit: int,
        address: int,
        count: int,
    ) -> ModbusPDU:
        """Read over a line whose frames have no transaction number."""
        body = struct.pack(">BBHH", unit, function, address, count)
        frame = await line.exchange(Request(sealed(body), count), client.ctx.send)
        response = client.ctx.framer.decoder.decode(frame[1:-2])
        if response is None:
            raise LinkLostError("answer is not Modbus")
        return response

    def _inspect(self, sending: bool, data: bytes) -> bytes:
        """Keep frames from pymodbus whose lengths lie; they would raise inside the event loop."""
        if sending or len(data) < _HEADER_SIZE + 2:
            return data
        length = int.from_bytes(data[4:6], "big")
        function = data[7]
        if data[2:4] != b"\x00\x00" or not 2 <= length <= _LONGEST:
            sound = False
        elif function & 0x80:
            sound = length <= 3  # 2 by a counting error that some devices have
        else:
            sound = function in _FUNCTION_CODES.values() and data[8] == length - 3
            self._is_odd = function not in _BIT_FUNCTIONS and data[8] % 2 == 1
        if sound:
            return data
        self._garbage = True
        self._fail(ModbusIOException("lengths do not fit"))
        return b""

    def _connection_changed(self, connected: bool) -> None:
        if not connected:
            if self._line is not None:
                self._line.lose()
            self._fail(ConnectionException("connection lost"))

    def _fail(self, error: ModbusException) -> None:
        """End the wait for an answer at once; pymodbus would wait out its time."""
        if self._waiting and self._client is not None and self._line is None:
            future = self._client.ctx.response_future
            if not future.done():
                future.set_exception(error)
