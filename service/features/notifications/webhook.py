"""Posts messages to a webhook."""

import asyncio
import ssl
from typing import Final

import httpx2

from service.features.notifications.messages import OutgoingMessage, signature_headers
from service.features.notifications.sections import NotificationSection
from service.features.notifications.sender import (
    ANSWER_S,
    WHOLE_S,
    ContentRefusedError,
    DeliveryError,
    one_line,
    reason,
)

#: Bad request, content too large, content that cannot be processed.
_OF_THE_CONTENT: Final = (400, 413, 422)
_FAILED_ON_IT: Final = 500


class WebhookSender:
    """Posts JSON to one address; no redirect is followed, and nothing of the answer is read."""

    def __init__(self, section: NotificationSection, key: bytes | None, context: ssl.SSLContext):
        self._url = section.url or ""
        self._host = section.receivers[0]
        self._key = key
        self._client = httpx2.AsyncClient(verify=context, timeout=ANSWER_S, follow_redirects=False)

    async def send(self, message: OutgoingMessage) -> str | None:
        """See `Sender`."""
        message_id = message.id
        body = message.document(message_id).to_bytes()
        headers = {
            "content-type": "application/json",
            "user-agent": "bearing-twin",
            **signature_headers(message_id, body, self._key),
        }
        try:
            async with (
                asyncio.timeout(WHOLE_S),
                self._client.stream("POST", self._url, content=body, headers=headers) as answer,
            ):
                status = answer.status_code
        except (httpx2.HTTPError, httpx2.InvalidURL, OSError, TimeoutError) as error:
            raise DeliveryError(one_line(f"{self._host}: {reason(error)}")) from error
        if 300 <= status < 400:
            raise DeliveryError(f"{self._host}: answered {status}; redirects are not followed")
        if not 200 <= status < 300:
            said = f"{self._host}: answered {status}"
            if status in (*_OF_THE_CONTENT, _FAILED_ON_IT):
                raise ContentRefusedError(said, is_final=status in _OF_THE_CONTENT)
            raise DeliveryError(said)
        return None

    async def close(self) -> None:
        """Close the connection."""
        await self._client.aclose()
