"""What a DBC file says of the messages and signals that are asked for."""

from collections.abc import Sequence

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.errors import Error as CantoolsError

from adapters.configuration import ConfigurationError, suggestion
from adapters.drivers.can.config import CanChannel, CanSource


def load_dbc(source: CanSource) -> Database:
    """Read the source's DBC file. Raises `ConfigurationError` if it cannot be read or is none.

    A message that contradicts itself refuses the file only where it is asked for, see `flaw`.
    """
    where = f"source {source.name!r}: dbc {str(source.dbc)!r}"
    try:
        database = cantools.database.load_file(source.dbc, database_format="dbc", strict=False)
    except OSError as error:
        raise ConfigurationError(f"{where} cannot be read: {error.strerror or error}") from None
    except (CantoolsError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ConfigurationError(f"{where} is not a valid DBC file: {reason}") from None
    if not isinstance(database, Database):
        raise ConfigurationError(f"{where} is not a CAN database")
    return database


def find_message(database: Database, source: CanSource, config: CanChannel, where: str) -> Message:
    """Return the message of a channel. Raises `ConfigurationError` if there is no usable one."""
    named = [message for message in database.messages if message.name == config.message]
    file = f"{str(source.dbc)!r}"
    if not named:
        names = [message.name for message in database.messages]
        raise ConfigurationError(
            f"{where}: message {config.message!r} is not in {file}; "
            + suggestion(config.message, names)
        )
    reason = flaw(database.messages, named[0])
    if reason:
        raise ConfigurationError(f"{where}: message {config.message!r} of {file}: {reason}")
    return named[0]


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


def flaw(messages: Sequence[Message], message: Message) -> str:
    """Say why no value can be read from a message of a file; empty when one can."""
    named = [identifier(one) for one in messages if one.name == message.name]
    if len(named) > 1:
        return f"the name is there {len(named)} times (identifiers {', '.join(named)})"
    twice = {one.name for one in message.signals if _count(message, one.name) > 1}
    if twice:
        return f"it has several signals of one name ({', '.join(sorted(twice))})"
    try:
        message.refresh(strict=True)
    except CantoolsError as error:
        return " ".join(str(error).split())[:200]
    return ""


def same_identifier(messages: Sequence[Message], message: Message) -> str:
    """Say which other message has the identifier of this one; empty when none has."""
    key = message.frame_id, message.is_extended_frame
    for other in messages:
        if other is not message and (other.frame_id, other.is_extended_frame) == key:
            return f"message {other.name!r} has the same identifier ({identifier(message)})"
    return ""


def identifier(message: Message) -> str:
    """A message's identifier as people write it."""
    return f"{message.frame_id:#x}"


def _count(message: Message, name: str) -> int:
    return sum(signal.name == name for signal in message.signals)
