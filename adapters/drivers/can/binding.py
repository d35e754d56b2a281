"""Which frames are decoded, and by which message of the DBC file."""

import math
from collections.abc import Mapping, Sequence

import can
from cantools.database.can import Message, Signal

from adapters.configuration import ConfigurationError, suggestion
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.dbc import (
    DbcFile,
    FrameKey,
    find_signal,
    frame_key,
    identifier,
    load_dbc,
)
from adapters.drivers.can.decoding import BoundMessage, BoundSignal, Page, SingleSignal
from adapters.drivers.can.no_value import no_value
from adapters.drivers.can.senders import ALL_IDENTIFIER_BITS, identifier_mask, senders
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.units import into_unit, units_for

MOST_FOUND = 4096  # identifiers remembered


class MessageTable:
    """The messages that must be decoded, by identifier, with the bits of it that must agree.

    ``bound`` has None for a message that no channel reads: no other message takes its frames.
    """

    def __init__(self, bound: Mapping[FrameKey, tuple[BoundMessage | None, int]]) -> None:
        self._exact = {
            key: message for key, (message, mask) in bound.items() if mask == ALL_IDENTIFIER_BITS
        }
        masked = [
            (extended, mask, frame_id & mask, message)
            for (frame_id, extended), (message, mask) in bound.items()
            if mask != ALL_IDENTIFIER_BITS
        ]
        self._masked = sorted(masked, key=lambda one: -one[1].bit_count())  # the closest fit first
        self._messages = [message for message, _ in bound.values() if message is not None]
        self._found: dict[FrameKey, BoundMessage | None] = {}

    def values(self) -> Sequence[BoundMessage]:
        """All messages."""
        return self._messages

    def find(self, frame_id: int, extended: bool) -> BoundMessage | None:
        """Message of a frame; None when nothing is bound to it."""
        key = (frame_id, extended)
        if key in self._exact or not self._masked:
            return self._exact.get(key)
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
    return bind_to(load_dbc(source), source, channels)


def bind_to(file: DbcFile, source: CanSource, channels: Sequence[ChannelBinding]) -> MessageTable:
    """Compile channels as `bind` does, with a DBC file that has been read."""
    bound: dict[FrameKey, tuple[BoundMessage, int]] = {}
    seen: set[tuple[str, str]] = set()
    rivals: dict[FrameKey, Message] = {}
    for binding in channels:
        config = binding.config
        if not isinstance(config, CanChannel):
            raise TypeError(f"{binding.asset}/{binding.channel}: expected a CanChannel")
        where = f"channel {binding.asset}/{binding.channel}"
        if (binding.asset, binding.channel) in seen:
            raise ConfigurationError(f"source {source.name!r}: {where} is bound twice")
        seen.add((binding.asset, binding.channel))
        message = file.message(config, where)
        signal = find_signal(message, config, where)
        mask = config.frame_id_mask
        if mask is None:
            others = file.others_of_group(message)
            mask = identifier_mask(message, others)
            rivals |= {frame_key(other): other for other in others}
        key = frame_key(message)
        if key not in bound:
            asked_for = config.frame_id_mask is not None
            known = BoundMessage(message, senders(message, mask, asked_for=asked_for))
            bound[key] = known, mask
        entry, known_mask = bound[key]
        if entry.message is not message:
            raise ConfigurationError(
                f"{where}: messages {entry.message.name!r} and {message.name!r} of "
                f"{file.path!r} have one identifier ({identifier(message)}), and a frame does not "
                "say which of them it is; expected channels of one of them only"
            )
        if known_mask != mask:
            raise ConfigurationError(
                f"{where}: frame_id_mask {mask:#x} differs from {known_mask:#x} of another channel "
                f"of message {message.name!r}; expected the same"
            )
        entry.signals.append(_bound_signal(binding, config, message, signal))
        if config.max_age_s is not None:
            entry.max_age_s = max(entry.max_age_s or 0.0, config.max_age_s)
    unread = {
        key: (None, identifier_mask(rival, file.others_of_group(rival)))
        for key, rival in rivals.items()
    }
    return MessageTable({**unread, **bound})


def _bound_signal(
    binding: ChannelBinding, config: CanChannel, message: Message, signal: Signal
) -> BoundSignal:
    scale = float(signal.scale)
    lowest = -math.inf if signal.minimum is None else float(signal.minimum)
    highest = math.inf if signal.maximum is None else float(signal.maximum)
    return BoundSignal(
        asset=binding.asset,
        channel=binding.channel,
        signal=SingleSignal(message, signal),
        pages=_pages(message, signal),
        scale=scale,
        offset=float(signal.offset),
        no_value=no_value(message, signal, _sentinels(binding, config, signal)),
        limits=(lowest, highest),
        # The limits of the DBC are decimal numbers, the value is computed: half a step of slack.
        slack=1e-6 * abs(scale) if signal.is_float else 0.5 * abs(scale),
        valid_range=config.valid_range,
        into_unit=_into_unit(binding, config, signal),
    )


def _into_unit(binding: ChannelBinding, config: CanChannel, signal: Signal) -> tuple[float, float]:
    """Scale and offset from the signal's unit into the channel's. Raises `ConfigurationError`."""
    unit = config.unit or signal.unit or ""
    found = into_unit(binding.unit, unit)
    if found is None:
        stated = f"unit {unit!r}" if config.unit else f"signal {signal.name!r} is in {unit!r}"
        known = units_for(binding.unit)
        where = "" if config.unit else f', or unit = "{known[0]}" where the DBC file is wrong'
        raise ConfigurationError(
            f"channel {binding.asset}/{binding.channel}: {stated}; expected "
            f"{', '.join(known)}{where}"
        )
    return found


def _sentinels(binding: ChannelBinding, config: CanChannel, signal: Signal) -> Sequence[float]:
    """The channel's sentinels. Raises `ConfigurationError` for one that can never occur."""
    lowest = -1 << (signal.length - 1) if signal.is_signed else 0
    highest = lowest + (1 << signal.length) - 1
    for sentinel in config.sentinels:
        whole = sentinel.is_integer() and lowest <= sentinel <= highest
        if not signal.is_float and not whole:
            raise ConfigurationError(
                f"channel {binding.asset}/{binding.channel}: sentinels {sentinel:g} can never "
                f"occur in signal {signal.name!r}; expected raw values, whole numbers from "
                f"{lowest} to {highest}"
            )
    return config.sentinels


def _pages(message: Message, signal: Signal) -> list[Page]:
    """The multiplexers that a signal is behind, the outermost first."""
    pages: list[Page] = []
    while signal.multiplexer_signal is not None:
        numbers = frozenset(signal.multiplexer_ids or ())
        signal = message.get_signal_by_name(signal.multiplexer_signal)
        pages.insert(0, Page(SingleSignal(message, signal), numbers))
    return pages
