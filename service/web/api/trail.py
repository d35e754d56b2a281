"""Every change that comes by HTTP leaves a line in the audit trail, whichever route makes it."""

import json
from typing import Any

from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.security import AuditTrail
from service.web.api.access import AUDIT, SAFE_METHODS, actor

#: Marks the answer to a call that was sent again: it changed nothing.
REPLAYED = "Idempotent-Replayed"
_KEPT_BYTES = 4096
_SHOWN_CHARACTERS = 500


class Trail:
    """Write a call that changed something into the trail before it is answered.

    Which call that is the route says by `service.web.api.access.secured`: all with an unsafe
    method, unless it says otherwise.

    Parameters
    ----------
    app
        What lies behind.
    trail : AuditTrail
        Where the lines go.
    """

    def __init__(self, app: ASGIApp, trail: AuditTrail) -> None:
        self.app = app
        self.trail = trail

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and note what it did."""
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            await self.app(scope, receive, send)
            return
        body = bytearray()

        async def receive_and_keep() -> Message:
            message = await receive()
            if message["type"] == "http.request" and len(body) < _KEPT_BYTES:
                body.extend(message.get("body", b"")[:_KEPT_BYTES])
            return message

        async def send_and_note(message: Message) -> None:
            if message["type"] == "http.response.start" and 200 <= message["status"] < 300:
                await self._note(scope, Headers(raw=message["headers"]), bytes(body))
            await send(message)

        await self.app(scope, receive_and_keep, send_and_note)

    async def _note(self, scope: Scope, headers: Headers, body: bytes) -> None:
        route = scope.get("route")
        if not isinstance(route, APIRoute) or REPLAYED in headers:
            return
        action = (route.openapi_extra or {}).get(AUDIT, "")
        if action is None:
            return
        target = ", ".join(
            f"{name.removesuffix('_id')} {value}" for name, value in scope["path_params"].items()
        )
        made = headers.get("Location")
        if made:
            target += f", made {made.rpartition('/')[2]}"
        caller = actor(Request(scope))
        await self.trail.note(caller, action or _named_after(route.path), target, _shown(body))


def _named_after(path: str) -> str:
    """``/alarms/{alarm_id}/shelve`` is called ``alarm.shelve``."""
    *_, noun, verb = (part for part in path.split("/") if part and not part.startswith("{"))
    return f"{noun.removesuffix('s')}.{verb}"


def _shown(body: bytes) -> str:
    """What was asked for, as people read it."""
    try:
        asked: Any = json.loads(body) if body else {}
    except ValueError:  # longer than what is kept
        asked = body.decode(errors="replace")
    if isinstance(asked, dict):
        asked = "; ".join(
            f"{name}: {value if isinstance(value, str) else json.dumps(value)}"
            for name, value in asked.items()
            if value is not None
        )
    text = "".join(letter if letter.isprintable() else " " for letter in str(asked))
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 1] + "…"
