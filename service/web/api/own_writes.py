"""A client that changes something sees the change in what it reads next."""

from collections.abc import Callable, Collection

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.api.access import SAFE_METHODS


class OwnWrites:
    """Have copies of the cell's documents renewed before a call that may change them is answered.

    ``changed``: makes the copies of some assets from before now old ones; of all for None. Which
    they are is in the path, or in ``request.state.changed_assets`` where a call is about several.
    """

    def __init__(self, app: ASGIApp, changed: Callable[[Collection[str] | None], None]) -> None:
        self.app = app
        self.changed = changed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            await self.app(scope, receive, send)
            return

        async def note(message: Message) -> None:
            if message["type"] == "http.response.start" and 200 <= message["status"] < 300:
                self.changed(_changed_assets(scope))
            await send(message)

        await self.app(scope, receive, note)


def _changed_assets(scope: Scope) -> Collection[str] | None:
    named: Collection[str] | None = scope.get("state", {}).get("changed_assets")
    if named is not None:
        return named
    asset = scope.get("path_params", {}).get("asset_id")
    return None if asset is None else (asset,)
