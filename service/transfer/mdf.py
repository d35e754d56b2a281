"""MDF, the files of measurement systems (ASAM): a group with a time axis for each channel.

The quality byte of a channel stands in one beside it, ``NAME.quality``.
"""

import contextlib
import re
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from adapters.configuration import first_repeated
from adapters.samples import Quality
from adapters.tables import TableFileError
from adapters.units import UnitError, conversion, factors_of
from adapters.words import shown
from service.domain.channels import NODES, OPERATING_CHANNELS, RING_SENSORS, unit_of
from service.transfer.errors import TransferError
from service.transfer.mapping import ChannelColumn, Mapping

SUFFIX: Final = ".mf4"
QUALITY_SUFFIX = ".quality"
#: Records of a channel that are in memory at once.
BLOCK_RECORDS = 200_000
_SECOND_US = 1_000_000
#: 30,000 years: further from a start than any time that can be.
_BEYOND_US: Final = 1e18
# The kinds of axis of MDF 4, and the units of one of times; the standard has seconds.
_TIME: Final = "time"
_AXES: Final = {1: _TIME, 2: "angle", 3: "distance", 4: "index"}
_REMOTE_MASTER: Final = 8
#: Microseconds in a unit; a sign for micro comes in two forms.
_UNITS_US: Final = {
    name: unit_us
    for names, unit_us in (
        (" s sec secs second seconds sekunde sekunden sek", 1e6),
        ("ms msec msecs millisecond milliseconds millisekunde millisekunden", 1e3),
        ("us usec usecs microsecond microseconds mikrosekunde mikrosekunden", 1.0),
        ("\N{MICRO SIGN}s \N{MICRO SIGN}sec", 1.0),
        ("\N{GREEK SMALL LETTER MU}s \N{GREEK SMALL LETTER MU}sec", 1.0),
        ("ns nsec nsecs nanosecond nanoseconds nanosekunde nanosekunden", 1e-3),
        ("min mins minute minutes minuten", 6e7),
        ("h hr hrs hour hours stunde stunden", 3.6e9),
    )
    for name in names.split(" ")
}
_UNIT_IN_BRACKETS: Final = re.compile(r"\[(.*)\]|\((.*)\)")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BEGINNING: Final = b"MDF     "
_UNFINISHED: Final = b"UnFinMF "
#: Versions whose header is a block of 64-bit links, and those before.
_VERSIONS: Final = (b"4", b"3")
_HEADER: Final = struct.Struct("<64s4s4xQQ6Q")
"""Identification, then the header block: its id, length, number of links, and links."""
# What asammdf raises for a file that is cut off or damaged.
_DAMAGED = (ValueError, KeyError, IndexError, TypeError, EOFError, struct.error, OSError)


@dataclass(frozen=True, slots=True, eq=False)
class MdfChannel:
    """A block of the samples of one channel of a file, as samples of ours.

    - ``channel``: ours.
    - ``first``: number of its first sample among those of the channel, from 1.
    - ``time_us``: (n,) UTC microseconds.
    - ``values``: (n,) in our unit; NaN where there is none.
    - ``quality``: (n,) OPC DA bytes.
    - ``read``: how much of the file has been read with it, from 0 to 1.
    - ``conversion``: what was done to the values, in words; empty where nothing.
    """

    channel: str
    first: int
    time_us: NDArray[np.int64]
    values: NDArray[np.float64]
    quality: NDArray[np.int64]
    read: float
    conversion: str


def is_mdf(path: Path) -> bool:
    """Whether a file is one by its first bytes, or by its suffix."""
    try:
        with path.open("rb") as file:
            begins = file.read(len(_BEGINNING))
    except OSError:  # who reads it says so
        begins = b""
    return begins in (_BEGINNING, _UNFINISHED) or path.suffix.lower() == SUFFIX


