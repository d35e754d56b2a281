"""From what an OPC UA server says of a value to our samples."""

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NamedTuple

from adapters.drivers.opcua.codes import has_overflown, quality_of
from adapters.drivers.opcua.config import OpcUaChannel
from adapters.samples import Quality, is_bad, is_good
from adapters.times import SOURCE_AHEAD_S, clock_ahead, source_limit_us

OLD_US = 30_000_000  # an older source time says nothing of the present clock
STANDS = "source time stands still while the value changes"
_EARLIEST_US = 946_684_800_000_000  # the year 2000; before it no clock has been set


class NodeReading(NamedTuple):
    """A value of a node.

    `kind` and `reason` say what is wrong with it, for counting and for people; empty when it is
    good. `overflown` means that the server lost values before it. `source_us` is the time that its
    source gave; `ahead_s` is how far it lies ahead of ours, where it is too far. `said` is value
    and status as the server has them, whatever unit they are in.
    """

    time_us: int
    value: float
    quality: int
    kind: str
    reason: str
    overflown: bool
    said: tuple[object, int]
    source_us: int | None = None
    ahead_s: float = 0.0


@dataclass(slots=True)
class FollowedNode:
    """A channel with its standing. Times are process time in microseconds."""

    asset: str
    channel: str
    config: OpcUaChannel
    last_us: int = 0  # of the latest sample
    source_us: int = 0  # of the latest reading, as it is dated here
    ahead_us: int = 0  # of the latest reading whose source is ahead, as that gave it
    latest: tuple[object, int] | None = None  # value and status of the latest reading
    #: The value or its quality changed, and their time did not: no time says when.
    stands: bool = False
    heard_us: int = 0  # when that was handed over
    lost_at_us: int = 0  # latest sample before a loss that has not been filled in
    gaps: list[tuple[int, int]] = field(default_factory=list)
    problem: str = ""
    ahead_s: float = 0.0
    history_problem: str = ""
    quiet_until: float = 0.0  # wall (monotonic) time before which no further line is logged
    unit: str = ""  # of the channel
    doubt: str = ""  # why no value of it is good, whatever its server says

    @property
    def label(self) -> str:
        """The channel's full name for messages."""
        return f"{self.asset}/{self.channel}"

    def read(self, found: Any, now_us: int, rate: float) -> NodeReading:
        """Make a reading of a data value of the node."""
        reading = reading_of(found, self.config, now_us, rate)
        if self.doubt and is_good(reading.quality):
            uncertain = int(Quality.UNCERTAIN)
            return reading._replace(quality=uncertain, kind="unit", reason=self.doubt)
        return reading


def _with_its_clock(reading: NodeReading, point: FollowedNode, now_us: int) -> NodeReading:
    """Say by how much the clock of a source is ahead: while a value stands, its time does, too."""
    is_known = point.ahead_s > 0.0 and reading.source_us is not None
    if is_known and reading.source_us == point.ahead_us:
        time_us = reading.time_us if reading.ahead_s else now_us
        reading = reading._replace(time_us=time_us, ahead_s=point.ahead_s)
    elif is_known and (reading.source_us or 0) < now_us - OLD_US:
        reading = reading._replace(ahead_s=point.ahead_s)  # by the same clock, some time ago
    elif is_known and abs(reading.ahead_s - point.ahead_s) <= SOURCE_AHEAD_S:
        reading = reading._replace(ahead_s=point.ahead_s)  # the same text from now on
    point.ahead_s, point.ahead_us = reading.ahead_s, reading.source_us or 0
    if reading.ahead_s and (is_good(reading.quality) or reading.kind == "time"):
        uncertain, reason = int(Quality.UNCERTAIN), clock_ahead(reading.ahead_s)
        reading = reading._replace(quality=uncertain, kind="time", reason=reason)
    return reading


