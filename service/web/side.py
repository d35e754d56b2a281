"""The web server: it answers from the first moment on, also while the rest is not there yet."""

import asyncio
import socket
import ssl

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.documents.health import Alive, Ready, ReadyCheck
from service.web.api.deps import json_response
from service.web.api.problems import RETRY_AFTER_S, problem_response
from service.web.server import WebServer, serve_web


class WebSide:
    """The web server of a service that may still wait for its store.

    ``waits_for``: what the service waits for, for people; names no hosts.
    """

    def __init__(self) -> None:
        self.waits_for = ""
        self._app: ASGIApp = self._wait
        self._server: WebServer | None = None
        self._serving: asyncio.Task[None] | None = None

    async def run(self, listener: socket.socket, tls: ssl.SSLContext | None) -> None:
        """Answer until cancelled."""
        self._server, doorway = serve_web(self, listener, tls)
        self._serving = asyncio.create_task(self._server.serve(sockets=[doorway]))
        try:
            await asyncio.shield(self._serving)
            if self._server.should_exit:  # all is well: the service stops, and this task soon
                await asyncio.Event().wait()
        finally:
            await self.stop()

    def show(self, app: ASGIApp) -> None:
        """Answer with the whole application from now on."""
        self._app = app

    async def stop(self) -> None:
        """Take no more requests, and wait for those under way, for at most two seconds."""
        if self._server is not None and self._serving is not None:
            self._server.should_exit = True
            await asyncio.wait({self._serving})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, with what there is by now."""
        if scope["type"] == "lifespan":  # that of the application begins and ends with the service
            while (await receive())["type"] != "lifespan.shutdown":
                await send({"type": "lifespan.startup.complete"})
            await send({"type": "lifespan.shutdown.complete"})
            return
        await self._app(scope, receive, send)

    async def _wait(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer while there is no store: alive, not ready, and for all else try again."""
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1013, "reason": "the service starts"})
            return
        await self._waiting_answer(Request(scope))(scope, receive, send)

    def _waiting_answer(self, request: Request) -> Response:
        path, reason = request.url.path, f"waits for {self.waits_for}"
        asks = request.method in ("GET", "HEAD")
        if asks and path == "/livez":
            return json_response(Alive())
        retry = {"Retry-After": str(RETRY_AFTER_S)}
        if asks and path == "/readyz":
            checks = [ReadyCheck(name="start", status="failed", detail=reason)]
            return json_response(Ready(status="not ready", checks=checks), 503, retry)
        return problem_response(503, f"the service starts: {reason}", path, headers=retry)