def load_asammdf() -> Any:
    """Import asammdf. Raises `TableFileError` if it is not installed; says how to install it."""
    if sys.modules.get("asammdf", sys) is None:  # the mark of `adapters.drivers.can`
        del sys.modules["asammdf"]
    try:
        import asammdf
    except ImportError:
        raise TableFileError("MDF 4 needs asammdf: pip install 'bearing-twin[mdf]'") from None
    return asammdf


@contextlib.contextmanager
def open_mdf(
    path: Path,
    mapping: Mapping | None,
    own_channels: Sequence[str] | None,
    start_us: int | None,
) -> Iterator[Iterator[MdfChannel]]:
    """Open a file and give its channels, one after the other, in blocks of `BLOCK_RECORDS`.

    ``start_us``: time of 0 s in UTC microseconds, for a file that does not know it in UTC, or knows
    it wrong. Raises `TableFileError` if asammdf is not installed, or the file cannot be read, also
    in the middle of it; `TransferError` if a channel is missing, unknown, there several times, in a
    wrong unit or no number, or the file's time has no zone.
    """
    asammdf = load_asammdf()
    try:
        with path.open("rb") as file:
            _check_header(path.name, file.read(_HEADER.size), path.stat().st_size)
            file.seek(0)
            with _naming_damage(asammdf, path.name), asammdf.MDF(file) as mdf:
                if start_us is None:
                    start_us = _recorded_start_us(path.name, mdf)
                chosen = _chosen(path.name, mdf, mapping, own_channels)
                yield _channels(asammdf, path.name, mdf, chosen, start_us)
    except OSError as error:
        raise TableFileError(f"{path}: cannot be read ({error.strerror or error})") from error


def _check_header(name: str, header: bytes, size: int) -> None:
    """Refuse what is no such file or ends too early; of these asammdf leaves a traceback."""
    version = header[len(_BEGINNING) : len(_BEGINNING) + 1]
    if not header.startswith(_BEGINNING) or version not in _VERSIONS:
        raise TableFileError(
            f"{name}: not a finished MDF 3 or MDF 4 file; expected one that begins with 'MDF'"
        )
    if version == b"3":
        if len(header) == _HEADER.size and header[64:66] == b"HD":
            return
    elif len(header) == _HEADER.size:
        _, block, _, _, *links = _HEADER.unpack(header)
        if block == b"##HD" and max(links) < size:
            return
    raise TableFileError(f"{name}: damaged MDF file (cut off at {size} bytes)")


@contextlib.contextmanager
def _naming_damage(asammdf: Any, name: str) -> Iterator[None]:
    try:
        yield
    except (TableFileError, TransferError):
        raise
    except (*_DAMAGED, asammdf.blocks.utils.MdfException) as error:
        raise TableFileError(f"{name}: damaged MDF file ({error})") from error


