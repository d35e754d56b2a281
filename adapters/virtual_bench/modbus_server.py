"""Modbus TCP side of the virtual bench: PT100 transmitters and bench controller.

Register map: docs/start/virtual-bench.md. Addresses are those on the wire, counted from 0.
"""

import asyncio
import socket
import struct
from collections.abc import Callable, Mapping
from typing import cast

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adapters.virtual_bench.controller import ControllerState
from adapters.virtual_bench.live import LiveBench, Transmitter
from adapters.virtual_bench.scenarios import BenchError
from adapters.virtual_bench.sensors import PT100_CHANNELS

TRANSMITTER_UNIT = 1
CONTROLLER_UNIT = 2
STATUS_ADDRESS = 10
PLAN_ADDRESS = 100
PLAN_ROWS = 16
BURN_OUT = -32768  # open or shorted element
OVER_RANGE = 32767
STATUS_BITS = {"wire break": 1 << 0, "short circuit": 1 << 1, "over-range": 1 << 2}

START_COIL = 0
HOLD_COIL = 1

_READ_HOLDING = 3
_READ_INPUT = 4
_WRITE_COIL = 5
_CONTROLLER_REGISTERS = 10
_PLAN_REGISTERS = 6 * PLAN_ROWS


class PortInUseError(BenchError):
    """A port cannot be listened on."""


def transmitter_registers(transmitters: Mapping[str, Transmitter]) -> tuple[list[int], list[int]]:
    """Values (int16, 0.1 degC) and status words of the PT100 transmitters as raw registers."""
    values, status = [], []
    for channel in PT100_CHANNELS:
        transmitter = transmitters[channel]
        if transmitter.fault is None:
            raw = round(transmitter.temperature_c * 10.0)
        else:
            raw = OVER_RANGE if transmitter.fault == "over-range" else BURN_OUT
        values.append(raw & 0xFFFF)
        status.append(STATUS_BITS[transmitter.fault] if transmitter.fault else 0)
    return values, status


def controller_registers(state: ControllerState) -> tuple[list[int], list[int]]:
    """Head (10 registers) and planned profile (96 registers) of the controller, big word order."""
    head = struct.pack(
        ">HHffII",
        state.phase,
        state.run_state,
        state.speed_setpoint_rpm,
        state.load_setpoint_n,
        state.seconds_left,
        state.elapsed_s,
    )
    rows = state.plan[:PLAN_ROWS]
    plan = b"".join(struct.pack(">Iff", row.duration_s, row.speed_rpm, row.load_n) for row in rows)
    plan = plan.ljust(2 * _PLAN_REGISTERS, b"\0")
    return list(struct.unpack(">10H", head)), list(struct.unpack(f">{_PLAN_REGISTERS}H", plan))


class BenchModbusServer:
    """Serves a bench over Modbus TCP.

    Every read first brings the bench to the present moment and then takes all registers from one
    snapshot, so no read sees halves of two plans.

    - ``start_scenario``: called when a client sets the controller's start coil; a second time
      changes nothing.
    """

    def __init__(
        self,
        bench: LiveBench,
        now_s: Callable[[], float],
        start_scenario: Callable[[], None],
    ) -> None:
        self._bench = bench
        self._now_s = now_s
        self._start_scenario = start_scenario
        self._server: ModbusTcpServer | None = None

    async def start(self, host: str, port: int) -> tuple[str, int]:
        """Listen; port 0 takes a free one. Raises `PortInUseError`."""
        address = check_port("modbus port", host, port)
        server = ModbusTcpServer(
            [self._transmitters(), self._controller(), self._others()], address=(address, port)
        )
        try:
            await server.serve_forever(background=True)
        except RuntimeError as error:  # taken since the check
            raise PortInUseError(f"modbus port {host}:{port}: cannot listen") from error
        self._server = server
        listener = cast(asyncio.Server, server.transport)
        return address, int(listener.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close the port and every connection."""
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None

    def _transmitters(self) -> SimDevice:
        async def refresh(
            function: int,
            _start: int,  # both blocks begin at address 0
            _address: int,
            _count: int,
            registers: list[int],
            _values: list[int] | list[bool] | None,
        ) -> ExcCodes | None:
            if function != _READ_INPUT:
                return ExcCodes.ILLEGAL_FUNCTION
            self._bench.advance(self._now_s())
            values, status = transmitter_registers(self._bench.transmitters())
            registers[: len(values)] = values
            registers[STATUS_ADDRESS : STATUS_ADDRESS + len(status)] = status
            return None

        count = len(PT100_CHANNELS)
        inputs = [
            SimData(0, values=[0] * count, datatype=DataType.REGISTERS),
            SimData(STATUS_ADDRESS, values=[0] * count, datatype=DataType.REGISTERS),
        ]
        return SimDevice(
            TRANSMITTER_UNIT, simdata=(*_no_bits(), _no_registers(), inputs), action=refresh
        )

    def _controller(self) -> SimDevice:
        async def refresh(
            function: int,
            _start: int,  # both blocks begin at address 0
            address: int,
            _count: int,
            registers: list[int],
            values: list[int] | list[bool] | None,
        ) -> ExcCodes | None:
            if function == _WRITE_COIL and address == START_COIL:
                if values and values[0]:
                    self._start_scenario()
                return None
            if function == _WRITE_COIL and address == HOLD_COIL:
                if values is not None:  # None: the library's own second call, after the write
                    self._bench.advance(self._now_s())
                    self._bench.hold = bool(values[0])
                return None
            if function != _READ_HOLDING:
                return ExcCodes.ILLEGAL_FUNCTION
            self._bench.advance(self._now_s())
            head, plan = controller_registers(self._bench.controller_state())
            registers[: len(head)] = head
            registers[PLAN_ADDRESS : PLAN_ADDRESS + len(plan)] = plan
            return None

        holding = [
            SimData(0, values=[0] * _CONTROLLER_REGISTERS, datatype=DataType.REGISTERS),
            SimData(PLAN_ADDRESS, values=[0] * _PLAN_REGISTERS, datatype=DataType.REGISTERS),
        ]
        return SimDevice(
            CONTROLLER_UNIT, simdata=(*_no_bits(), holding, _no_registers()), action=refresh
        )

    def _others(self) -> SimDevice:
        """Any other unit: no one answers behind the gateway."""

        async def refuse(*_arguments: object) -> ExcCodes:
            return ExcCodes.GATEWAY_NO_RESPONSE

        everything = [SimData(0, values=[0] * 65536, datatype=DataType.REGISTERS)]
        bits = [SimData(0, values=[False] * 65536, datatype=DataType.BITS)]
        return SimDevice(0, simdata=(bits, bits, everything, everything), action=refuse)


def _no_bits() -> tuple[list[SimData], list[SimData]]:
    """Coils and discrete inputs: the library wants some, the actions decide what may be done."""
    return (
        [SimData(0, values=[False] * 16, datatype=DataType.BITS)],
        [SimData(0, values=[False] * 16, datatype=DataType.BITS)],
    )


def _no_registers() -> list[SimData]:
    return [SimData(0, values=[0], datatype=DataType.REGISTERS)]


def check_port(what: str, host: str, port: int) -> str:
    """Numeric address of the host; raises `PortInUseError` if the port cannot be listened on."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen(1)
            return str(address[0])
    except OSError as error:
        reason = error.strerror or str(error)
        raise PortInUseError(f"{what} {host}:{port}: cannot listen: {reason}") from error
