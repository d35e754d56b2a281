"""Samples of many assets, each judged separately."""

import math
from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from adapters.samples import Quality, Sample
from adapters.words import shown
from service.bus.pushed_samples import PushColumns, PushedSamples
from service.documents.measurements import Rejected
from service.domain.requests import PUSH_SOURCE
from service.web.api.pushes import Judge, TooOldError, reject

Channels = Callable[[str], Mapping[str, str] | None]
"""Gives the channels of an asset with their sources; None where it is not followed."""


class JudgedPush:
    """What of a push can be stored, and what is wrong with the rest.

    - ``samples``, ``too_old``: good ones, and those that are only wrong by their time.
    - ``rejected``: index of each of the others, and why.
    - ``places``: index of each good one.
    - ``packed``: both as the cell takes them, once `pack` has written them.
    """

    packed: tuple[PushedSamples, PushedSamples]

    def __init__(self) -> None:
        self.samples = PushColumns()
        self.too_old = PushColumns()
        self.rejected: list[Rejected] = []
        self.places = array("I")
        self._left = 0

    def take(self, index: int, make: Callable[[], Sample]) -> None:
        """Judge one sample; ``make`` raises `ValueError` where it is wrong."""
        try:
            sample = make()
        except ValueError as error:
            if isinstance(error, TooOldError):
                self.too_old.add(error.sample)
            reject(self.rejected, index, error)
        else:
            self.samples.add(sample)
            self.places.append(index)

    @property
    def count(self) -> int:
        """How many can be stored."""
        return len(self.places) - self._left

    def pack(self) -> None:
        """Write what the cell is to take."""
        self.packed = self.samples.packed(), self.too_old.packed()

    def leave(self, assets: Collection[str]) -> None:
        """Reject the samples of assets that are followed no longer."""
        names = self.samples.names
        for index, line in zip(self.places, self.samples.line, strict=True):
            if names[line][0] in assets:
                self._left += 1
                reject(self.rejected, index, unknown_asset(names[line][0]))
        self.rejected.sort(key=lambda one: one.index)


def unknown_asset(name: object) -> ValueError:
    """Make the error of an asset that is not followed."""
    return ValueError(f"asset {shown(name)}: not followed here, expected the id of an asset")


class _Pushed(dict[str, Collection[str]]):
    """The pushed channels of each asset, read when they are asked for first."""

    def __init__(self, channels_of: Channels) -> None:
        self._channels_of = channels_of

    def __missing__(self, asset: str) -> Collection[str]:
        channels = self._channels_of(asset)
        if channels is None:
            raise KeyError(asset)
        self[asset] = pushed = {name for name in channels if channels[name] == PUSH_SOURCE}
        return pushed


class _Times(dict[str, int]):
    """Times that can be taken, in UTC microseconds, each read when it is asked for first."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def __missing__(self, time: str) -> int:
        time_us = self._judge.time_us(time)
        if not self._judge.takes(time_us):
            raise KeyError(time)
        self[time] = time_us
        return time_us


def judge_rows(rows: Sequence[Any], channels_of: Channels, judge: Judge) -> JudgedPush:
    """Judge samples as JSON has them.

    What is nearly always right is seen at once: a number with a good quality, of a channel and a
    time that can be taken. `Judge` decides about all others.
    """
    push = JudgedPush()
    columns, good = push.samples, int(Quality.GOOD)
    pushed, times_us = _Pushed(channels_of), _Times(judge)
    infinite, longest = math.inf, 2**53

    def make(row: Any) -> Sample:
        if not isinstance(row, dict):
            raise ValueError('expected {"asset", "channel", "time", "value", "quality"?}')
        asset = row.get("asset")
        channels = channels_of(asset) if isinstance(asset, str) else None
        if not isinstance(asset, str) or channels is None:
            raise unknown_asset(asset)
        return judge.sample(row, asset, channels)

    for index, row in enumerate(rows):
        try:
            asset, channel, value = row["asset"], row["channel"], row["value"]
            quality, kind = row.get("quality", good), type(value)
            known = (
                (kind is float or (kind is int and -longest < value < longest))
                and -infinite < value < infinite
                and (type(quality) is int and good <= quality <= 255)
                and channel in pushed[asset]
            )
            time_us = times_us[row["time"]]
        except (KeyError, TypeError, ValueError):  # not what is expected
            known = False
        if known:
            columns.append(asset, channel, time_us, value, quality)
            push.places.append(index)
        else:
            push.take(index, partial(make, row))
    push.pack()
    return push
