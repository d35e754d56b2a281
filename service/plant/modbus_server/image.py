"""What the registers and bits hold at the moment of a request.

Nothing is kept between requests: each answer is made of one look at the snapshot, without a pause
in between, so that no answer mixes two moments, and so that values that are not renewed get old by
themselves.
"""

import math
import struct
from collections.abc import Callable, Collection, Mapping
from typing import Final

from adapters.samples import Quality, is_bad, is_good
from service.clock import MICROSECONDS, from_rfc3339
from service.plant.modbus_server import register_map
from service.plant.modbus_server.permissive import (
    ALARMS_ACTIVE,
    TRUSTED,
    are_usable,
    may_begin,
)
from service.plant.modbus_server.register_map import (
    FIRST_TAG,
    PERMISSIVE,
    TAG_REGISTERS,
    MappedTag,
    RegisterMap,
)
from service.plant.protocol import TagValue

#: Bits of the status register.
ALARM_ACTIVE, NOT_TRUSTED, OLD = 1, 2, 4
NEVER: Final = 65535
_WORD: Final = 0xFFFF
#: Of the numbers that float32 has.
_LARGEST: Final = 3.4e38

TagsOf = Callable[[str], Mapping[str, TagValue] | None]


class Image:
    """The registers and bits."""

    def __init__(self, map: RegisterMap, tags_of: TagsOf, now_us: Callable[[], int]) -> None:
        self.heartbeat = 0
        self._map = map
        self._tags_of = tags_of
        self._now_us = now_us

    def registers(self, first: int, count: int) -> list[int] | None:
        """Give registers, each 0 to 65535; None where one of them is not in the map."""
        end = first + count
        if end > self._map.end:
            return None
        look = _Look(self._tags_of)
        now_us = self._now_us()
        words = self._head(look, now_us) if first < FIRST_TAG else []
        begin = 0 if words else first - (first - FIRST_TAG) % TAG_REGISTERS
        for address in range(max(begin, FIRST_TAG), end, TAG_REGISTERS):
            words += _words(look, self._map.tags[(address - FIRST_TAG) // TAG_REGISTERS], now_us)
        return words[first - begin : end - begin]

    def bits(self, first: int, count: int) -> list[bool] | None:
        """Give permissives, one for each asset; None where there are not so many."""
        end = first + count
        if end > len(self._map.assets):
            return None
        look = _Look(self._tags_of)
        return [
            may_begin(look(asset), inputs)
            for asset, inputs in list(self._map.assets.items())[first:end]
        ]

    def _head(self, look: "_Look", now_us: int) -> list[int]:
        words = [0] * FIRST_TAG
        words[register_map.HEARTBEAT] = self.heartbeat
        words[register_map.VERSION] = self._map.version
        words[register_map.TAG_COUNT] = len(self._map.tags)
        seconds = now_us // MICROSECONDS & 0xFFFF_FFFF
        words[register_map.TIME : register_map.TIME + 2] = seconds >> 16, seconds & _WORD
        status = 0
        for number, (asset, inputs) in enumerate(self._map.assets.items()):
            tags = look(asset)
            status |= _status(tags, inputs)
            words[PERMISSIVE + number] = int(may_begin(tags, inputs))
        words[register_map.STATUS] = status
        return words


class _Look:
    """Tags of assets, the same ones for all of an answer."""

    def __init__(self, tags_of: TagsOf) -> None:
        self._tags_of = tags_of
        self._seen: dict[str, Mapping[str, TagValue] | None] = {}

    def __call__(self, asset: str) -> Mapping[str, TagValue] | None:
        if asset not in self._seen:
            self._seen[asset] = self._tags_of(asset)
        return self._seen[asset]


def _status(tags: Mapping[str, TagValue] | None, inputs: Collection[str]) -> int:
    """Bits of one asset; what is not known for certain counts as bad."""
    active = None if tags is None else tags.get(ALARMS_ACTIVE)
    if tags is None or active is None or not is_good(active["quality"]):
        return OLD | NOT_TRUSTED
    trusted = tags.get(TRUSTED)
    status = 0 if are_usable(tags, inputs) else OLD
    if trusted is None or trusted["value"] != 1:
        status |= NOT_TRUSTED
    return status if active["value"] == 0 else status | ALARM_ACTIVE


def _words(look: _Look, mapped: MappedTag, now_us: int) -> tuple[int, int, int, int]:
    tags = look(mapped.asset)
    if tags is None:
        return (*_float_words(math.nan), Quality.OUT_OF_SERVICE, NEVER)
    shown = tags.get(mapped.tag)
    if shown is None:
        return (*_float_words(math.nan), Quality.CONFIG_ERROR, NEVER)
    value, quality = shown["value"], shown["quality"] & 0xFF
    if value is None or is_bad(quality):
        value = math.nan
    elif abs(value) > _LARGEST:  # no float32 has it
        value, quality = math.nan, int(Quality.BAD)
    high, low = _float_words(value)
    if quality == Quality.WAITING_FOR_INITIAL_DATA:
        return high, low, quality, NEVER
    age_s = (now_us - from_rfc3339(shown["time"])) // MICROSECONDS
    return high, low, quality, min(max(age_s, 0), NEVER - 1)


def _float_words(value: float) -> tuple[int, int]:
    """A number as float32, the high word first."""
    high, low = struct.unpack(">2H", struct.pack(">f", value))
    return high, low