def compared(reading: NodeReading, point: FollowedNode, now_us: int) -> tuple[NodeReading, bool]:
    """Compare a reading with the one before, and remember it.

    Returns the reading, which is uncertain while its time stands still though the value or its
    quality changed; and whether it is the same one sent again.
    """
    reading = _with_its_clock(reading, point, now_us)
    is_same_time, is_same = reading.time_us == point.source_us, reading.said == point.latest
    point.stands = is_same_time and (point.stands or not is_same)
    point.source_us, point.latest = reading.time_us, reading.said
    if point.stands and is_good(reading.quality):
        reading = reading._replace(quality=int(Quality.UNCERTAIN), kind="time", reason=STANDS)
    return reading, is_same_time and is_same


def code_of(found: Any) -> int:
    """Status code of a data value; without one it is good."""
    return 0 if found.StatusCode is None else int(found.StatusCode.value)


def reading_of(found: Any, config: OpcUaChannel, now_us: int, rate: float = 1.0) -> NodeReading:
    """Turn a data value into a reading; never good unless it is in every respect."""
    code = code_of(found)
    quality = quality_of(code)
    kind, reason, value = "", "", math.nan
    if is_bad(quality):
        kind, reason = "status", f"server says {_name(found)}"
    else:
        value, reason = _number(found, config)
        if reason:
            kind, quality = "no_number", _quality_of_nothing(reason)
        elif config.valid_range and not config.valid_range[0] <= value <= config.valid_range[1]:
            kind, quality = "valid_range", int(Quality.EU_EXCEEDED)
            reason = f"outside the valid range {list(config.valid_range)}"
        elif not is_good(quality):
            kind, reason = "status", f"server says {_name(found)}"
    time_us = source_us = microseconds(found.SourceTimestamp)
    limit_us, ahead_s = source_limit_us(now_us, rate), 0.0
    if time_us is None or time_us > limit_us:
        ahead_s = 0.0 if time_us is None else (time_us - now_us) / 1e6
        server_us = microseconds(found.ServerTimestamp)
        trusted = server_us is not None and server_us <= limit_us
        time_us = server_us if server_us is not None and trusted else now_us
        if is_good(quality):
            quality, kind = int(Quality.UNCERTAIN), "time"
            reason = clock_ahead(ahead_s) if ahead_s else "no source time"
    said = _raw(found), quality_of(code)
    return NodeReading(
        time_us, value, quality, kind, reason, has_overflown(code), said, source_us, ahead_s
    )


def _raw(found: Any) -> object:
    """The value of a node as something that can be compared."""
    value = found.Value.Value if found.Value is not None else None
    is_number = isinstance(value, int | float) and value == value
    return value if is_number else type(value).__name__


def microseconds(moment: datetime | None) -> int | None:
    """Microseconds since the epoch of an OPC UA time; None where a clock has never been set."""
    if moment is None:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    past = moment - datetime(1970, 1, 1, tzinfo=UTC)
    time_us = (past.days * 86400 + past.seconds) * 1_000_000 + past.microseconds
    return time_us if time_us >= _EARLIEST_US else None


def moment_of(time_us: int) -> datetime:
    """UTC time of microseconds since the epoch."""
    whole_s, rest_us = divmod(time_us, 1_000_000)
    return datetime.fromtimestamp(whole_s, UTC).replace(microsecond=rest_us)


def _number(found: Any, config: OpcUaChannel) -> tuple[float, str]:
    raw = found.Value.Value if found.Value is not None else None
    if raw is None:
        return math.nan, "no value"
    if not isinstance(raw, bool | int | float):
        what = "an array" if isinstance(raw, list | tuple) else f"a {type(raw).__name__}"
        return math.nan, f"node holds {what}, expected a number"
    value = float(raw) * config.scale + config.offset
    return (value, "") if math.isfinite(value) else (math.nan, "not a number")


def _quality_of_nothing(reason: str) -> int:
    wrong_type = reason.startswith("node holds")
    return int(Quality.CONFIG_ERROR if wrong_type else Quality.SENSOR_FAILURE)


def _name(found: Any) -> str:
    name = getattr(found.StatusCode, "name", "")
    return name or f"status 0x{int(found.StatusCode.value):08X}"
