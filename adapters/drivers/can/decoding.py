"""From CAN frames to samples by a DBC file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import can
import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.errors import Error as CantoolsError

from adapters.configuration import ConfigurationError, suggestion
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.samples import Quality, Sample, is_good, next_time_us

FrameKey = tuple[int, bool]  # identifier, extended or not

ALL_IDENTIFIER_BITS = 0x1FFFFFFF
# J1939-21: priority (3 bits), data pages (2), format (8), specific (8), sender (8). From format F0
# on the specific byte belongs to the parameter group number, below it is the addressee.
FIRST_J1939_BROADCAST_FORMAT = 0xF0
J1939_BROADCAST_MASK = 0x03FFFF00
J1939_ADDRESSED_MASK = 0x03FF0000
MOST_FOUND = 4096  # identifiers remembered

DEFAULT_PERIOD_S = 1.0  # of a message whose period is neither in the DBC nor seen yet
PERIODS_UNTIL_STALE = 3.0
TIGHTEST_AGE_WALL_S = 1.5
SHORTEST_FLAGGED_BITS = 8  # all ones in a shorter field is an ordinary value outside J1939
LARGEST_VALID_J1939_BYTE = 0xFA  # top byte: FB to FD special, FE error, FF not available


@dataclass(slots=True)
class BoundSignal:
    """A channel's signal, compiled for judging its raw value."""

    asset: str
    channel: str
    name: str
    scale: float
    offset: float
    not_available: float  # raw values from here on mean "no value"; infinite when none does
    lowest: float
    highest: float
    valid_range: tuple[float, float] | None

    def judge(self, raw: float) -> tuple[float, Quality, str]:
        """Return value (NaN when bad), quality and kind of error (empty when good)."""
        value = raw * self.scale + self.offset
        if not math.isfinite(value):
            return math.nan, Quality.SENSOR_FAILURE, "not_a_number"
        if raw >= self.not_available:
            return math.nan, Quality.SENSOR_FAILURE, "not_available"
        if not self.lowest <= value <= self.highest:
            return math.nan, Quality.SENSOR_FAILURE, "outside_dbc_limits"
        if self.valid_range and not self.valid_range[0] <= value <= self.valid_range[1]:
            return value, Quality.EU_EXCEEDED, "valid_range"
        return value, Quality.GOOD, ""


@dataclass(slots=True)
class BoundMessage:
    """A message with the channels bound to it, and what was seen of it."""

    message: Message
    signals: list[BoundSignal]
    max_age_s: float | None
    last_time_us: int = 0
    last_frame_us: int = 0
    last_good_us: int = 0
    period_us: float = 0.0
    errors: list[str] = field(default_factory=list)  # kinds of the latest frame

    def decode(self, data: bytes | bytearray, now_us: int) -> list[Sample]:
        """Decode one frame; a signal of another multiplexer page gives no sample."""
        self.errors.clear()
        if self.last_frame_us:
            elapsed_us = now_us - self.last_frame_us
            if self.period_us <= 0.0:
                self.period_us = elapsed_us
            elif 0 < elapsed_us < 10.0 * self.period_us:  # a gap says nothing about the period
                self.period_us += 0.05 * (elapsed_us - self.period_us)
        self.last_frame_us = now_us
        if len(data) != self.message.length:
            self.errors.append("wrong_length")
            return self.bad_samples(now_us)
        try:
            raws = self.message.decode(bytes(data), decode_choices=False, scaling=False)
        except CantoolsError:
            self.errors.append("decode")
            return self.bad_samples(now_us)
        time_us = self._next_time(now_us)
        samples = []
        for signal in self.signals:
            raw = raws.get(signal.name) if isinstance(raws, dict) else None
            if not isinstance(raw, int | float):
                continue
            value, quality, error = signal.judge(raw)
            if error:
                self.errors.append(error)
            if is_good(quality):
                self.last_good_us = time_us
            samples.append(
                Sample(signal.asset, signal.channel, time_us, value, int(quality), time_us)
            )
        return samples

    def bad_samples(self, now_us: int) -> list[Sample]:
        """One bad sample per channel: the frame was unusable or the bus is lost."""
        time_us = self._next_time(now_us)
        quality = int(Quality.COMM_FAILURE)
        return [
            Sample(signal.asset, signal.channel, time_us, math.nan, quality, time_us)
            for signal in self.signals
        ]

    def age_limit_us(self, rate: float) -> float:
        """Process microseconds without a frame after which the message counts as stale."""
        period_s = max(self.period_us / 1e6, (self.message.cycle_time or 0) / 1e3)
        age_s = self.max_age_s or PERIODS_UNTIL_STALE * (period_s or DEFAULT_PERIOD_S)
        return 1e6 * max(age_s, TIGHTEST_AGE_WALL_S * rate)

    def _next_time(self, now_us: int) -> int:
        self.last_time_us = next_time_us(self.last_time_us, now_us)
        return self.last_time_us


