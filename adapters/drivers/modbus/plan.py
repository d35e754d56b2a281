"""The controller's planned profile as rows of registers."""

import math
import struct
from collections.abc import AsyncGenerator, Sequence

from adapters import AdapterError
from adapters.drivers.modbus.config import PLAN_ROW_REGISTERS, ModbusPlan, Order
from adapters.drivers.modbus.link import Link
from adapters.samples import PlanStep

# A word-swapped or foreign table shows itself in numbers that no bearing ever meets.
LONGEST_STEP_S = 366 * 86400
FASTEST_RPM = 1e6
HEAVIEST_N = 1e8


class ImplausiblePlanError(AdapterError, ValueError):
    """The table does not hold a plan."""


def decode_plan(registers: Sequence[int], word_order: Order) -> tuple[PlanStep, ...]:
    """Decode rows of uint32 duration_s, float32 speed_rpm and float32 load_n.

    Six registers per row; ``word_order`` is "big" when the high word comes first. Unused rows, with
    a duration of zero, are left out. Raises `ImplausiblePlanError`: a used row holds a value that
    cannot be.
    """
    # packed little endian, low word first becomes plain little endian
    order = "<" if word_order == "little" else ">"
    rows = struct.iter_unpack(f"{order}Iff", struct.pack(f"{order}{len(registers)}H", *registers))
    steps = []
    for number, (duration_s, speed_rpm, load_n) in enumerate(rows):
        if not duration_s:
            continue
        plausible = (
            duration_s <= LONGEST_STEP_S
            and math.isfinite(speed_rpm)
            and abs(speed_rpm) <= FASTEST_RPM
            and math.isfinite(load_n)
            and 0.0 <= load_n <= HEAVIEST_N
        )
        if not plausible:
            raise ImplausiblePlanError(
                f"row {number}: duration_s {duration_s}, speed_rpm {speed_rpm:g}, load_n {load_n:g}"
            )
        steps.append(PlanStep(float(duration_s), speed_rpm, load_n))
    return tuple(steps)


async def read_rows(
    link: Link, unit: int, config: ModbusPlan, registers: list[int]
) -> AsyncGenerator[None]:
    """Put all rows to `registers`, stopping after each request.

    Raises `ImplausiblePlanError`: the table moved between two requests.
    """
    rows_per_read = link.source.registers_per_read_max // PLAN_ROW_REGISTERS
    most = rows_per_read * PLAN_ROW_REGISTERS
    while (left := config.rows * PLAN_ROW_REGISTERS - len(registers)) > 0:
        address = config.address + len(registers)
        registers += await link.read(config.kind, unit, address, min(left, most))
        yield
    if config.rows > rows_per_read:
        first = await link.read(config.kind, unit, config.address, PLAN_ROW_REGISTERS)
        if list(first[2:]) != registers[2:PLAN_ROW_REGISTERS]:
            raise ImplausiblePlanError("table: the step changed while it was read")
