"""What goes over the bus: changes, commands and their answers, in MessagePack.

Every message is a `msgspec.Struct` that is written as an array: a field more at its end, with a
default, can be read by an older process and the other way round.
"""

from typing import Any, Generic, TypeVar

import msgspec

AnswerT = TypeVar("AnswerT")


class Change(msgspec.Struct, frozen=True, array_like=True):
    """One change that the cell reports.

    Attributes
    ----------
    epoch
        Names this start of the cell; numbers of different epochs do not compare.
    number
        Counted from 1 for each topic: a reader sees by it what it has missed.
    body
        What has changed, as the topic defines it.
    """

    epoch: str
    number: int
    body: bytes


class Command(msgspec.Struct, Generic[AnswerT], frozen=True, array_like=True):
    """Something that the cell is asked to do or to tell; the parameter is what it answers."""


class Request(msgspec.Struct, frozen=True, array_like=True):
    """A command on its way.

    Attributes
    ----------
    number
        Of the caller, for the answer.
    deadline_s
        Monotonic time of this machine after which no caller waits for the answer any more.
    name
        Of the command's type.
    body
        The command.
    """

    number: int
    deadline_s: float
    name: str
    body: msgspec.Raw


class Answer(msgspec.Struct, frozen=True, array_like=True):
    """The answer to a command.

    Attributes
    ----------
    number
        Of the request.
    error
        Name of the error that it ended in, empty if it did not.
    body
        The answer, or what the error is made of.
    """

    number: int
    error: str
    body: msgspec.Raw


class State(msgspec.Struct, frozen=True, array_like=True):
    """What the cell reports of itself a few times a second.

    Attributes
    ----------
    waits_for
        What its start waits for; empty once all works.
    ready
        Whether it takes commands.
    stream
        Number of the latest live message.
    assets
        Revision of the assets that it follows.
    partitions
        Of a fleet, those that it owns, each with its epoch.
    followed
        Another number when it follows other assets.
    """

    waits_for: str = ""
    ready: bool = False
    stream: int = 0
    assets: int = 0
    partitions: dict[int, int] = {}
    followed: int = 0


_encoder = msgspec.msgpack.Encoder()


def encode(message: Any) -> bytes:
    """Write a message."""
    return _encoder.encode(message)
