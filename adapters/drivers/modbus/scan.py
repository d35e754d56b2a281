"""What a Modbus device answers, before anybody knows its registers; nothing is ever written."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

from adapters.drivers.modbus.config import Kind, ModbusChannel, ModbusSource, Order, ValueType
from adapters.drivers.modbus.groups import Group, RawReading, RegisterCell
from adapters.drivers.modbus.link import DeviceRefusedError, Link, LinkLostError, NoAnswerError
from adapters.drivers.modbus.mapping import value_cell

#: Byte order of a value of two registers as data sheets write it: word order, byte order.
ORDERS: Final[Mapping[str, tuple[Order, Order]]] = {
    "ABCD": ("big", "big"),
    "CDAB": ("little", "big"),
    "BADC": ("big", "little"),
    "DCBA": ("little", "little"),
}
SHORT_TYPES: Final[tuple[ValueType, ...]] = ("int16", "uint16")
LONG_TYPES: Final[tuple[ValueType, ...]] = ("float32", "int32", "uint32")
REGISTER_KINDS: Final[tuple[Kind, ...]] = ("holding", "input")
_NO_SUCH_ADDRESS = (2, 3)  # exceptions: illegal data address, illegal data value
#: Exceptions of a unit that is there: these, illegal function, and busy. Gateways and servers say
#: 04, device failure, for units that they do not know.
_IS_THERE = (1, *_NO_SUCH_ADDRESS, 5, 6)


@dataclass(frozen=True, slots=True)
class UnitAnswer:
    """Whether a unit answers; ``detail`` says how, or why not."""

    unit: int
    answers: bool
    detail: str


@dataclass(frozen=True, slots=True)
class RegisterValue:
    """One register, read in every way."""

    register: int  # its address on the wire
    word: int | None  # its 16 bits; None where the device has no such register
    #: By type, ``int16`` and ``uint16``; with the next register ``float32``, ``int32`` and
    #: ``uint32`` in each order, as ``float32 CDAB``. NaN where the bits are no number.
    values: Mapping[str, float]


async def scan_units(source: ModbusSource, units: Sequence[int]) -> list[UnitAnswer]:
    """Ask units one by one for their first register.

    The ``timeout_s`` of the source is given to each unit. Raises `LinkLostError` if there is no
    connection to be had.
    """
    link = Link(source)
    try:
        return [await _ask(link, unit) for unit in units]
    finally:
        link.drop()


async def read_registers(
    source: ModbusSource, unit: int, kind: Kind, first: int, count: int
) -> list[RegisterValue]:
    """Read neighbouring registers, and show each in every type and order.

    Raises `LinkLostError` or `NoAnswerError` if the unit does not answer; `DeviceRefusedError` if
    it refuses for another reason than that there is no such register.
    """
    link = Link(source)
    try:
        await _connect(link)
        words = await _words(link, unit, kind, first, count)
    finally:
        link.drop()
    return in_every_way(kind, first, words)


def in_every_way(kind: Kind, first: int, words: Sequence[int | None]) -> list[RegisterValue]:
    """Show registers in every type and order, decoded as the driver decodes a channel.

    ``words``: their 16 bits each; None for one that is not there.
    """
    found = []
    for number, word in enumerate(words):
        following = words[number + 1] if number + 1 < len(words) else None
        values: dict[str, float] = {}
        if word is not None:
            values |= {name: _decoded(kind, (word,), name) for name in SHORT_TYPES}
        if word is not None and following is not None:
            values |= {
                f"{name} {order}": _decoded(kind, (word, following), name, order)
                for name, order in product(LONG_TYPES, ORDERS)
            }
        found.append(RegisterValue(first + number, word, values))
    return found


def _decoded(kind: Kind, words: Sequence[int], name: ValueType, order: str = "ABCD") -> float:
    word_order, byte_order = ORDERS[order]
    config = ModbusChannel(
        source="scan",
        register=0,
        kind=kind,
        type=name,
        word_order=word_order,
        byte_order=byte_order,
    )
    cell: RegisterCell = value_cell(config)
    reading = RawReading()
    Group(kind, [(cell, reading)]).store(words, 0)
    return reading.raw if math.isfinite(reading.raw) else math.nan


async def _connect(link: Link) -> None:
    if not link.connected and not await link.connect():
        raise LinkLostError(f"no connection to {link.source.where}")


async def _ask(link: Link, unit: int) -> UnitAnswer:
    detail = ""
    for kind in REGISTER_KINDS:
        await _connect(link)  # also after a silent unit, which costs the connection
        try:
            await link.read(kind, unit, 0, 1)
        except DeviceRefusedError as error:
            if error.code not in _IS_THERE:
                return UnitAnswer(unit, False, f"refuses with {error}; perhaps no such unit")
            detail = f"answers; has no {kind} register 0 ({error})"
        except (NoAnswerError, LinkLostError) as error:
            return UnitAnswer(unit, False, str(error))
        else:
            return UnitAnswer(unit, True, f"answers; has {kind} registers")
    return UnitAnswer(unit, True, detail)


async def _words(link: Link, unit: int, kind: Kind, first: int, count: int) -> list[int | None]:
    """Read a block; what the device refuses as a whole, half by half."""
    try:
        return [int(word) for word in await link.read(kind, unit, first, count)]
    except DeviceRefusedError as error:
        if error.code not in _NO_SUCH_ADDRESS:
            raise
    if count == 1:
        return [None]
    half = count // 2
    low = await _words(link, unit, kind, first, half)
    return low + await _words(link, unit, kind, first + half, count - half)
