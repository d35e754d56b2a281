"""InfluxDB's line protocol: the measurement is the asset, each field a channel.

``bench-1,host=gateway t_inner_ring_c=63.4,speed_rpm=3000 1764144000000000000``

Tags are ignored. A line without a time is of the moment of the push.
"""

from collections.abc import Iterator
from typing import Any, Final

from line_protocol_parser import LineFormatError, parse_line

from adapters.samples import Quality, Sample
from adapters.words import shown
from service.domain.times import LATEST_US
from service.features.gateways.judging import Channels, JudgedPush, unknown_asset
from service.web.api.problems import Problem
from service.web.api.pushes import Judge, finite_number, pushed_channel

#: Nanoseconds of a unit of time, by the names that InfluxDB's versions 1 and 2 give it.
PRECISIONS: Final = {
    "ns": 1,
    "n": 1,
    "us": 10**3,
    "u": 10**3,
    "ms": 10**6,
    "s": 10**9,
    "m": 60 * 10**9,
    "h": 3600 * 10**9,
}


def judge_lines(
    text: str, unit_ns: int, channels_of: Channels, judge: Judge, most: int
) -> tuple[JudgedPush, list[int]]:
    """Judge each field of each line; also gives the number of the line of each field.

    Fields count from 0, lines from 1. A line that cannot be read counts as one field. Raises
    `Problem` where there are more than ``most`` fields.
    """
    push, line_of = JudgedPush(), list[int]()
    for number, line in enumerate(text.split("\n"), 1):
        for make in _fields(line.removesuffix("\r"), unit_ns, channels_of, judge):
            if len(line_of) == most:
                raise Problem(413, f"line {number}: expected at most {most} fields in one push")
            push.take(len(line_of), make)
            line_of.append(number)
    push.pack()
    return push, line_of


def _fields(line: str, unit_ns: int, channels_of: Channels, judge: Judge) -> Iterator[Any]:
    try:
        # It gives None for a comment and an empty line.
        read = parse_line(line) if line.strip() else None
    except LineFormatError as error:
        wrong = ValueError(str(error).rstrip("."))
        yield lambda: _fail(wrong)
        return
    if read is None:
        return
    asset, time = read["measurement"], read["time"]
    channels = channels_of(asset)
    if channels is None:
        yield lambda: _fail(unknown_asset(asset))
        return
    time_us = judge.now_us if time is None else time * unit_ns // 1000

    def make(channel: str, raw: Any) -> Sample:
        pushed_channel(channel, channels)
        value = finite_number(raw)
        if value is None:
            raise ValueError("value: expected a number")
        if not 0 <= time_us < LATEST_US:
            raise ValueError(f"time {shown(time)}: expected a time from 1970 to 2999")
        sample = Sample(asset, channel, time_us, value, int(Quality.GOOD), judge.now_us)
        return judge.in_time(sample, time)

    for channel, raw in read["fields"].items():
        yield lambda channel=channel, raw=raw: make(channel, raw)


def _fail(error: ValueError) -> Sample:
    raise error
