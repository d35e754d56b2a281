"""From the configured channels to reads at their intervals, and from raw registers to samples."""

import logging
import math
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite

from adapters.backoff import Backoff
from adapters.configuration import ConfigurationError
from adapters.drivers.modbus.config import (
    BIT_KINDS,
    PLAN_ROW_REGISTERS,
    ModbusChannel,
    ModbusPlan,
    ModbusSource,
    data_sheet_hint,
)
from adapters.drivers.modbus.groups import (
    MISFIT,
    Group,
    RawReading,
    RegisterCell,
    RequestLimits,
    group,
    limits_of,
)
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.pt100 import fault, temperature_from_resistance
from adapters.samples import Quality

logger = logging.getLogger(__name__)

ADDRESSES = 65536
# Wall seconds until a group that was split is tried whole again: some devices refuse only while
# they start, others always.
JOIN_FIRST_S = 30.0
JOIN_LAST_S = 3600.0

_GOOD = int(Quality.GOOD)  # a look into the enumeration takes longer
_FORMATS = {
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
_WORDS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "float64": 4}


@dataclass(slots=True)
class PolledChannel:
    """A channel, compiled for decoding."""

    asset: str
    channel: str
    config: ModbusChannel
    unit: int
    reading: RawReading
    status: RawReading | None
    sentinels: frozenset[float]
    status_bits: tuple[tuple[int, str], ...]
    age_limit_us: float
    # Of the configuration; a look at its model takes longer.
    scale: float = field(init=False)
    offset: float = field(init=False)
    is_resistance: bool = field(init=False)
    valid_range: tuple[float, float] | None = field(init=False)
    last_time_us: int = 0
    last_good: float = math.nan
    last_good_us: int = 0
    problem: str = ""
    quiet_until: float = 0.0  # wall (monotonic) time before which no further line is logged

    def __post_init__(self) -> None:
        self.scale = self.config.scale
        self.offset = self.config.offset
        self.is_resistance = self.config.conversion == "pt100_ohm"
        self.valid_range = self.config.valid_range

    @property
    def refusal(self) -> int:
        """Why the device gave no value or no status: the code of an exception, `MISFIT`, or 0."""
        return self.reading.exception or (self.status.exception if self.status else 0)

    @property
    def label(self) -> str:
        """The channel's full name for messages."""
        return f"{self.asset}/{self.channel}"

    def evaluate(self, time_us: int) -> tuple[float, int, str, str]:
        """Turn the latest readings into a value.

        Returns value (NaN when bad), quality, kind of error for counting and a reason for people
        (both empty when good). Never good unless the device said so in every respect.
        """
        if self.reading.exception:
            return self._refused(self.reading.exception, time_us)
        if self.status is not None:
            if self.status.exception:
                return self._refused(self.status.exception, time_us)
            word = int(self.status.raw)
            set_bits = [name for bit, name in self.status_bits if word >> bit & 1]
            if set_bits:
                return self._bad(Quality.SENSOR_FAILURE, "status", "status: " + ", ".join(set_bits))
        raw = self.reading.raw
        if raw in self.sentinels:
            return self._bad(Quality.SENSOR_FAILURE, "sentinel", f"no value (sentinel {raw:g})")
        value = raw * self.scale + self.offset
        if not isfinite(value):
            return self._bad(Quality.SENSOR_FAILURE, "not_a_number", "not a number")
        if self.is_resistance:
            broken = fault(value)
            if broken:
                return self._bad(Quality.SENSOR_FAILURE, "pt100", broken)
            value = temperature_from_resistance(value)
        if self.valid_range is not None:
            low, high = self.valid_range
            if not low <= value <= high:
                self.last_good_us = 0
                reason = f"outside the valid range {[low, high]}"
                return value, int(Quality.EU_EXCEEDED), "valid_range", reason
        self.last_good = value
        self.last_good_us = time_us
        return value, _GOOD, "", ""

    def _bad(self, quality: Quality, kind: str, reason: str) -> tuple[float, int, str, str]:
        self.last_good_us = 0
        return math.nan, int(quality), kind, reason

    def _refused(self, code: int, time_us: int) -> tuple[float, int, str, str]:
        kind = f"exception_{code:02x}" if code != MISFIT else "misfit"
        if code in (5, 6):  # acknowledged but not ready, busy: the device keeps its old value
            if not self.last_good_us:
                reason = "device busy, no value yet"
                return math.nan, int(Quality.WAITING_FOR_INITIAL_DATA), kind, reason
            # The clock may have been set back.
            if abs(time_us - self.last_good_us) > self.age_limit_us:
                return self._bad(Quality.COMM_FAILURE, kind, "device busy for too long")
            return self.last_good, int(Quality.LAST_USABLE), kind, "device busy, last value kept"
        config = self.config
        address, table, what = config.address, config.kind, "register"
        if not self.reading.exception and config.status is not None:
            address, table = config.status.address, config.status.kind or config.kind
            what = "status register"
        where = f"{what} {address} ({table}, unit {self.unit})"
        if code == MISFIT:
            reason = f"{where}: the answer has another length or function than was asked for"
            return self._bad(Quality.COMM_FAILURE, kind, reason)
        if code == 1:
            return self._bad(
                Quality.CONFIG_ERROR, kind, f"{where} cannot be read: illegal function"
            )
        if code == 2:
            hint = data_sheet_hint(address, table)
            reason = f"{where} does not exist: illegal data address{hint and '; ' + hint}"
            return self._bad(Quality.CONFIG_ERROR, kind, reason)
        if code == 3:
            return self._bad(Quality.CONFIG_ERROR, kind, f"{where} refused: illegal data value")
        if code in (4, 7, 8):
            return self._bad(Quality.DEVICE_FAILURE, kind, f"{where}: device failure ({code:02X})")
        return self._bad(Quality.BAD, kind, f"{where}: exception {code:02X}")


