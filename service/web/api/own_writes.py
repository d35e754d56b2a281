"""Whoever changes something sees it in what it reads next."""

from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.api.access import SAFE_METHODS


class OwnWrites:
    """Have copies of the cell's documents renewed before a call that may change them is answered.

    Parameters
    ----------
    app
        What lies behind.
    changed : callable
        Makes every copy from before now an old one.
    """

    def __init__(self, app: ASGIApp, changed: Callable[[], None]) -> None:
        self.app = app
        self.changed = changed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            await self.app(scope, receive, send)
            return

        async def note(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.changed()
            await send(message)

        await self.app(scope, receive, note)
