"""What all senders have in common."""

from typing import Final, Protocol

from service.domain.errors import BearingTwinError
from service.features.notifications.messages import OutgoingMessage

#: Wall seconds for a step of the conversation with a server, and for all of it.
ANSWER_S: Final = 10.0
WHOLE_S: Final = 30.0
_DETAIL_MAX: Final = 300


class DeliveryError(BearingTwinError):
    """A message was not accepted; the text says why in one line, without any secret.

    Attributes
    ----------
    is_partial : bool
        Whether some of several addresses have it.
    """

    def __init__(self, text: str, *, is_partial: bool = False) -> None:
        super().__init__(text)
        self.is_partial = is_partial


class PostponedError(DeliveryError):
    """A receiver does not take a message for the time being; it may be too large for it."""


class ContentRefusedError(DeliveryError):
    """A receiver does not take what the message says; others may be taken.

    Attributes
    ----------
    is_final : bool
        Whether the same message is of no use later either.
    """

    def __init__(self, text: str, *, is_final: bool) -> None:
        super().__init__(text)
        self.is_final = is_final


class Sender(Protocol):
    """Sends messages to one recipient of the configuration."""

    async def send(self, message: OutgoingMessage) -> str | None:
        """Send a message; gives what is wrong with some of several addresses, if anything.

        Raises `DeliveryError` if it is to be tried again, `ContentRefusedError` if in parts,
        `PostponedError` if as it is first, then in parts.
        """

    async def close(self) -> None:
        """Release everything."""


def reason(error: Exception) -> str:
    """Say why a server did not accept a message."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return str(error) or type(error).__name__


def one_line(text: str) -> str:
    """Make one line of what a server has said, cut where it is too long."""
    line = " ".join(text.split())
    return line if len(line) <= _DETAIL_MAX else line[: _DETAIL_MAX - 1] + "…"