@dataclass(slots=True, eq=False)
class UnitMap:
    """All that is read from one unit at one interval (process seconds)."""

    unit: int
    interval_s: float
    limits: RequestLimits
    points: list[PolledChannel]
    groups: list[Group]
    plans: list[PlanBinding]
    join_at: float = 0.0  # wall (monotonic) time at which what was split may be read together again
    join_backoff: Backoff = field(default_factory=lambda: Backoff(JOIN_FIRST_S, JOIN_LAST_S))

    def keep(self, groups: list[Group]) -> None:
        """Read by these groups from now on; what was split is tried whole again later."""
        if len(groups) > len(self.groups):
            self.join_at = time.monotonic() + self.join_backoff.next()
        self.groups = groups

    def join(self) -> None:
        """Read together again what was split, if the device refuses nothing now."""
        cells = {cell: reading for group in self.groups for cell, reading in group.cells}
        if any(reading.exception for reading in cells.values()):
            self.join_at = time.monotonic() + self.join_backoff.wait_s
        else:
            self.groups, self.join_at = group(cells, self.limits), 0.0


def check(
    source: ModbusSource, channels: Sequence[ChannelBinding], plans: Sequence[PlanBinding]
) -> None:
    """Check what is bound to a Modbus source; opens no connection.

    Raises `ConfigurationError`: a channel is bound twice, its registers run past the last address
    or do not fit into one read, or the gaps between the requests alone take longer than the
    intervals allow.
    """
    limits = limits_of(source)
    seen: set[tuple[str, str]] = set()
    for binding in channels:
        config = _channel(binding)
        if (binding.asset, binding.channel) in seen:
            raise ConfigurationError(
                f"source {source.name!r}: channel {binding.asset}/{binding.channel} is bound twice"
            )
        seen.add((binding.asset, binding.channel))
        for cell in filter(None, (value_cell(config), _status_cell(config))):
            if cell.address + cell.count > ADDRESSES:
                raise ConfigurationError(
                    f"channel {binding.asset}/{binding.channel}: register {cell.address} with "
                    f"{cell.count} addresses runs past the last address, {ADDRESSES - 1}"
                )
            if cell.kind not in BIT_KINDS and cell.count > limits.registers:
                raise ConfigurationError(
                    f"channel {binding.asset}/{binding.channel}: {config.type} takes {cell.count} "
                    f"registers, source {source.name!r} reads {limits.registers} at once "
                    "(registers_per_read_max)"
                )
    for plan in plans:
        bound = _plan(plan)
        if bound.address + bound.rows * PLAN_ROW_REGISTERS > ADDRESSES:
            raise ConfigurationError(
                f"plan of {plan.asset}: register {bound.address} with {bound.rows} rows of "
                f"{PLAN_ROW_REGISTERS} registers runs past the last address, {ADDRESSES - 1}"
            )
        if limits.registers < PLAN_ROW_REGISTERS:
            raise ConfigurationError(
                f"plan of {plan.asset}: a row takes {PLAN_ROW_REGISTERS} registers, source "
                f"{source.name!r} reads {limits.registers} at once (registers_per_read_max)"
            )
    if source.request_gap_s:
        _check_gaps(source, compile_units(source, channels, plans, 1.0))


