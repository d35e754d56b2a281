"""What goes over the bus: changes, commands and their answers, in MessagePack.

Every message is a `msgspec.Struct` that is written as an array: a field more at its end, with a
default, can be read by an older process and the other way round.
"""

from collections.abc import Callable, Collection, Coroutine
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Generic, TypeVar

import msgspec
from pydantic import BaseModel
from pydantic_core import to_json

from service.domain.roles import Roles

AnswerT = TypeVar("AnswerT")
MethodT = TypeVar("MethodT", bound=Callable[..., Coroutine[Any, Any, Any]])
#: Wall seconds for what is in memory, for what is written, and for what may take a while.
SOON_S: Final = 2.0
WRITTEN_S: Final = 15.0
WHILE_S: Final = 60.0


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


@dataclass(frozen=True, slots=True)
class Call:
    """How a method of an interface is called over the bus: its decorator; see `service.bus.calls`.

    Attributes
    ----------
    roles
        For whom it may be called, or a function of the command that says so; None for what changes
        nothing.
    patience_s
        Wall seconds that a proxy waits for the answer.
    shared
        Whether callers that ask the same at the same time may have one answer.
    finishes
        Whether it goes on to its end, also when the caller waits no longer.
    merge
        In a fleet every cell is asked, and this makes one answer of theirs.
    of_any
        In a fleet any one cell can answer. Without this and `merge` it is the cell that follows
        the asset named by the parameter ``asset_id``.
    """

    roles: Roles | Callable[[Any], Roles] | None = None
    patience_s: float = SOON_S
    shared: bool = False
    finishes: bool = False
    merge: Callable[[Collection[Any]], Any] | None = None
    of_any: bool = False

    def __call__(self, method: MethodT) -> MethodT:
        """Mark a method."""
        method.__dict__["call"] = self
        return method


class Command(msgspec.Struct, Generic[AnswerT], frozen=True, array_like=True):
    """A call of a method: its parameters; made by `service.bus.calls.command_type`."""

    call: ClassVar[Call] = Call()
    result: ClassVar["msgspec.msgpack.Decoder[Any]"]

    def may_be_asked_for(self, role: str) -> bool:
        """Whether a caller of this role may have it done."""
        roles = self.call.roles
        return roles is None or role in (roles(self) if callable(roles) else roles)


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
    role
        Of the caller for whom a process asks; empty where it asks for itself.
    caller
        On whose behalf the process asks; empty for its own.
    """

    number: int
    deadline_s: float
    name: str
    body: msgspec.Raw
    role: str = ""
    caller: str = ""


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


class CellState(msgspec.Struct, frozen=True, array_like=True):
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
    follows
        Whether its twins follow the machines: their kernels are compiled.
    """

    waits_for: str = ""
    ready: bool = False
    stream: int = 0
    assets: int = 0
    partitions: dict[int, int] = {}
    followed: int = 0
    follows: bool = True


def _as_text(value: object) -> bytes:
    """A document, or the body of a request, goes as its JSON text."""
    if isinstance(value, BaseModel):
        return to_json(value, inf_nan_mode="null")
    raise NotImplementedError(f"{type(value).__name__} does not go over the bus")


def _of_text(kind: type, text: Any) -> Any:
    if issubclass(kind, BaseModel):
        return kind.model_validate_json(text)
    raise NotImplementedError(f"{kind.__name__} does not go over the bus")


_encoder = msgspec.msgpack.Encoder(enc_hook=_as_text)


def encode(message: Any) -> bytes:
    """Write a message."""
    return _encoder.encode(message)


def decoder_of(kind: Any) -> "msgspec.msgpack.Decoder[Any]":
    """What reads messages of a kind, documents in them too."""
    return msgspec.msgpack.Decoder(kind, dec_hook=_of_text)
