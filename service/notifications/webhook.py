"""Posts messages to a webhook."""

import asyncio
import ssl

import httpx2

from service.notifications.messages import Letter, signature_headers
from service.notifications.sender import ANSWER_S, WHOLE_S, NotToldError, one_line, reason
from service.site.notification_section import NotificationSection


class WebhookSender:
    """Posts JSON to one address; no redirect is followed, and nothing of the answer is read."""

    def __init__(self, section: NotificationSection, key: bytes | None, context: ssl.SSLContext):
        self._url = section.url or ""
        self._host = section.receivers[0]
        self._key = key
        self._client = httpx2.AsyncClient(verify=context, timeout=ANSWER_S, follow_redirects=False)

    async def send(self, letter: Letter) -> str | None:
        """See `Sender`."""
        message_id = letter.id
        body = letter.document(message_id).to_bytes()
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
            raise NotToldError(one_line(f"{self._host}: {reason(error)}")) from error
        if 300 <= status < 400:
            raise NotToldError(f"{self._host}: answered {status}; redirects are not followed")
        if not 200 <= status < 300:
            raise NotToldError(f"{self._host}: answered {status}")
        return None

    async def close(self) -> None:
        """Close the connection."""
        await self._client.aclose()
