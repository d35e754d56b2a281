"""What HTTP lets callers write in more than one way (RFC 9110, RFC 9112)."""

from collections.abc import Sequence
from typing import Final
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

_ACCEPT_ENCODING: Final = b"accept-encoding"


class HttpForms:
    """Pass every request on in the one form that the rest knows.

    - ``HEAD`` is a ``GET`` whose answer has no body, wherever there is a ``GET``.
    - A target with scheme and host, as proxies write it, is the path; its host is the host.
    - Codings that a caller refuses by ``q=0``, or likes less than none, are not offered.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":  # a stream; or the start and the stop, which have no target
            await self.app(_of_path(scope) if "path" in scope else scope, receive, send)
            return
        scope = _without_refused_codings(_of_path(scope))
        if scope["method"] == "HEAD":
            await self.app({**scope, "method": "GET"}, receive, _without_body(send))
        else:
            await self.app(scope, receive, send)


def _of_path(scope: Scope) -> Scope:
    target = scope["raw_path"] or b""
    if not target.lower().startswith((b"http://", b"https://", b"ws://", b"wss://")):
        return scope
    try:
        place = urlsplit(target.decode("ascii"))
    except ValueError:
        return scope
    path = scope["path"].partition("://")[2]
    headers = [one for one in scope["headers"] if one[0] != b"host"]
    return {
        **scope,
        "path": f"/{path.partition('/')[2]}",
        "raw_path": place.path.encode() or b"/",
        "headers": [(b"host", place.netloc.encode()), *headers],
    }


def _without_refused_codings(scope: Scope) -> Scope:
    """Leave out what is said of codings where the answer is to be sent as it is."""
    given = [
        value.decode("latin-1") for name, value in scope["headers"] if name == _ACCEPT_ENCODING
    ]
    if not given or takes_gzip(given):
        return scope
    headers = [one for one in scope["headers"] if one[0] != _ACCEPT_ENCODING]
    return {**scope, "headers": headers}


def takes_gzip(lines: Sequence[str]) -> bool:
    """Whether a caller takes an answer in gzip, by its ``Accept-Encoding`` (RFC 9110, 12.5.3)."""
    weights: dict[str, float] = {}
    for text in ",".join(lines).split(","):
        coding, *parameters = (part.strip().lower() for part in text.split(";"))
        weight = 1.0
        for parameter in parameters:
            name, _, value = parameter.partition("=")
            if name.strip() == "q":
                try:
                    weight = float(value)
                except ValueError:
                    weight = 0.0
        weights[coding] = weight
    gzip = max(weights.get("gzip", 0.0), weights.get("x-gzip", 0.0))
    return gzip > 0.0 and gzip >= weights.get("identity", 0.0)


def _without_body(send: Send) -> Send:
    ended = False

    async def send_head(message: Message) -> None:
        nonlocal ended
        if ended:  # what makes a long body need not go on
            raise OSError("no body is asked for")
        if message["type"] == "http.response.body":
            ended = True
            message = {"type": "http.response.body", "body": b""}
        await send(message)

    return send_head