class MessageTable:
    """The messages that must be decoded, by identifier, with the bits of it that must agree."""

    def __init__(self, bound: Mapping[FrameKey, tuple[BoundMessage, int]]) -> None:
        self._exact = {
            key: message for key, (message, mask) in bound.items() if mask == ALL_IDENTIFIER_BITS
        }
        self._masked = [
            (extended, mask, frame_id & mask, message)
            for (frame_id, extended), (message, mask) in bound.items()
            if mask != ALL_IDENTIFIER_BITS
        ]
        self._messages = [message for message, _ in bound.values()]
        self._found: dict[FrameKey, BoundMessage | None] = {}

    def values(self) -> Sequence[BoundMessage]:
        """All messages."""
        return self._messages

    def find(self, frame_id: int, extended: bool) -> BoundMessage | None:
        """Message of a frame; None when nothing is bound to it."""
        key = (frame_id, extended)
        exact = self._exact.get(key)
        if exact is not None or not self._masked:
            return exact
        try:
            return self._found[key]
        except KeyError:
            pass
        found = next(
            (
                message
                for of_extended, mask, wanted, message in self._masked
                if of_extended == extended and frame_id & mask == wanted
            ),
            None,
        )
        if len(self._found) < MOST_FOUND:
            self._found[key] = found
        return found


def check(
    source: CanSource, channels: Sequence[ChannelBinding], plans: Sequence[PlanBinding]
) -> None:
    """Check a CAN source with everything bound to it; reads the DBC, opens no bus.

    Raises `ConfigurationError`, also for a plan, which CAN cannot carry.
    """
    if source.interface not in can.VALID_INTERFACES:
        raise ConfigurationError(
            f"source {source.name!r}: interface {source.interface!r} is unknown to python-can; "
            + suggestion(source.interface, can.VALID_INTERFACES)
        )
    if plans:
        raise ConfigurationError(
            f"plan of {plans[0].asset}: source {source.name!r} is a CAN bus, "
            "a plan needs a Modbus source"
        )
    bind(source, channels)


def bind(source: CanSource, channels: Sequence[ChannelBinding]) -> MessageTable:
    """Compile the channels of a source into the messages to decode. Raises `ConfigurationError`."""
    database = load_dbc(source)
    bound: dict[FrameKey, tuple[BoundMessage, int]] = {}
    seen: set[tuple[str, str]] = set()
    for binding in channels:
        config = binding.config
        if not isinstance(config, CanChannel):
            raise TypeError(f"{binding.asset}/{binding.channel}: expected a CanChannel")
        where = f"channel {binding.asset}/{binding.channel}"
        if (binding.asset, binding.channel) in seen:
            raise ConfigurationError(f"source {source.name!r}: {where} is bound twice")
        seen.add((binding.asset, binding.channel))
        message = _message(database, config, where, source.dbc)
        signal = _signal(message, config, where)
        key = (message.frame_id, message.is_extended_frame)
        mask = _identifier_mask(message) if config.frame_id_mask is None else config.frame_id_mask
        entry, known_mask = bound.setdefault(key, (BoundMessage(message, [], None), mask))
        if known_mask != mask:
            raise ConfigurationError(
                f"{where}: frame_id_mask {mask:#x} differs from {known_mask:#x} of another channel "
                f"of message {message.name!r}; expected the same"
            )
        entry.signals.append(_bound_signal(binding, config, message, signal))
        if config.max_age_s is not None:
            entry.max_age_s = max(entry.max_age_s or 0.0, config.max_age_s)
    return MessageTable(bound)


