"""Pushed samples on their way to the cell, column by column."""

from array import array
from collections.abc import Collection, Iterable, Sequence
from itertools import compress, islice
from operator import le

import msgspec

from adapters.samples import Sample, make_sample


class PackedSamples(msgspec.Struct, frozen=True, array_like=True):
    """Samples of one asset column by column, each as the bytes of an array.

    - ``channels``: names that ``channel`` counts from 0.
    - ``channel``, ``time_us``, ``value``, ``quality``: one entry for each sample: unsigned short,
      int64, float64 and byte.
    """

    channels: list[str]
    channel: bytes
    time_us: bytes
    value: bytes
    quality: bytes

    @classmethod
    def pack(cls, samples: Sequence[Sample]) -> "PackedSamples":
        """Write samples of one asset."""
        names = {name: number for number, name in enumerate({one.channel for one in samples})}
        return cls(
            list(names),
            array("H", [names[one.channel] for one in samples]).tobytes(),
            array("q", [one.time_us for one in samples]).tobytes(),
            array("d", [one.value for one in samples]).tobytes(),
            bytes(int(one.quality) for one in samples),
        )

    def __len__(self) -> int:
        """How many there are."""
        return len(self.quality)

    def unpack(self, asset: str, received_us: int) -> list[Sample]:
        """Read them again."""
        return PushedSamples.of_asset(asset, self).unpack(received_us, 0, len(self))


class PushedSamples(msgspec.Struct, frozen=True, array_like=True):
    """Samples of any assets, as `PackedSamples`: asset by asset, each in the order of their times.

    - ``assets``: names that ``asset``, unsigned shorts, counts from 0; each has a sample.
    """

    assets: list[str]
    asset: bytes
    channels: list[str]
    channel: bytes
    time_us: bytes
    value: bytes
    quality: bytes

    @classmethod
    def of(cls, samples: Iterable[Sample]) -> "PushedSamples":
        """Write samples in any order."""
        columns = PushColumns()
        for one in samples:
            columns.add(one)
        return columns.packed()

    @classmethod
    def of_asset(cls, asset: str, samples: PackedSamples) -> "PushedSamples":
        """Write samples of one asset, in the order in which they are."""
        count = len(samples)
        return cls([asset] if count else [], bytes(2 * count), *msgspec.structs.astuple(samples))

    def __len__(self) -> int:
        """How many there are."""
        return len(self.quality)

    def unpack(self, received_us: int, begin: int, end: int) -> list[Sample]:
        """Read some of them again."""
        rows = zip(
            map(self.assets.__getitem__, array("H", self.asset[2 * begin : 2 * end])),
            map(self.channels.__getitem__, array("H", self.channel[2 * begin : 2 * end])),
            array("q", self.time_us[8 * begin : 8 * end]),
            array("d", self.value[8 * begin : 8 * end]),
            self.quality[begin:end],
            strict=True,
        )
        return [make_sample((*row, received_us)) for row in rows]

    def part(self, assets: Collection[str]) -> "PushedSamples":
        """Give those of some assets."""
        numbers = [number for number, name in enumerate(self.assets) if name in assets]
        if len(numbers) == len(self.assets):
            return self
        renumbered = {before: number for number, before in enumerate(numbers)}
        asset = array("H", self.asset)
        kept = [number in renumbered for number in asset]

        def column(kind: str, content: bytes) -> bytes:
            return array(kind, compress(array(kind, content), kept)).tobytes()

        return PushedSamples(
            [self.assets[number] for number in numbers],
            array("H", map(renumbered.__getitem__, compress(asset, kept))).tobytes(),
            self.channels,
            column("H", self.channel),
            column("q", self.time_us),
            column("d", self.value),
            column("B", self.quality),
        )


class PushColumns:
    """Collects samples of a push, at most 65,535.

    - ``names``: asset and channel that ``line`` counts, in the order in which they came first.
    - ``line``, ``time_us``, ``value``, ``quality``: one entry for each sample.
    """

    def __init__(self) -> None:
        self.names: list[tuple[str, str]] = []
        self.line = array("H")
        self.time_us = array("q")
        self.value = array("d")
        self.quality = bytearray()
        self._numbers: dict[tuple[str, str], int] = {}

    def __len__(self) -> int:
        """How many there are."""
        return len(self.quality)

    def add(self, sample: Sample) -> None:
        """Take one."""
        self.append(*sample[:5])

    def append(self, asset: str, channel: str, time_us: int, value: float, quality: int) -> None:
        """Take one by its attributes."""
        name = asset, channel
        line = self._numbers.get(name)
        if line is None:
            line = self._numbers[name] = len(self.names)
            self.names.append(name)
        self.line.append(line)
        self.time_us.append(time_us)
        self.value.append(value)
        self.quality.append(quality)

    def assets(self) -> frozenset[str]:
        """Those that have a sample."""
        return frozenset(self.names[line][0] for line in set(self.line))

    def packed(self) -> PushedSamples:
        """Write them for the cell."""
        assets: dict[str, int] = {}
        channels: dict[str, int] = {}
        of_line = [
            (assets.setdefault(asset, len(assets)), channels.setdefault(channel, len(channels)))
            for asset, channel in self.names
        ]
        asset = array("H", [of_line[line][0] for line in self.line])
        channel = array("H", [of_line[line][1] for line in self.line])
        time_us, value, quality = self.time_us, self.value, bytes(self.quality)
        places = list(zip(asset, time_us, strict=True))
        if not all(map(le, places, islice(places, 1, None))):
            order = sorted(range(len(places)), key=places.__getitem__)
            asset = array("H", map(asset.__getitem__, order))
            channel = array("H", map(channel.__getitem__, order))
            time_us = array("q", map(time_us.__getitem__, order))
            value = array("d", map(value.__getitem__, order))
            quality = bytes(map(quality.__getitem__, order))
        return PushedSamples(
            list(assets),
            asset.tobytes(),
            list(channels),
            channel.tobytes(),
            time_us.tobytes(),
            value.tobytes(),
            quality,
        )
