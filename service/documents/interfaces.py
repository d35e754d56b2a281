"""What takes live messages, for those who have some; the kinds of documents of an asset."""

from typing import Literal, Protocol

from service.documents.base import Document
from service.documents.messages import MessageType

DocumentKind = Literal[
    "summary", "snapshot", "state", "verdict", "forecast", "facts", "machine", "glance"
]


class Publisher(Protocol):
    """Takes live messages for whoever follows the service."""

    def is_followed(self, asset: str) -> bool:
        """Whether anybody wants what is going on with an asset; alarms and jobs are sent anyway."""

    def publish(
        self,
        type: MessageType,
        asset: str | None,
        data: Document,
        time_us: int | None = None,
    ) -> object:
        """Give a message its number and hand it to all who want it; never waits.

        Parameters
        ----------
        type : str
            What the data are.
        asset : str or None
            Asset that it is about; None for the service as a whole.
        data : Document
            What the type of message carries; NaN and infinities become null.
        time_us : int, optional
            Process time of the data in microseconds; default now.
        """
