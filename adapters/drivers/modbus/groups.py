"""Which registers one request reads: cells that lie together, within the limits of the device."""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from adapters.drivers.modbus.config import BIT_KINDS, BITS_PER_REGISTER, Kind, ModbusSource

#: In place of the code of an exception: an answer that does not fit the request.
MISFIT = 0x100
REGISTER_GAP = 8  # unasked-for addresses that one request may bridge
BIT_GAP = 64


@dataclass(frozen=True, slots=True)
class RequestLimits:
    """What one request may ask of a device, and the unasked-for addresses it may read across."""

    registers: int
    bits: int
    register_gap: int
    bit_gap: int


def limits_of(source: ModbusSource) -> RequestLimits:
    """Return what a source's configuration allows one request."""
    most, gap = source.registers_per_read_max, source.register_gap_max
    return RequestLimits(
        most,
        most * BITS_PER_REGISTER,
        REGISTER_GAP if gap is None else gap,
        BIT_GAP if gap is None else gap,
    )


@dataclass(frozen=True, slots=True)
class RegisterCell:
    """One raw value on the wire: where it is and how its registers make a number."""

    kind: Kind
    address: int
    count: int  # registers or bits
    structure: str  # struct format; empty for bits, which become an integer (first bit lowest)
    swap_bytes: bool  # unpack from the registers packed little endian


@dataclass(slots=True)
class RawReading:
    """What the latest read of a cell gave: a number, the code of an exception, or `MISFIT`."""

    raw: float = math.nan
    exception: int = 0
    time_us: int = 0


@dataclass(slots=True)
class Group:
    """Cells of one unit and kind that are read with one request."""

    kind: Kind
    cells: list[tuple[RegisterCell, RawReading]]
    start: int = 0
    count: int = 0
    retry_at: float = 0.0  # wall (monotonic) time before which a refused read is not repeated
    _decode: list[tuple[RawReading, Callable[..., tuple[float, ...]], int]] = field(
        default_factory=list
    )
    _swaps: bool = False

    def __post_init__(self) -> None:
        self.start = min(cell.address for cell, _ in self.cells)
        self.count = max(cell.address + cell.count for cell, _ in self.cells) - self.start
        if self.kind not in BIT_KINDS:
            self._swaps = any(cell.swap_bytes for cell, _ in self.cells)
            self._decode = [
                (
                    reading,
                    struct.Struct(cell.structure).unpack_from,
                    2 * (cell.address - self.start + cell.swap_bytes * self.count),
                )
                for cell, reading in self.cells
            ]

    def store(self, values: Sequence[int | bool], time_us: int) -> None:
        """Decode the registers or bits of an answer into the cells' readings."""
        if self.kind in BIT_KINDS:
            for cell, reading in self.cells:
                first = cell.address - self.start
                reading.raw = sum(
                    1 << n for n, bit in enumerate(values[first : first + cell.count]) if bit
                )
                reading.exception = 0
                reading.time_us = time_us
            return
        data = struct.pack(f">{self.count}H", *values)
        if self._swaps:  # once more behind it, with the bytes of each register swapped
            data += struct.pack(f"<{self.count}H", *values)
        for reading, unpack_from, offset in self._decode:
            (reading.raw,) = unpack_from(data, offset)
            reading.exception = 0
            reading.time_us = time_us

    def fail(self, exception: int, time_us: int) -> None:
        """Note that the read gave no values, and why."""
        for _, reading in self.cells:
            reading.exception = exception
            reading.time_us = time_us

    def repeat(self, time_us: int) -> None:
        """Let the readings stand as of now, without a read."""
        for _, reading in self.cells:
            reading.time_us = time_us

    def halves(self) -> tuple["Group", "Group"] | None:
        """Split between two cells; None when there is nothing to split."""
        spans = sorted({(cell.address, cell.count) for cell, _ in self.cells})
        if len(spans) < 2:
            return None
        middle = spans[len(spans) // 2]
        low = [pair for pair in self.cells if (pair[0].address, pair[0].count) < middle]
        high = [pair for pair in self.cells if (pair[0].address, pair[0].count) >= middle]
        return Group(self.kind, low), Group(self.kind, high)


def group(cells: dict[RegisterCell, RawReading], limits: RequestLimits) -> list[Group]:
    """Join cells of the same kind that lie close together, within the limits of one request."""
    groups: list[Group] = []
    kinds: tuple[Kind, ...] = ("input", "holding", "coil", "discrete")
    for kind in kinds:
        bits = kind in BIT_KINDS
        most = limits.bits if bits else limits.registers
        gap = limits.bit_gap if bits else limits.register_gap
        run: list[tuple[RegisterCell, RawReading]] = []
        start = end = 0
        for cell, reading in sorted(
            ((c, r) for c, r in cells.items() if c.kind == kind), key=lambda pair: pair[0].address
        ):
            cell_end = cell.address + cell.count
            if run and (cell.address > end + gap or max(end, cell_end) - start > most):
                groups.append(Group(kind, run))
                run = []
            if not run:
                start = end = cell.address
            run.append((cell, reading))
            end = max(end, cell_end)
        if run:
            groups.append(Group(kind, run))
    return groups
