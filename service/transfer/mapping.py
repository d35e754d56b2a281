"""Which column of a file is which channel."""

import tomllib
from collections import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from adapters.configuration import first_repeated
from adapters.tables import RowError, TimeStamp, number_of
from adapters.units import (
    KELVIN_OR_NOT,
    UnitError,
    conversion,
    factors_of,
    kelvin_doubt,
    unit_in,
)
from adapters.words import shown
from service.clock import from_rfc3339
from service.domain.channels import NODES, OPERATING_CHANNELS, RING_SENSORS, unit_of
from service.files import EncodingError, utf8_of
from service.site.configuration import describe
from service.transfer.errors import TransferError

REQUIRED = OPERATING_CHANNELS + RING_SENSORS
_LONG = ("channel", "value")
_US_OF = {
    "s": Fraction(1_000_000),
    "ms": Fraction(1000),
    "us": Fraction(1),
    "ns": Fraction(1, 1000),
}
#: No time is longer.
_TIME_CHARACTERS = 60
_HEADER = f"time or time_s, {', '.join(REQUIRED)} and {NODES[0]} to {NODES[-1]}"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeColumn(_Model):
    """The column with the times: RFC 3339 or time stamps, or a count from a given start.

    ``unit``: of the count; ``seconds = true`` is the same as ``unit = "s"``.
    """

    column: str
    seconds: bool = False
    unit: Literal["s", "ms", "us", "ns"] | None = None

    @model_validator(mode="after")
    def _one_unit(self) -> Self:
        if self.seconds and self.unit not in (None, "s"):
            raise ValueError(f"unit = {self.unit!r}: expected no unit beside seconds = true")
        return self


class ChannelColumn(_Model):
    """Where a channel comes from: its value is that of the column times scale plus offset.

    ``group`` says which one of an MDF file, where several have a channel of this name, and
    ``index`` which one of a group that has several.
    """

    column: str
    group: int | None = Field(None, ge=0)
    index: int | None = Field(None, ge=0)
    scale: float = Field(1.0, allow_inf_nan=False)
    offset: float = Field(0.0, allow_inf_nan=False)


class Mapping(_Model):
    """A mapping file.

    ``time``: the column with the times; None for an MDF file, where each channel has its own.
    ``decimal``: what stands before the fraction of a number that is written as text.
    """

    time: TimeColumn | None = None
    channels: dict[str, ChannelColumn] = Field(min_length=1)
    delimiter: str = Field(",", min_length=1, max_length=1)
    decimal: Literal[".", ","] = "."


