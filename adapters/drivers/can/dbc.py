"""What a DBC file says of the messages and signals that are asked for."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from cantools.database.can import Database, Message, Signal
from cantools.errors import Error as CantoolsError

from adapters.configuration import ConfigurationError, suggestion
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.dbc_text import load
from adapters.drivers.can.senders import group_mask, is_j1939
from adapters.words import one_line

Key = TypeVar("Key")
_ENCODING = "cp1252"  # as the tools that write such files have it
FrameKey = tuple[int, bool]  # identifier, extended or not


class DbcFile:
    """The messages of a DBC file, found by name, by identifier and by J1939 group."""

    def __init__(
        self, path: str, messages: Sequence[Message], unreadable: Mapping[str, str]
    ) -> None:
        self.path, self.messages = path, messages
        self._unreadable = unreadable  # why, by name
        self._by_name = _grouped(messages, lambda message: message.name)
        self._by_key = _grouped(messages, frame_key)
        self._by_group = _grouped(filter(is_j1939, messages), _group)
        self._flaws: dict[str, str] = {}

    def message(self, config: CanChannel, where: str) -> Message:
        """Return the message of a channel. Raises `ConfigurationError` if none is usable."""
        named = self._by_name.get(config.message)
        if named is None and config.message in self._unreadable:
            raise ConfigurationError(
                f"{where}: message {config.message!r} of {self.path!r}: "
                + self._unreadable[config.message]
            )
        if named is None:
            raise ConfigurationError(
                f"{where}: message {config.message!r} is not in {self.path!r}; "
                + suggestion(config.message, list(self._by_name))
            )
        if flaw := self.flaw(named[0]):
            raise ConfigurationError(
                f"{where}: message {config.message!r} of {self.path!r}: {flaw}"
            )
        return named[0]

    def flaw(self, message: Message) -> str:
        """Say why no value can be read from a message; empty when one can."""
        if message.name not in self._flaws:
            self._flaws[message.name] = _flaw(self._by_name[message.name])
        return self._flaws[message.name]

    def same_identifier(self, message: Message) -> str:
        """Say which other message has the identifier of this one; empty when none has."""
        for other in self._by_key[frame_key(message)]:
            if other is not message:
                return f"message {other.name!r} has the same identifier ({identifier(message)})"
        return ""

    def others_of_group(self, message: Message) -> list[Message]:
        """Return the messages with another identifier and the same J1939 group."""
        if not is_j1939(message):
            return []
        group = self._by_group[_group(message)]
        return [other for other in group if other.frame_id != message.frame_id]


def load_dbc(source: CanSource) -> DbcFile:
    """Read the source's DBC file. Raises `ConfigurationError` if it cannot be read or is none.

    A message that contradicts itself refuses the file only where it is asked for.
    """
    where = f"source {source.name!r}: dbc {str(source.dbc)!r}"
    try:
        database, flaws = load(source.dbc.read_text(_ENCODING, errors="replace"))
    except OSError as error:
        raise ConfigurationError(f"{where} cannot be read: {error.strerror or error}") from None
    except (CantoolsError, ValueError) as error:
        raise ConfigurationError(
            f"{where} is not a valid DBC file: {one_line(error)[:200]}"
        ) from None
    if not isinstance(database, Database):
        raise ConfigurationError(f"{where} is not a CAN database")
    return DbcFile(str(source.dbc), database.messages, flaws)


def find_signal(message: Message, config: CanChannel, where: str) -> Signal:
    """Return the signal of a channel. Raises `ConfigurationError` if it is not in the message."""
    for signal in message.signals:
        if signal.name == config.signal:
            return signal
    names = [signal.name for signal in message.signals]
    raise ConfigurationError(
        f"{where}: signal {config.signal!r} is not in message {message.name!r}; "
        + suggestion(config.signal, names)
    )


def frame_key(message: Message) -> FrameKey:
    """The identifier and format of a message's frames."""
    return message.frame_id, message.is_extended_frame


def identifier(message: Message) -> str:
    """A message's identifier as people write it."""
    return f"{message.frame_id:#x}"


def _flaw(named: Sequence[Message]) -> str:
    if len(named) > 1:
        identifiers = ", ".join(identifier(message) for message in named)
        return f"the name is there {len(named)} times (identifiers {identifiers})"
    (message,) = named
    counts = Counter(signal.name for signal in message.signals)
    if twice := sorted(name for name, count in counts.items() if count > 1):
        return f"it has several signals of one name ({', '.join(twice)})"
    try:
        message.refresh(strict=True)
    except CantoolsError as error:
        return one_line(error)[:200]
    return ""


def _group(message: Message) -> int:
    return message.frame_id & group_mask(message)


def _grouped(
    messages: Iterable[Message], key: Callable[[Message], Key]
) -> Mapping[Key, list[Message]]:
    groups: dict[Key, list[Message]] = {}
    for message in messages:
        groups.setdefault(key(message), []).append(message)
    return groups
