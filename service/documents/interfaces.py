"""What takes live messages, for those who have some; the kinds of documents of an asset."""

from typing import Literal, Protocol

from service.documents.base import Document
from service.documents.messages import MessageType

DocumentKind = Literal[
    "summary", "snapshot", "state", "verdict", "forecast", "facts", "machine", "asset_summary"
]


class LivePublisher(Protocol):
    """Takes live messages for the clients that follow the service."""

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

        - ``data``: what the type of message carries; NaN and infinities become null.
        - ``time_us``: process time of the data in microseconds; default now.
        """