def _check_gaps(source: ModbusSource, units: Sequence["UnitMap"]) -> None:
    """Refuse gaps between requests that take more time than there is."""
    share = sum(len(one.groups) * source.request_gap_s / one.interval_s for one in units)
    if share > 1.0:
        raise ConfigurationError(
            f"source {source.name!r}: request_gap_s {source.request_gap_s:g} is too long: with "
            f"{sum(len(one.groups) for one in units)} requests the gaps alone take {share:.1f} "
            "times the poll intervals"
        )


def compile_units(
    source: ModbusSource,
    channels: Sequence[ChannelBinding],
    plans: Sequence[PlanBinding],
    rate: float,
) -> list[UnitMap]:
    """Group everything bound to a source into as few reads per unit and interval as sensible.

    `rate` is the clock's; no age is judged tighter than 1.5 wall seconds.
    """
    limits = limits_of(source)
    units: dict[tuple[int, float], UnitMap] = {}
    cells: dict[tuple[int, float], dict[RegisterCell, RawReading]] = {}

    def unit_map(unit_id: int | None, interval_s: float | None = None) -> UnitMap:
        unit = source.unit if unit_id is None else unit_id
        interval_s = source.poll_interval_s if interval_s is None else interval_s
        cells.setdefault((unit, interval_s), {})
        return units.setdefault((unit, interval_s), UnitMap(unit, interval_s, limits, [], [], []))

    for binding in channels:
        config = _channel(binding)
        unit = unit_map(config.unit_id, config.poll_interval_s)
        readings = cells[unit.unit, unit.interval_s]
        status_cell = _status_cell(config)
        point = PolledChannel(
            asset=binding.asset,
            channel=binding.channel,
            config=config,
            unit=unit.unit,
            reading=readings.setdefault(value_cell(config), RawReading()),
            status=readings.setdefault(status_cell, RawReading()) if status_cell else None,
            sentinels=_sentinels(binding, config),
            status_bits=tuple(sorted(config.status.bits.items())) if config.status else (),
            age_limit_us=1e6 * max(config.max_age_s or 60.0, 1.5 * rate),
        )
        unit.points.append(point)
    for plan in plans:
        unit_map(_plan(plan).unit_id).plans.append(plan)
    for key, unit in units.items():
        unit.groups = group(cells[key], limits)
    return list(units.values())


def value_cell(config: ModbusChannel) -> RegisterCell:
    """Say where a channel's raw value is, and how its registers make a number."""
    if config.type == "bool":
        return RegisterCell(config.kind, config.address, 1, "", False)
    # With both orders big the bytes lie as ">": ABCD. Each order that is little reverses its own
    # level, so unpacking "<" undoes both and packing the registers little endian undoes one.
    return RegisterCell(
        kind=config.kind,
        address=config.address,
        count=_WORDS[config.type],
        structure=("<" if config.word_order == "little" else ">") + _FORMATS[config.type],
        swap_bytes=config.word_order != config.byte_order,
    )


def _status_cell(config: ModbusChannel) -> RegisterCell | None:
    status = config.status
    if status is None:
        return None
    kind = status.kind or config.kind
    if kind in BIT_KINDS:
        return RegisterCell(kind, status.address, max(status.bits) + 1, "", False)
    swap = config.byte_order == "little" and config.kind not in BIT_KINDS
    return RegisterCell(kind, status.address, 1, ">H", swap)


def _sentinels(binding: ChannelBinding, config: ModbusChannel) -> frozenset[float]:
    if config.type == "bool":
        return frozenset(config.sentinels)
    structure = struct.Struct(">" + _FORMATS[config.type])
    found = set()
    for sentinel in config.sentinels:
        try:
            number = sentinel if config.type.startswith("float") else int(sentinel)
            (decoded,) = structure.unpack(structure.pack(number))
        except (struct.error, OverflowError):
            decoded = None
        if decoded is None or (decoded != sentinel and not config.type.startswith("float")):
            logger.warning(
                "channel %s/%s: sentinel %g can never occur in %s",
                binding.asset,
                binding.channel,
                sentinel,
                config.type,
            )
            continue
        found.add(float(decoded))
    return frozenset(found)


def _channel(binding: ChannelBinding) -> ModbusChannel:
    if not isinstance(binding.config, ModbusChannel):
        raise TypeError(f"{binding.asset}/{binding.channel}: expected a ModbusChannel")
    return binding.config


def _plan(binding: PlanBinding) -> ModbusPlan:
    if not isinstance(binding.config, ModbusPlan):
        raise TypeError(f"plan of {binding.asset}: expected a ModbusPlan")
    return binding.config
