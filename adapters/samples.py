"""What every driver hands over: samples with their quality, and the controller's plan ahead."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import NamedTuple


class Quality(IntEnum):
    """OPC DA byte of one sample: below 64 is bad, 64 to 191 uncertain, 192 and above good."""

    BAD = 0
    CONFIG_ERROR = 4
    NOT_CONNECTED = 8
    DEVICE_FAILURE = 12
    SENSOR_FAILURE = 16
    LAST_KNOWN = 20
    COMM_FAILURE = 24
    OUT_OF_SERVICE = 28
    WAITING_FOR_INITIAL_DATA = 32
    UNCERTAIN = 64
    LAST_USABLE = 68
    SENSOR_NOT_ACCURATE = 80
    FROZEN = 83  # sensor not accurate, with the limit bits of a constant
    EU_EXCEEDED = 84
    SUB_NORMAL = 88
    GOOD = 192
    LOCAL_OVERRIDE = 216


_MEANINGS: dict[int, str] = {
    Quality.BAD: "no usable value",
    Quality.CONFIG_ERROR: "the device does not know this channel",
    Quality.NOT_CONNECTED: "not connected",
    Quality.DEVICE_FAILURE: "device failure",
    Quality.SENSOR_FAILURE: "sensor failure",
    Quality.LAST_KNOWN: "stale: no new value",
    Quality.COMM_FAILURE: "communication failure",
    Quality.OUT_OF_SERVICE: "nothing was recorded",
    Quality.WAITING_FOR_INITIAL_DATA: "no value yet",
    Quality.UNCERTAIN: "uncertain",
    Quality.LAST_USABLE: "device busy, last value kept",
    Quality.SENSOR_NOT_ACCURATE: "sensor not accurate",
    Quality.FROZEN: "frozen value",
    Quality.EU_EXCEEDED: "outside the valid range",
    Quality.SUB_NORMAL: "sub-normal",
}


def meaning(quality: int) -> str:
    """Say in words what a quality byte means; empty when it is good."""
    if is_good(quality):
        return ""
    return _MEANINGS.get(quality) or ("bad" if is_bad(quality) else "uncertain")


def is_good(quality: int) -> bool:
    """Whether a value of this quality may be used without reserve."""
    return quality >= 192


def is_bad(quality: int) -> bool:
    """Whether a value of this quality must not be used at all."""
    return quality < 64


class Sample(NamedTuple):
    """One value of one channel."""

    asset: str
    channel: str
    time_us: int  # process time at which the value was valid, microseconds since the epoch (UTC)
    value: float  # in the channel's unit; NaN when the quality is bad
    quality: int  # OPC DA byte, see `Quality`
    received_us: int  # process time at which the service received it


make_sample: Callable[[tuple[str, str, int, float, int, int]], Sample]
make_sample = partial(tuple.__new__, Sample)
"""A sample of its attributes in order, at half the price; for loops that make very many."""


def next_time_us(last_us: int, now_us: int) -> int:
    """Time stamp for a channel's next sample: now, but never the last one's again.

    When the clock was set back by more than a second it is followed all the same; anything else
    would stamp an hour of data with one and the same moment.
    """
    if last_us - 1_000_000 <= now_us <= last_us:
        return last_us + 1
    return now_us


class PlanStep(NamedTuple):
    """One step of a planned profile: for so long at this speed and radial load."""

    duration_s: float
    speed_rpm: float
    load_n: float


@dataclass(frozen=True, slots=True)
class PlannedProfile:
    """The controller's plan ahead, as read at `time_us` (process time).

    `steps[0]` is what is left of the present step; no steps mean that nothing is planned.
    """

    asset: str
    time_us: int
    steps: tuple[PlanStep, ...]


@dataclass(frozen=True, slots=True)
class Batch:
    """What one driver hands over at once.

    `poll_s` is how long the poll behind it took in wall seconds; None for a listening driver.
    """

    samples: list[Sample] = field(default_factory=list)
    plans: list[PlannedProfile] = field(default_factory=list)
    poll_s: float | None = None
