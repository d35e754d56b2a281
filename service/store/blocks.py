"""Blocks: samples of channels that were read together, compressed to the last bit.

A block is a MessagePack map of compressed columns: one of times, a value and a quality for each
channel, and received times, once for all channels that agree in them. The columns are pcodec's: it
finds even steps of time and decimal steps of values.
"""

import zlib
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from pcodec import ChunkConfig, standalone

from service.domain.errors import BearingTwinError
from service.store.errors import StoreError

#: The one way of compression so far; each block says which is its own.
CODEC = 1

#: Stands for an unknown received time.
UNKNOWN_US = -(2**63)

_CONFIG = ChunkConfig()


class BlockDamagedError(BearingTwinError):
    """A block is not what was written."""


class ChannelSamples(NamedTuple):
    """Samples of one channel, ascending by time, each time once.

    ``values`` are not a number where there is none, ``received_us`` are `UNKNOWN_US` where an
    earlier version stored the sample.
    """

    times_us: NDArray[np.int64]
    values: NDArray[np.float64]
    qualities: NDArray[np.uint16]
    received_us: NDArray[np.int64]

    def within(self, begin_us: int, end_us: int) -> "ChannelSamples":
        """Give those of a half-open span."""
        first, last = np.searchsorted(self.times_us, (begin_us, end_us))
        return self.taken(slice(first, last))

    def taken(self, which: slice) -> "ChannelSamples":
        """Give those at some places."""
        times_us, values, qualities, received_us = self
        return ChannelSamples(times_us[which], values[which], qualities[which], received_us[which])


class _Received(msgspec.Struct, frozen=True):
    """Received times: as they are, or how much later than the times of the samples.

    Of what is read, the second is nearly always the same; of what a gateway collects and sends at
    once, the first is.
    """

    times: bytes = b""
    later: bytes = b""


class _Columns(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a block consists of.

    ``received_of`` says for each channel which of ``received`` is its own, -1 for none. Blocks of
    earlier versions have neither.
    """

    times: bytes
    values: list[bytes]
    qualities: list[bytes]
    received: list[_Received] = []
    received_of: list[int] = []


class Block(NamedTuple):
    """A block as it is stored."""

    codec: int
    crc: int
    data: bytes


def pack(channels: Sequence[ChannelSamples]) -> Block:
    """Compress channels that have the same times. Raises `ValueError` if their times differ."""
    times_us = channels[0].times_us
    if any(not np.array_equal(one.times_us, times_us) for one in channels[1:]):
        raise ValueError("channels of one block: expected the same times")
    numbers: dict[bytes, int] = {}
    received: list[_Received] = []
    received_of: list[int] = []
    for one in channels:
        if (one.received_us == UNKNOWN_US).all():
            received_of.append(-1)
            continue
        number = numbers.setdefault(one.received_us.tobytes(), len(received))
        if number == len(received):
            received.append(_pack_received(times_us, one.received_us))
        received_of.append(number)
    data = msgspec.msgpack.encode(
        _Columns(
            standalone.simple_compress(times_us, _CONFIG),
            [standalone.simple_compress(one.values, _CONFIG) for one in channels],
            [standalone.simple_compress(one.qualities, _CONFIG) for one in channels],
            received,
            received_of if received else [],
        )
    )
    return Block(CODEC, zlib.crc32(data), data)


def is_damaged(block: Block) -> bool:
    """Whether the bytes of a block are not those that were written."""
    return zlib.crc32(block.data) != block.crc


def unpack(block: Block, position: int) -> ChannelSamples:
    """Give the samples of one channel of a block, by its number in it.

    Raises `BlockDamagedError` if the block is damaged; `StoreError` if a later version made it.
    """
    if block.codec != CODEC:
        raise StoreError(
            f"a block of samples has codec {block.codec}: expected {CODEC}; a later version made it"
        )
    if is_damaged(block):
        raise BlockDamagedError("its checksum differs")
    columns = msgspec.msgpack.decode(block.data, type=_Columns)
    if position >= len(columns.values):
        raise BlockDamagedError(f"it has {len(columns.values)} channels")
    times_us = np.asarray(standalone.simple_decompress(columns.times), np.int64)
    return ChannelSamples(
        times_us,
        np.asarray(standalone.simple_decompress(columns.values[position]), np.float64),
        np.asarray(standalone.simple_decompress(columns.qualities[position]), np.uint16),
        _unpack_received(columns, position, times_us),
    )


def _pack_received(times_us: NDArray[np.int64], received_us: NDArray[np.int64]) -> _Received:
    """Compress received times in the way that takes less."""
    # Neither time is negative, so that no difference is the sign of an unknown one.
    later_us = np.where(received_us == UNKNOWN_US, UNKNOWN_US, received_us - times_us)
    times = standalone.simple_compress(received_us, _CONFIG)
    later = standalone.simple_compress(later_us, _CONFIG)
    return _Received(later=later) if len(later) <= len(times) else _Received(times=times)


def _unpack_received(
    columns: _Columns, position: int, times_us: NDArray[np.int64]
) -> NDArray[np.int64]:
    number = columns.received_of[position] if columns.received else -1
    if number < 0:
        return np.full(times_us.size, UNKNOWN_US)
    received = columns.received[number]
    if received.times:
        return np.asarray(standalone.simple_decompress(received.times), np.int64)
    later_us = np.asarray(standalone.simple_decompress(received.later), np.int64)
    return np.where(later_us == UNKNOWN_US, UNKNOWN_US, times_us + later_us)