def load_dbc(source: CanSource) -> Database:
    """Read the source's DBC file. Raises `ConfigurationError` if it cannot be read or is none."""
    where = f"source {source.name!r}: dbc {str(source.dbc)!r}"
    try:
        database = cantools.database.load_file(source.dbc, database_format="dbc")
    except OSError as error:
        raise ConfigurationError(f"{where} cannot be read: {error.strerror or error}") from None
    except (CantoolsError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ConfigurationError(f"{where} is not a valid DBC file: {reason}") from None
    if not isinstance(database, Database):
        raise ConfigurationError(f"{where} is not a CAN database")
    return database


def _message(database: Database, config: CanChannel, where: str, dbc: Path) -> Message:
    for message in database.messages:
        if message.name == config.message:
            return message
    names = [message.name for message in database.messages]
    raise ConfigurationError(
        f"{where}: message {config.message!r} is not in {str(dbc)!r}; "
        + suggestion(config.message, names)
    )


def _signal(message: Message, config: CanChannel, where: str) -> Signal:
    for signal in message.signals:
        if signal.name == config.signal:
            return signal
    names = [signal.name for signal in message.signals]
    raise ConfigurationError(
        f"{where}: signal {config.signal!r} is not in message {message.name!r}; "
        + suggestion(config.signal, names)
    )


def _bound_signal(
    binding: ChannelBinding, config: CanChannel, message: Message, signal: Signal
) -> BoundSignal:
    scale, offset = float(signal.scale), float(signal.offset)
    # The limits of the DBC are decimal numbers, the value is computed: half a step of slack.
    slack = 1e-6 * abs(scale) if signal.is_float else 0.5 * abs(scale)
    lowest = -math.inf if signal.minimum is None else float(signal.minimum) - slack
    highest = math.inf if signal.maximum is None else float(signal.maximum) + slack
    return BoundSignal(
        asset=binding.asset,
        channel=binding.channel,
        name=signal.name,
        scale=scale,
        offset=offset,
        not_available=_not_available(message, signal),
        lowest=lowest,
        highest=highest,
        valid_range=config.valid_range,
    )


def _identifier_mask(message: Message) -> int:
    """Bits of the identifier that name a message: for J1939 neither priority nor sender."""
    if message.protocol != "j1939" or not message.is_extended_frame:
        return ALL_IDENTIFIER_BITS
    to_all = (message.frame_id >> 16 & 0xFF) >= FIRST_J1939_BROADCAST_FORMAT
    return J1939_BROADCAST_MASK if to_all else J1939_ADDRESSED_MASK


def _not_available(message: Message, signal: Signal) -> float:
    """Lowest raw value that means "no value": J1939's codes, elsewhere all ones only."""
    if signal.is_float or signal.is_signed:
        return math.inf
    all_ones = (1 << signal.length) - 1
    if message.protocol == "j1939":
        if signal.length in (8, 16, 32):
            return (LARGEST_VALID_J1939_BYTE + 1) << (signal.length - 8)
        return all_ones if signal.length > 1 else math.inf
    return all_ones if signal.length >= SHORTEST_FLAGGED_BITS else math.inf
