"""Which column of a file is which channel."""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from adapters.configuration import first_repeated
from adapters.tables import RowError
from service.clock import from_rfc3339
from service.domain.channels import NODES, OPERATING_CHANNELS, RING_SENSORS
from service.site.configuration import describe
from service.transfer.errors import TransferError

REQUIRED = OPERATING_CHANNELS + RING_SENSORS
_LONG = ("channel", "value")
_HEADER = f"time or time_s, {', '.join(REQUIRED)} and {NODES[0]} to {NODES[-1]}"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeColumn(_Model):
    """The column with the times: RFC 3339, or seconds counted from a given start."""

    column: str
    seconds: bool = False


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
    """

    time: TimeColumn | None = None
    channels: dict[str, ChannelColumn] = Field(min_length=1)
    delimiter: str = Field(",", min_length=1, max_length=1)


@dataclass(frozen=True, slots=True)
class Layout:
    """How the rows of one file are read.

    - ``time``: column with the times.
    - ``seconds``: whether these are seconds from a start that the user gives.
    - ``channels``: columns by channel; empty for a file with one sample per row (``time, channel,
      value`` and perhaps ``quality`` and ``received``).
    """

    time: str
    seconds: bool
    channels: dict[str, ChannelColumn]


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file (TOML).

    Raises `TransferError` if it cannot be read or a key is wrong; one line that names the key.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        return Mapping(**document)
    except OSError as error:
        raise TransferError(f"{path}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise TransferError(f"{path}: not valid TOML ({error})") from error
    except ValidationError as error:
        raise TransferError(f"{path}: {describe(error)}") from error
    except TypeError as error:
        raise TransferError(f"{path}: {error}") from error


def layout_of(
    file: str, columns: Sequence[str], mapping: Mapping | None, own_channels: Sequence[str] | None
) -> Layout:
    """Find out how a file with these columns is read.

    Raises `TransferError` if a column is missing, unknown or there twice; one line that names it.
    """

    def wrong(text: str) -> TransferError:
        return TransferError(f"{file}: line 1: {text}")

    twice = first_repeated(columns)
    if twice is not None:
        raise wrong(f"column {twice!r} occurs twice; expected once")
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
                raise wrong(f"missing column {name!r}; the mapping names {', '.join(wanted)}")
        return Layout(mapping.time.column, mapping.time.seconds, dict(mapping.channels))
    times = [name for name in ("time", "time_s") if name in columns]
    if len(times) != 1:
        found = "both time and time_s" if times else "missing column time or time_s"
        raise wrong(f"{found}; expected one of the two, then {_HEADER}")
    layout = Layout(times[0], times[0] == "time_s", {})
    if all(name in columns for name in _LONG):
        for name in columns:
            if name not in (*times, *_LONG, "quality", "received"):
                raise wrong(
                    f"unknown column {name!r}; expected time, channel, value, quality, received"
                )
        return layout
    required = REQUIRED if own_channels is None else tuple(own_channels)
    expected = f"time or time_s, {', '.join(required)}"
    if own_channels is None:
        expected += f" and {NODES[0]} to {NODES[-1]}"
    for name in required:
        if name not in columns:
            raise wrong(f"missing column {name!r}; expected {expected}, or a mapping")
    for name in columns:
        if name not in times:
            if name not in required and (name not in NODES or own_channels is not None):
                raise wrong(f"unknown column {name!r}; expected {expected}, or a mapping")
            layout.channels[name] = ChannelColumn(column=name)
    return layout


def time_reader(layout: Layout, start_us: int | None) -> Callable[[object], int]:
    """Make the function that turns a cell of the time column into UTC microseconds."""

    def read(cell: object) -> int:
        if isinstance(cell, int) and not isinstance(cell, bool) and not layout.seconds:
            return cell  # a Parquet time stamp
        try:
            if not layout.seconds:
                return from_rfc3339(str(cell).strip())
            assert start_us is not None  # noqa: S101 - asked for before the first row
            return start_us + round(float(str(cell)) * 1e6)
        except (ValueError, OverflowError) as error:
            text = str(error) if not layout.seconds else f"{cell!r}: expected seconds"
            raise RowError(f"{layout.time}: {text}") from None

    return read