@dataclass(frozen=True, slots=True)
class Layout:
    """How the rows of one file are read.

    - ``time``: column with the times.
    - ``unit``: of which they are a count from a start that the user gives; None where the cells
      say which times they are.
    - ``channels``: columns by channel; empty for a file with one sample per row (``time, channel,
      value`` and perhaps ``quality`` and ``received``).
    - ``decimal``: what stands before the fraction of a number.
    - ``conversions``: what is done to the values of channels, one line for each.
    """

    time: str
    unit: str | None
    channels: dict[str, ChannelColumn]
    decimal: str = "."
    conversions: tuple[str, ...] = ()


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file (TOML).

    Raises `TransferError` if it cannot be read or a key is wrong; one line that names the key.
    """
    try:
        document = tomllib.loads(utf8_of(path.read_bytes()))
        return Mapping(**document)
    except OSError as error:
        raise TransferError(f"{path}: cannot be read ({error.strerror})") from error
    except EncodingError as error:
        raise TransferError(f"{path}: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise TransferError(f"{path}: not valid TOML ({error})") from error
    except ValidationError as error:
        raise TransferError(f"{path}: {describe(error)}") from error
    except TypeError as error:
        raise TransferError(f"{path}: {error}") from error


def layout_of(
    file: str,
    columns: Sequence[str],
    mapping: Mapping | None,
    own_channels: Sequence[str] | None,
    units: abc.Mapping[str, str] = MappingProxyType({}),
) -> Layout:
    """Find out how a file with these columns is read.

    Raises `TransferError` if a column is missing, unknown, there twice or in a unit that is none of
    its channel; one line that names it.

    - ``units``: of columns, as the file states them beside their names.
    """
    layout = _layout(file, columns, mapping, own_channels)
    channels, conversions = {}, []
    for channel, one in layout.channels.items():
        channels[channel], done = _in_our_unit(file, channel, one, units.get(one.column, ""))
        conversions += [f"{channel}: {done}"] if done else []
    return replace(layout, channels=channels, conversions=tuple(conversions))


def _in_our_unit(
    file: str, channel: str, one: ChannelColumn, unit: str
) -> tuple[ChannelColumn, str]:
    ours = unit_of(channel)
    doubt = "" if unit else kelvin_doubt(one, ours, one.column)
    if doubt:
        raise TransferError(
            f"{file}: column {shown(one.column)} of {channel}: {doubt}; expected in the mapping "
            f"{KELVIN_OR_NOT}"
        )
    unit = unit or unit_in(one.column, ours)
    try:
        scale, offset = factors_of(one, ours, unit)
        done = conversion(one, ours, unit)
    except UnitError as error:
        raise TransferError(
            f"{file}: column {one.column!r} is {error} for {channel}, or a mapping with scale"
        ) from None
    return one.model_copy(update={"scale": scale, "offset": offset}), done


def _layout(
    file: str, columns: Sequence[str], mapping: Mapping | None, own_channels: Sequence[str] | None
) -> Layout:

    def wrong(text: str) -> TransferError:
        return TransferError(f"{file}: line 1: {text}")

    twice = first_repeated(columns)
    if twice is not None:
        raise wrong(f"column {shown(twice)} occurs twice; expected once")
    if mapping is not None:
        if mapping.time is None:
            raise TransferError(f"{file}: the mapping has no [time]; expected the times' column")
        for channel, one in mapping.channels.items():
            for key, value in (("group", one.group), ("index", one.index)):
                if value is not None:
                    raise TransferError(
                        f"{file}: channels.{channel}.{key}: only an MDF file has groups"
                    )
        wanted = [mapping.time.column, *(one.column for one in mapping.channels.values())]
        for name in wanted:
            if name not in columns:
                raise wrong(f"missing column {shown(name)}; the mapping names {', '.join(wanted)}")
        unit = "s" if mapping.time.seconds else mapping.time.unit
        return Layout(mapping.time.column, unit, dict(mapping.channels), mapping.decimal)
    times = [name for name in ("time", "time_s") if name in columns]
    if len(times) != 1:
        found = "both time and time_s" if times else "missing column time or time_s"
        raise wrong(f"{found}; expected one of the two, then {_HEADER}")
    layout = Layout(times[0], "s" if times[0] == "time_s" else None, {})
    if all(name in columns for name in _LONG):
        for name in columns:
            if name not in (*times, *_LONG, "quality", "received"):
                raise wrong(
                    f"unknown column {shown(name)}; expected time, channel, value, quality, "
                    "received"
                )
        return layout
    required = REQUIRED if own_channels is None else tuple(own_channels)
    expected = f"time or time_s, {', '.join(required)}"
    if own_channels is None:
        expected += f" and {NODES[0]} to {NODES[-1]}"
    for name in required:
        if name not in columns:
            raise wrong(f"missing column {shown(name)}; expected {expected}, or a mapping")
    for name in columns:
        if name not in times:
            if name not in required and (name not in NODES or own_channels is not None):
                raise wrong(f"unknown column {shown(name)}; expected {expected}, or a mapping")
            layout.channels[name] = ChannelColumn(column=name)
    return layout


def time_reader(file: str, layout: Layout, start_us: int | None) -> Callable[[object], int]:
    """Make the function that turns a cell of the time column into UTC microseconds.

    Raises `TransferError` if the cells count from a start that is not given.
    """
    if layout.unit is None:
        return lambda cell: moment_us(layout.time, cell)
    if start_us is None:
        raise TransferError(
            f"{file}: {layout.time} counts from a time that the file does not say; "
            f"expected --start with the time of 0 {layout.unit}"
        )
    per_unit = _US_OF[layout.unit]

    def counted(cell: object) -> int:
        try:
            if isinstance(cell, int) and not isinstance(cell, bool | TimeStamp):
                return start_us + round(cell * per_unit)
            if isinstance(cell, TimeStamp):
                raise ValueError("a time is no count")
            decimal = layout.decimal if isinstance(cell, str) else "."
            return start_us + round(number_of(str(cell), decimal) * float(per_unit))
        except (ValueError, OverflowError):
            raise RowError(
                f"{layout.time}: {shown(cell)}: expected a number, in {layout.unit} from --start"
            ) from None

    return counted


def moment_us(column: str, cell: object) -> int:
    """UTC microseconds of a cell that says which time it is. Raises `RowError` where none does."""
    if isinstance(cell, TimeStamp):
        return int(cell)
    if cell is None:
        raise RowError(f"{column} is empty; expected a time")
    if not isinstance(cell, str):
        raise RowError(
            f"{column} = {shown(cell)}: expected a time stamp with a time zone, or a mapping with "
            "the unit of this number"
        )
    try:
        return from_rfc3339(cell.strip()[:_TIME_CHARACTERS])
    except ValueError as error:
        raise RowError(f"{column}: {error}") from None
