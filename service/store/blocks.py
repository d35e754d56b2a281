"""Blocks: samples of channels that were read together, compressed to the last bit.

A block is a MessagePack map of compressed columns: one of times, and a value and a quality for
each channel. The columns are pcodec's: it finds even steps of time and decimal steps of values by
itself.
"""

import zlib
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from pcodec import ChunkConfig, standalone

from service.store.errors import StoreError

#: The one way of compression so far; each block says which is its own.
CODEC = 1

_CONFIG = ChunkConfig()


class BlockDamagedError(Exception):
    """A block is not what was written."""


class Samples(NamedTuple):
    """Samples of one channel, ascending by time, each time once.

    ``values`` are not a number where there is none.
    """

    times_us: NDArray[np.int64]
    values: NDArray[np.float64]
    qualities: NDArray[np.uint16]

    def within(self, begin_us: int, end_us: int) -> "Samples":
        """Give those of a half-open span."""
        first, last = np.searchsorted(self.times_us, (begin_us, end_us))
        times_us, values, qualities = self
        return Samples(times_us[first:last], values[first:last], qualities[first:last])


class _Columns(msgspec.Struct, frozen=True):
    """What a block consists of."""

    times: bytes
    values: list[bytes]
    qualities: list[bytes]


class Block(NamedTuple):
    """A block as it is stored."""

    codec: int
    crc: int
    data: bytes


def pack(channels: Sequence[Samples]) -> Block:
    """Compress channels that have the same times.

    Raises
    ------
    ValueError
        If their times differ.
    """
    times_us = channels[0].times_us
    if any(not np.array_equal(one.times_us, times_us) for one in channels[1:]):
        raise ValueError("channels of one block: expected the same times")
    data = msgspec.msgpack.encode(
        _Columns(
            standalone.simple_compress(times_us, _CONFIG),
            [standalone.simple_compress(one.values, _CONFIG) for one in channels],
            [standalone.simple_compress(one.qualities, _CONFIG) for one in channels],
        )
    )
    return Block(CODEC, zlib.crc32(data), data)


def is_damaged(block: Block) -> bool:
    """Tell whether the bytes of a block are not those that were written."""
    return zlib.crc32(block.data) != block.crc


def unpack(block: Block, position: int) -> Samples:
    """Give the samples of one channel of a block, by its number in it.

    Raises
    ------
    BlockDamagedError
        If the block is damaged.
    StoreError
        If a later version made it.
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
    return Samples(
        np.asarray(standalone.simple_decompress(columns.times), np.int64),
        np.asarray(standalone.simple_decompress(columns.values[position]), np.float64),
        np.asarray(standalone.simple_decompress(columns.qualities[position]), np.uint16),
    )
