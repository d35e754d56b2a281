"""The address of a caller behind a proxy: believed only from proxies that are named."""

import ipaddress
from collections.abc import Sequence
from typing import Any, cast

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

_PEER = "bearing_twin.peer"


class KnownProxies:
    """Take the caller's address and scheme from headers of the proxies that are named.

    An address that is none, which a proxy may pass on from anybody, is not taken: it would stand
    in the audit trail, and count for no one.

    - ``proxies``: addresses, or networks such as 10.0.0.0/24.
    """

    def __init__(self, app: ASGIApp, proxies: Sequence[str]) -> None:
        self.app = app
        self._proxied = ProxyHeadersMiddleware(cast(Any, self._checked), list(proxies))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        scope[_PEER] = scope.get("client")
        await self._proxied(cast(Any, scope), cast(Any, receive), cast(Any, send))

    async def _checked(self, scope: Scope, receive: Receive, send: Send) -> None:
        peer, client = scope[_PEER], scope.get("client")
        if client is not None and client != peer:
            try:
                scope["client"] = (str(ipaddress.ip_address(client[0])), client[1])
            except ValueError:
                scope["client"] = peer
        await self.app(scope, receive, send)
