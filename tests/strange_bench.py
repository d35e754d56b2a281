"""A bench that nobody configured yet: registers and a DBC file of its own, on real wires.

Modbus TCP with a unit 7 alone, whose registers are in the low word first, and a socketcand server
that sends CAN frames. Everybody who listens hears the same.
"""

import asyncio
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, cast

import cantools.database
from cantools.database.can import Database
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

UNIT = 7
#: Holding registers: outer ring as float32 in CDAB, inner ring in tenths as int16, ambient as
#: float32 in CDAB again. Around them there is nothing.
FIRST_REGISTER = 40
OUTER_C, INNER_C, AMBIENT_C = 41.25, 52.5, 23.75
SPEED_RPM, LOAD_N = 1500.0, 2650.0
EVERY_S = 0.05

DBC = """VERSION ""
NS_ :
BS_:
BU_: BENCH TWIN
BO_ 512 SpindleState: 8 BENCH
 SG_ ShaftRpm : 0|16@1+ (0.25,0) [0|16000] "rpm" TWIN
 SG_ RunHours : 16|16@1+ (1,0) [0|65000] "h" TWIN
BO_ 528 ForceCell: 8 BENCH
 SG_ RadialForce : 0|16@1+ (0.5,0) [0|32000] "N" TWIN
BO_ 544 Vibration: 8 BENCH
 SG_ Velocity : 0|16@1+ (0.01,0) [0|600] "mm/s" TWIN
"""


@dataclass(frozen=True)
class StrangeBench:
    """Where the bench is reached."""

    modbus_port: int
    can_port: int


def low_word_first(value: float) -> list[int]:
    """Registers of a float32 in the order CDAB."""
    high, low = struct.unpack(">2H", struct.pack(">f", value))
    return [low, high]


def registers() -> list[int]:
    """What unit 7 holds from `FIRST_REGISTER` on."""
    return [*low_word_first(OUTER_C), round(INNER_C * 10), *low_word_first(AMBIENT_C)]


@contextmanager
def running_strange_bench() -> Iterator[StrangeBench]:
    """Let the bench run in a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="strange bench")
    thread.start()

    def run(work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, loop).result(60)

    bench = _Bench()
    try:
        yield run(bench.start())
    finally:
        run(bench.stop())
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


class _Bench:
    def __init__(self) -> None:
        self._database = cast(Database, cantools.database.load_string(DBC))
        self._listeners: set[asyncio.StreamWriter] = set()

    async def start(self) -> StrangeBench:
        words = SimData(FIRST_REGISTER, values=registers(), datatype=DataType.REGISTERS)
        device = SimDevice(UNIT, simdata=[words])
        self._modbus = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await self._modbus.serve_forever(background=True)
        sockets = self._modbus.transport.sockets
        self._can = await asyncio.start_server(self._attend, "127.0.0.1", 0)
        self._sending = asyncio.create_task(self._send_on())
        return StrangeBench(sockets[0].getsockname()[1], self._can.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        self._sending.cancel()
        self._can.close()
        for writer in list(self._listeners):
            writer.close()
        await self._modbus.shutdown()

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Greet as socketcand does; then the frames come."""
        writer.write(b"< hi >")
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            for _ in ("open", "rawmode"):
                await reader.readuntil(b">")
                writer.write(b"< ok >")
            self._listeners.add(writer)
            await reader.read()
        self._listeners.discard(writer)
        writer.close()

    async def _send_on(self) -> None:
        spindle = self._frame("SpindleState", {"ShaftRpm": SPEED_RPM, "RunHours": 1234})
        force = self._frame("ForceCell", {"RadialForce": LOAD_N})
        while True:
            now = f"{time.time():.6f}"
            for writer in list(self._listeners):
                for number, data in (spindle, force):
                    writer.write(f"< frame {number:X} {now} {data} >".encode())
            await asyncio.sleep(EVERY_S)

    def _frame(self, name: str, values: dict[str, float]) -> tuple[int, str]:
        message = self._database.get_message_by_name(name)
        return message.frame_id, message.encode(values, padding=True).hex().upper()
