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
        Makes the copies of an asset from before now old ones; without a name those of all assets.
    """

    def __init__(self, app: ASGIApp, changed: Callable[[str | None], None]) -> None:
        self.app = app
        self.changed = changed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            await self.app(scope, receive, send)
            return

        async def note(message: Message) -> None:
            if message["type"] == "http.response.start" and 200 <= message["status"] < 300:
                self.changed(scope.get("path_params", {}).get("asset_id"))
            await send(message)

        await self.app(scope, receive, note)
