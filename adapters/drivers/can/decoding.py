"""From a CAN frame to samples: the raw values of the bound signals, and what they are worth."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from cantools.database.can import Message, Signal

from adapters.drivers.can.no_value import NoValue
from adapters.drivers.can.senders import Senders
from adapters.samples import Quality, Sample, is_bad, is_good, next_time_us

DEFAULT_PERIOD_S = 1.0  # of a message whose period is neither in the DBC nor seen yet
PERIODS_UNTIL_STALE = 3.0
TIGHTEST_AGE_WALL_S = 1.5

Bytes = bytes | bytearray


class SingleSignal:
    """One signal of a message, decoded alone.

    What lies beside it does not matter: neither other signals nor the length of the frame, as long
    as the signal lies whole in it.
    """

    def __init__(self, message: Message, signal: Signal) -> None:
        self.name = signal.name
        self._of, self._signal = message, signal

    @cached_property
    def _message(self) -> Message:
        """A message of nothing else; made for the first frame, most of a file never has one."""
        message, alone = self._of, copy.copy(self._signal)
        alone.is_multiplexer, alone.multiplexer_ids, alone.multiplexer_signal = False, None, None
        return Message(
            message.frame_id,
            message.name,
            message.length,
            [alone],
            is_extended_frame=message.is_extended_frame,
            strict=False,
        )

    def raw(self, data: Bytes) -> float | None:
        """Return the raw value; None when the signal does not lie whole in the data."""
        raws = self._message.decode_simple(
            bytes(data), decode_choices=False, scaling=False, allow_truncated=True
        )
        raw = raws.get(self.name)
        return raw if isinstance(raw, int | float) else None


@dataclass(frozen=True, slots=True)
class Page:
    """A multiplexer, and those of its values with which a signal is in the frame."""

    multiplexer: SingleSignal
    numbers: frozenset[int]


@dataclass(slots=True)
class BoundSignal:
    """A channel's signal, compiled for judging its raw value.

    ``problem`` says for people why the latest value is not good.
    """

    asset: str
    channel: str
    signal: SingleSignal
    pages: Sequence[Page]  # from the outermost multiplexer inwards; none for a signal always there
    scale: float
    offset: float
    no_value: NoValue
    limits: tuple[float, float]  # of the DBC file; infinite: none
    slack: float  # by which a value may be outside of them
    valid_range: tuple[float, float] | None
    into_unit: tuple[float, float] = (1.0, 0.0)  # scale and offset into the channel's unit
    problem: str = ""

    @property
    def label(self) -> str:
        """The channel's full name for messages."""
        return f"{self.asset}/{self.channel}"

    def judge(self, raw: float, is_blank: bool = False) -> tuple[float, Quality, str]:
        """Return value (NaN when bad), quality and kind of error (empty when good)."""
        code = self.no_value.meaning(raw, is_blank)
        if code:
            return self._bad("not_available", f"no value (raw value {raw:g}: {code})")
        value = raw * self.scale + self.offset
        if not math.isfinite(value):
            return self._bad("not_a_number", "not a number")
        lowest, highest = self.limits
        if not lowest - self.slack <= value <= highest + self.slack:
            said = f"{value:g} is outside of the DBC file's limits [{lowest:g}, {highest:g}]"
            return self._bad("outside_dbc_limits", said)
        value = value * self.into_unit[0] + self.into_unit[1]
        if self.valid_range and not self.valid_range[0] <= value <= self.valid_range[1]:
            lowest, highest = self.valid_range
            self.problem = f"{value:g} is outside of valid_range [{lowest:g}, {highest:g}]"
            return value, Quality.EU_EXCEEDED, "valid_range"
        self.problem = ""
        return value, Quality.GOOD, ""

    def _bad(self, kind: str, problem: str) -> tuple[float, Quality, str]:
        self.problem = problem
        return math.nan, Quality.SENSOR_FAILURE, kind


@dataclass(slots=True)
class BoundMessage:
    """A message with the channels bound to it, and what was seen of it."""

    message: Message
    senders: Senders | None = None
    signals: list[BoundSignal] = field(default_factory=list)
    max_age_s: float | None = None
    last_time_us: int = 0
    last_frame_us: int = 0
    last_good_us: int = 0
    period_us: float = 0.0
    errors: list[str] = field(default_factory=list)  # kinds of the latest frame

    def receive(self, frame_id: int, data: Bytes, now_us: int) -> list[Sample]:
        """Decode one frame unless it is another sender's; doubted while that is not known."""
        best = Quality.GOOD if self.senders is None else self.senders.judge(frame_id, now_us)
        if best is None:
            self.errors[:] = ["other_sender"]
            return []
        return self.decode(data, now_us, best)

    def decode(self, data: Bytes, now_us: int, best: Quality = Quality.GOOD) -> list[Sample]:
        """Decode one frame; a signal of another multiplexer page gives no sample."""
        self.errors.clear()
        self._note_period(now_us)
        time_us = self._next_time(now_us)
        is_blank = data.count(0xFF) == len(data)
        numbers: dict[str, float | None] = {}
        samples = []
        for signal in self.signals:
            is_there = _is_there(signal, data, numbers)
            if is_there is False:
                continue
            raw = signal.signal.raw(data) if is_there else None
            if raw is None:
                value, quality, error = math.nan, Quality.COMM_FAILURE, "wrong_length"
                signal.problem = f"not in a frame of {len(data)} bytes"
            else:
                value, quality, error = signal.judge(raw, is_blank)
            if error:
                self.errors.append(error)
            elif best != Quality.GOOD:
                value, quality = math.nan if is_bad(best) else value, best
                signal.problem = "" if self.senders is None else self.senders.note()
            if is_good(quality):
                self.last_good_us = time_us
            samples.append(
                Sample(signal.asset, signal.channel, time_us, value, int(quality), time_us)
            )
        return samples

    def bad_samples(self, now_us: int) -> list[Sample]:
        """One bad sample per channel: the bus is lost."""
        time_us = self._next_time(now_us)
        quality = int(Quality.COMM_FAILURE)
        for signal in self.signals:
            signal.problem = ""  # the source says what is wrong
        return [
            Sample(signal.asset, signal.channel, time_us, math.nan, quality, time_us)
            for signal in self.signals
        ]

    def age_limit_us(self, rate: float) -> float:
        """Process microseconds without a frame after which the message counts as stale."""
        period_s = max(self.period_us / 1e6, (self.message.cycle_time or 0) / 1e3)
        age_s = self.max_age_s or PERIODS_UNTIL_STALE * (period_s or DEFAULT_PERIOD_S)
        return 1e6 * max(age_s, TIGHTEST_AGE_WALL_S * rate)

    def _note_period(self, now_us: int) -> None:
        if self.last_frame_us:
            elapsed_us = now_us - self.last_frame_us
            if self.period_us <= 0.0:
                self.period_us = elapsed_us
            elif 0 < elapsed_us < 10.0 * self.period_us:  # a gap says nothing about the period
                self.period_us += 0.05 * (elapsed_us - self.period_us)
        self.last_frame_us = now_us

    def _next_time(self, now_us: int) -> int:
        self.last_time_us = next_time_us(self.last_time_us, now_us)
        return self.last_time_us


def _is_there(signal: BoundSignal, data: Bytes, numbers: dict[str, float | None]) -> bool | None:
    """Whether a frame has the signal's page; None when it is too short to have its number."""
    for page in signal.pages:
        name = page.multiplexer.name
        if name not in numbers:
            numbers[name] = page.multiplexer.raw(data)
        number = numbers[name]
        if number is None:
            return None
        if number not in page.numbers:
            return False
    return True
