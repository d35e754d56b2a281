"""Two units of a Modbus server whose faults a test sets."""

import asyncio
import math
import struct
import time
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice


class Device:
    """Two units of a pymodbus server whose faults can be set while it runs."""

    def __init__(self) -> None:
        self.exceptions: dict[tuple[int, int], ExcCodes] = {}  # (unit, address) -> answer
        self.delay_s: dict[int, float] = {}
        self.requests: list[tuple[int, int, int, int]] = []  # unit, function, address, count
        self.busy_with = 0
        self.most_at_once = 0

    def asked(self, number: int) -> int:
        """How many requests have come for a unit."""
        return sum(request[0] == number for request in self.requests)

    def unit(self, number: int) -> SimDevice:
        rows = [value for row in [(600, 4200.0, 2650.0), (1800, 6200.0, 5500.0)] for value in row]
        plan = struct.unpack(">12H", struct.pack(">IffIff", *rows))
        registers = [
            SimData(0, values=[215, 0x8000, 300], datatype=DataType.REGISTERS),
            SimData(3, values=[87.5, math.nan], datatype=DataType.FLOAT32),
            SimData(7, values=[0, 0], datatype=DataType.REGISTERS),
            SimData(40, values=[*plan, *([0] * 48)], datatype=DataType.REGISTERS),
        ]
        bits = [SimData(0, values=[True, False, True], datatype=DataType.BITS)]

        async def action(
            function: int, start: int, address: int, count: int, values: list[Any], _: Any
        ) -> ExcCodes | None:
            self.requests.append((number, function, address, count))
            self.busy_with += 1
            self.most_at_once = max(self.most_at_once, self.busy_with)
            try:
                ends_s = time.monotonic() + self.delay_s.get(number, 0.0)
                while number in self.delay_s and time.monotonic() < ends_s:  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
            finally:
                self.busy_with -= 1
            for (unit, wrong), answer in self.exceptions.items():
                if unit == number and address <= wrong < address + count:
                    return answer
            return None

        return SimDevice(number, simdata=(bits, bits, registers, registers), action=action)
