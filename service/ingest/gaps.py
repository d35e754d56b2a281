"""Gaps between the last run of the service and this one."""

import math
from collections.abc import Collection, Iterable, Mapping

from adapters.samples import Quality, Sample

_Channel = tuple[str, str]
_Gap = tuple[int, int]


class Gaps:
    """Where channels ended before this run: from there to their next sample nothing was recorded.

    Without a mark a reader would draw a line from the last value before the service was away to
    the first one after.

    - ``ends``: of the channels on the spool, which are newer than the store; None where a gap is
      marked already.
    """

    def __init__(self, ends: Mapping[_Channel, int | None]) -> None:
        self._unmarked = {name: end_us for name, end_us in ends.items() if end_us is not None}
        self._known = set(ends)
        # First times of this run, of channels whose end only the store knows; None once it is read.
        self._first_us: dict[_Channel, int] | None = {}

    @property
    def may_close(self) -> bool:
        """Whether samples may close a gap."""
        return bool(self._unmarked) or self._first_us is not None

    def closed_by_store(self, ends: Mapping[_Channel, int], now_us: int) -> list[Sample]:
        """Take what the store knows; gives marks of gaps whose next samples have come already."""
        gaps: dict[_Channel, _Gap] = {}
        for channel, last_us in ends.items():
            if channel in self._known:
                continue
            first_us = (self._first_us or {}).get(channel)
            if first_us is None:
                self._unmarked[channel] = last_us
            else:
                gaps[channel] = last_us, first_us
        self._known |= ends.keys()
        self._first_us = None
        return _marks(gaps, now_us)

    def closed_by(self, samples: Iterable[Sample], now_us: int) -> list[Sample]:
        """Marks of the gaps that these samples close."""
        gaps: dict[_Channel, _Gap] = {}
        for sample in samples:
            channel = sample.asset, sample.channel
            if self._first_us is not None and channel not in self._known:
                self._first_us.setdefault(channel, sample.time_us)
            last_us = self._unmarked.pop(channel, None)
            if last_us is not None:
                gaps[channel] = last_us, sample.time_us
        return _marks(gaps, now_us)

    def expect(self, ends: Mapping[_Channel, int]) -> None:
        """Mark the gap behind these last times of channels when their next samples come."""
        self._unmarked |= ends

    def forget(self, assets: Collection[str] | None) -> None:
        """Mark no gaps of these assets, or of any."""
        gone = None if assets is None else set(assets)
        self._unmarked = {
            channel: end_us
            for channel, end_us in self._unmarked.items()
            if gone is not None and channel[0] not in gone
        }


def _marks(gaps: Mapping[_Channel, _Gap], now_us: int) -> list[Sample]:
    return [
        Sample(asset, channel, last_us + 1, math.nan, Quality.OUT_OF_SERVICE, now_us)
        for (asset, channel), (last_us, first_us) in gaps.items()
        if last_us + 1 < first_us
    ]