def _recorded_start_us(name: str, mdf: Any) -> int:
    start = mdf.header.start_time
    if mdf.version < "4":
        # Its time is that of the recording machine's clock; a reader can only guess the zone.
        raise TransferError(
            f"{name}: MDF {mdf.version} knows no time zone; expected --start with the time of 0 s"
        )
    if start.tzinfo is None:
        raise TransferError(
            f"{name}: begins at {start.isoformat()} of an unknown time zone; expected --start with "
            "the time of 0 s"
        )
    return int((start - _EPOCH) // timedelta(microseconds=1))


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A channel of ours and where it comes from."""

    channel: str
    source: ChannelColumn
    group: int
    index: int


def _places(mdf: Any) -> dict[str, list[tuple[int, int]]]:
    """Group and index of every channel by name, without the time axes."""
    return {
        name: here
        for name, places in mdf.channels_db.items()
        if (here := [one for one in places if mdf.masters_db.get(one[0]) != one[1]])
    }


def _chosen(
    file: str, mdf: Any, mapping: Mapping | None, own_channels: Sequence[str] | None
) -> list[_Chosen]:
    places = _places(mdf)
    if mapping is None:
        return list(_by_name(file, places, own_channels))
    if mapping.time is not None:
        raise TransferError(
            f"{file}: an MDF file has its own times; expected a mapping without [time]"
        )
    wanted = ", ".join(one.column for one in mapping.channels.values())
    found = []
    for channel, source in mapping.channels.items():
        here = places.get(source.column, [])
        if not here:
            raise TransferError(
                f"{file}: missing channel {shown(source.column)}; the mapping names {wanted}"
            )
        fitting = [
            one for one in here if source.group in (None, one[0]) and source.index in (None, one[1])
        ]
        if len(fitting) != 1:
            several = len({group for group, _ in here}) < len(here)
            listed = ", ".join(
                f"{group} (index {index})" if several else str(group) for group, index in here
            )
            keys = f"channels.{channel}.group and index" if several else f"channels.{channel}.group"
            raise TransferError(
                f"{file}: channel {shown(source.column)} is in the groups {listed}; expected "
                f"{keys} = one of them"
            )
        found.append(_Chosen(channel, source, *fitting[0]))
    return found


def _by_name(
    file: str, places: dict[str, list[tuple[int, int]]], own_channels: Sequence[str] | None
) -> Iterator[_Chosen]:
    """Choose what is ours: known names, and all that stands beside its quality as we write it."""
    standard = (*OPERATING_CHANNELS, *RING_SENSORS, *NODES)
    known = standard if own_channels is None else tuple(own_channels)
    judged = {
        (name.removesuffix(QUALITY_SUFFIX), group)
        for name, here in places.items()
        if name.endswith(QUALITY_SUFFIX)
        for group, _ in here
    }
    for name, here in places.items():
        twice = first_repeated(str(group) for group, _ in here)
        if twice is not None and name in known:
            indexes = ", ".join(str(index) for group, index in here if str(group) == twice)
            raise TransferError(
                f"{file}: channel {shown(name)} is in group {twice} several times (index "
                f"{indexes}); expected a mapping with group and index"
            )
        for group, index in here:
            if (name, group) in judged or name in known:
                yield _Chosen(name, ChannelColumn(column=name), group, index)
            elif not name.endswith(QUALITY_SUFFIX):
                raise TransferError(
                    f"{file}: unknown channel {shown(name)}; expected "
                    f"{', '.join(known[:5])} …, or a mapping"
                )


def _channels(
    asammdf: Any, file: str, mdf: Any, chosen: Sequence[_Chosen], start_us: int
) -> Iterator[MdfChannel]:
    places = _places(mdf)
    for number, one in enumerate(chosen):
        beside = dict(places.get(f"{one.source.column}{QUALITY_SUFFIX}", ())).get(one.group)
        records = max(mdf.groups[one.group].channel_group.cycles_nr, 1)
        first = 1
        for offset in range(0, records, BLOCK_RECORDS):
            with _naming_damage(asammdf, file):
                get = partial(
                    mdf.get,
                    group=one.group,
                    ignore_invalidation_bits=True,
                    record_offset=offset,
                    record_count=BLOCK_RECORDS,
                )
                signal = get(index=one.index)
                quality = None if beside is None else get(index=beside, samples_only=True)[0]
                unit_us = _unit_of_times_us(file, one, mdf)
            time_us = start_us + _microseconds(signal.timestamps, unit_us)
            read = (number + min((offset + BLOCK_RECORDS) / records, 1.0)) / len(chosen)
            block = _as_samples(file, one, signal, quality, time_us, first, read)
            first += block.values.size
            yield block


def _unit_of_times_us(file: str, one: _Chosen, mdf: Any) -> float:
    """Microseconds in one unit of a channel's time axis.

    Raises `TransferError` where its group has none: asammdf then counts the records, or gives the
    angle or distance along which they were taken.
    """
    group, number = mdf.groups[one.group], one.group
    if mdf.version >= "4" and group.channel_group.flags & _REMOTE_MASTER:
        number = group.channel_group.cg_master_index
    index = mdf.masters_db.get(number)
    if index is None:
        raise TransferError(
            f"{file}: channel {shown(one.source.column)} is in group {one.group}, which has no "
            "time axis (no master channel); expected one"
        )
    if mdf.version < "4":
        return _SECOND_US  # of these files every axis is one of seconds
    master = mdf.groups[number].channels[index]
    kind = _AXES.get(master.sync_type, "no time")
    unit = str(master.unit or (master.conversion and master.conversion.unit) or "")
    unit_us = _unit_us(unit.strip())
    if kind != _TIME or unit_us is None:
        said = f"{kind} in {unit!r}" if unit else kind
        raise TransferError(
            f"{file}: channel {shown(one.source.column)} is in group {one.group}, whose axis is "
            f"{shown(str(master.name))} ({said}); expected a time axis, in s, ms, us, ns, min or h"
        )
    return unit_us


def _unit_us(unit: str) -> float | None:
    """Microseconds in a unit as people write it: ``[ms]``, ``Sec``; None where it is none."""
    found = _UNIT_IN_BRACKETS.fullmatch(unit)
    text = (found[1] or found[2] or "").strip() if found else unit
    # In the short names a capital is another unit or prefix: S, Ms.
    return _UNITS_US.get(text.lower() if len(text) > 2 else text)


def _microseconds(timestamps: Any, unit_us: float) -> NDArray[np.int64]:
    """Count of microseconds; where there is no number, or none that fits, one of no time."""
    counts = np.nan_to_num(np.asarray(timestamps, np.float64) * unit_us, nan=-_BEYOND_US)
    return np.rint(np.clip(counts, -_BEYOND_US, _BEYOND_US)).astype(np.int64)


def _as_samples(
    file: str,
    one: _Chosen,
    signal: Any,
    quality: Any,
    time_us: NDArray[np.int64],
    first: int,
    read: float,
) -> MdfChannel:
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.kind not in "fiub":
        raise TransferError(f"{file}: channel {shown(one.source.column)} holds no numbers")
    scale, offset, done = _factors(file, one, str(signal.unit or ""))
    values = samples.astype(np.float64) * scale + offset
    invalid = np.zeros(values.size, bool)
    if signal.invalidation_bits is not None:
        invalid = np.asarray(signal.invalidation_bits, bool)
    # Where only the bit says that a value is bad, the file does not say why.
    if quality is None:
        judged = np.where(invalid, int(Quality.BAD), int(Quality.GOOD))
        # A valid sample that is no number is a missing one, as an empty cell of a table.
        kept = invalid | ~np.isnan(values)
    else:
        judged = _bytes(file, one, np.asarray(quality))
        unsaid = invalid & (judged >= Quality.UNCERTAIN) & ~np.isnan(values)
        judged = np.where(unsaid, int(Quality.BAD), judged)
        kept = np.ones(values.size, bool)
    values[invalid] = np.nan
    return MdfChannel(one.channel, first, time_us[kept], values[kept], judged[kept], read, done)


def _bytes(file: str, one: _Chosen, quality: NDArray[Any]) -> NDArray[np.int64]:
    is_whole = quality.dtype.kind in "iu"
    if not is_whole or (quality.size and not 0 <= quality.min() <= quality.max() <= 255):
        raise TransferError(
            f"{file}: channel '{one.source.column}{QUALITY_SUFFIX}': expected whole numbers from 0 "
            "to 255"
        )
    return quality.astype(np.int64)


def _factors(file: str, one: _Chosen, unit: str) -> tuple[float, float, str]:
    """Scale and offset: as the mapping has them, else from the unit of the file; and in words."""
    ours = unit_of(one.channel)
    try:
        return *factors_of(one.source, ours, unit), conversion(one.source, ours, unit)
    except UnitError as error:
        raise TransferError(
            f"{file}: channel {shown(one.source.column)} is {error} for {one.channel}, or a "
            "mapping with scale"
        ) from None
