"""What all senders have in common."""

from typing import Final, Protocol

from service.notifications.messages import Letter

#: Wall seconds for a step of the conversation with a server, and for all of it.
ANSWER_S: Final = 10.0
WHOLE_S: Final = 30.0
_DETAIL_MAX: Final = 300


class NotToldError(Exception):
    """A message was not taken; the text says why in one line, without any secret."""


class Sender(Protocol):
    """Hands messages to the receivers of one notification."""

    async def send(self, letter: Letter) -> str | None:
        """Hand a message over; gives what is wrong with some of the receivers, if anything.

        Raises
        ------
        NotToldError
            If it is to be tried again.
        """

    async def close(self) -> None:
        """Release everything."""


def reason(error: Exception) -> str:
    """Say why a server did not take a message."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return str(error) or type(error).__name__


def one_line(text: str) -> str:
    """Make one line of what a server has said, and not too long a one."""
    line = " ".join(text.split())
    return line if len(line) <= _DETAIL_MAX else line[: _DETAIL_MAX - 1] + "…"
