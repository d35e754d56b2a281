"""What a DBC file describes, and what of it really arrives on a bus."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from cantools.database.can import Message, Signal

from adapters.drivers.can.binding import bind_to
from adapters.drivers.can.bus import close_bus, open_bus
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.dbc import DbcFile, load_dbc
from adapters.protocol import ChannelBinding
from adapters.samples import Sample, is_good, meaning

RECEIVE_S: Final = 0.25  # wall; one wait for a frame
MOST_UNKNOWN: Final = 50
#: Parts the message from its signal in the names of bindings; in neither name of a DBC.
_PART: Final = "/"


@dataclass(frozen=True, slots=True)
class SignalSeen:
    """A signal of a DBC file."""

    message: str
    signal: str
    unit: str  # as the file gives it
    frames: int = 0  # how many of its frames came while one listened
    value: float | None = None  # the latest good one; None where none came
    detail: str = "no frame came"  # why there is no good value; else empty


@dataclass(frozen=True, slots=True)
class BusSeen:
    """What came while one listened to a bus; ``unknown`` are identifiers outside the DBC."""

    frames: int = 0
    signals: Sequence[SignalSeen] = ()
    unknown: Sequence[str] = ()


@dataclass(slots=True)
class _Heard:
    frames: int = 0
    by_message: dict[str, int] = field(default_factory=dict)
    latest: dict[str, Sample] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)  # why the latest is not good
    unusable: Mapping[str, str] = field(default_factory=dict)  # messages, and why
    unknown: dict[str, None] = field(default_factory=dict)


def described_signals(source: CanSource) -> list[SignalSeen]:
    """List the signals of a source's DBC file; opens no bus. Raises `ConfigurationError`."""
    file = load_dbc(source)
    return _signals(file, _Heard(unusable=_unusable(file)))


def listen(source: CanSource, listen_s: float) -> BusSeen:
    """Listen to a bus, and decode as the driver does; blocks for so many wall seconds.

    Nothing is sent, but what opening an adapter takes. Raises `ConfigurationError`: the DBC file
    cannot be used; `Exception` whatever the interface's library raises when the bus cannot be
    opened.
    """
    file = load_dbc(source)
    heard = _Heard(unusable=_unusable(file))
    messages = bind_to(file, source, _bindings(source, file, heard.unusable))
    for bound in messages.values():
        if bound.senders is not None:
            bound.senders.settle_us = 0  # what is shown here is looked at, not stored
    bus = open_bus(source)
    try:
        until = time.monotonic() + listen_s
        while (left_s := until - time.monotonic()) > 0:
            frame = bus.recv(min(RECEIVE_S, left_s))
            if frame is None or frame.is_error_frame or frame.is_remote_frame:
                continue
            heard.frames += 1
            message = messages.find(frame.arbitration_id, frame.is_extended_id)
            if message is None:
                if len(heard.unknown) < MOST_UNKNOWN:
                    heard.unknown[f"{frame.arbitration_id:X}"] = None
                continue
            name = message.message.name
            heard.by_message[name] = heard.by_message.get(name, 0) + 1
            samples = message.receive(frame.arbitration_id, frame.data, time.time_ns() // 1000)
            heard.latest |= {sample.channel: sample for sample in samples}
    finally:
        close_bus(bus)
    heard.problems = {
        one.channel: one.problem for bound in messages.values() for one in bound.signals
    }
    return BusSeen(heard.frames, _signals(file, heard), tuple(heard.unknown))


def _unusable(file: DbcFile) -> dict[str, str]:
    """Name the messages from which no value can be read, and why."""
    reasons = {one.name: file.flaw(one) or file.same_identifier(one) for one in file.messages}
    return {name: reason for name, reason in reasons.items() if reason}


def _bindings(
    source: CanSource, file: DbcFile, unusable: Mapping[str, str]
) -> list[ChannelBinding]:
    return [
        ChannelBinding(
            "",
            f"{message.name}{_PART}{signal.name}",
            CanChannel(source=source.name, message=message.name, signal=signal.name),
        )
        for message in file.messages
        if message.name not in unusable
        for signal in message.signals
    ]


def _signals(file: DbcFile, heard: _Heard) -> list[SignalSeen]:
    return [
        _seen(message, signal, heard) for message in file.messages for signal in message.signals
    ]


def _seen(message: Message, signal: Signal, heard: _Heard) -> SignalSeen:
    name = f"{message.name}{_PART}{signal.name}"
    seen = SignalSeen(
        message.name, signal.name, signal.unit or "", heard.by_message.get(message.name, 0)
    )
    if message.name in heard.unusable:
        return replace(seen, detail=heard.unusable[message.name])
    sample = heard.latest.get(name)
    if sample is None:
        return seen
    good = is_good(sample.quality)
    detail = "" if good else heard.problems[name] or meaning(sample.quality)
    return replace(seen, value=sample.value if good else None, detail=detail)
