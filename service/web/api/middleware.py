"""What every request passes on its way in: headers, unhandled errors, access gate, size limit."""

import re
import traceback
import zlib
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import cache
from typing import Final, NamedTuple

import structlog
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from service.feature_folders import declared
from service.web.api.access import known_caller
from service.web.api.problems import Problem, problem_response

STREAM_PATH = "/api/v1/stream"
KIB = 1024
_JSON = re.compile(r"application/(?:[a-z0-9.-]+\+)?json")
CSV = "text/csv"


class Upload(NamedTuple):
    """What the bodies of some paths below ``/api/v1`` may be.

    - ``path``: regular expression of them.
    - ``most_bytes``: longest body, decompressed.
    - ``media_types``: other types than JSON.
    """

    path: str
    most_bytes: int
    media_types: tuple[str, ...] = ()


_USUAL: Final = Upload("", 64 * KIB)
_OF_THE_CORE: Final = (
    Upload("/assets/[^/]+/forecasts", 256 * KIB),
    Upload("/assets/[^/]+/measurements", 4096 * KIB),
)


@cache
def _uploads() -> Sequence[tuple[re.Pattern[str], Upload]]:
    found = (*_OF_THE_CORE, *declared("routes", "UPLOADS"))
    return [(re.compile(f"/api/v1{one.path}"), one) for one in found]


def _upload(path: str) -> Upload:
    """What the body of a path may be."""
    return next((one for pattern, one in _uploads() if pattern.fullmatch(path)), _USUAL)


#: A small body may hold a very long one: it is decompressed in pieces, each counted.
_UNPACKED_BYTES = 64 * KIB


def _encoded(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.lower().encode(), value.encode()) for name, value in headers.items()]


_SECURITY_HEADERS: Final[Mapping[str, str]] = {
    # The charts and the API page set inline styles; scripts come from here only.
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

#: Under TLS only: for a month the browser talks to this host by HTTPS alone.
_STRICT_TRANSPORT: Final = {"Strict-Transport-Security": f"max-age={30 * 86_400}"}

# By (is TLS, is the API), as they go out with thousands of answers a second.
_ADDED_HEADERS: Final = {
    (secure, api): _encoded(
        {
            **_SECURITY_HEADERS,
            **(_STRICT_TRANSPORT if secure else {}),
            "Cache-Control": "no-store" if api else "no-cache",
        }
    )
    for secure in (False, True)
    for api in (False, True)
}

# Those who poll a snapshot every second get a little sooner than compressed; a page of fifty small
# files is a quarter lighter compressed. The first levels pack nearly as well as the last.
_API_COMPRESSED_FROM_BYTES = 4 * KIB
_PAGE_COMPRESSED_FROM_BYTES = 1 * KIB
_COMPRESSION_LEVEL = 4

_log = structlog.get_logger(__name__)

AccessCheck = Callable[[Request], Awaitable[None]]


class SecurityHeaders:
    """Add the headers that keep a browser from doing what the page never asked for."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and add to the answer."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        added = _ADDED_HEADERS[scope["scheme"] == "https", scope["path"].startswith("/api/")]

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *(header for header in added if header[0] not in given),
                ]
            await send(message)

        await self.app(scope, receive, send_with_headers)


class Compression:
    """Send answers compressed to those who can decompress them."""

    def __init__(self, app: ASGIApp, excluded: Sequence[str]) -> None:
        def packing(from_bytes: int) -> GZipMiddleware:
            return GZipMiddleware(
                app,
                minimum_size=from_bytes,
                compresslevel=_COMPRESSION_LEVEL,
                exclude_content_types=(*DEFAULT_EXCLUDED_CONTENT_TYPES, *excluded),
            )

        self._api = packing(_API_COMPRESSED_FROM_BYTES)
        self._page = packing(_PAGE_COMPRESSED_FROM_BYTES)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and compress the answer."""
        of_api = scope["type"] == "http" and scope["path"].startswith("/api/")
        await (self._api if of_api else self._page)(scope, receive, send)


class UnhandledErrors:
    """Turn whatever no handler knew into a problem without internals, and log it."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = False

        async def send_and_remember(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self.app(scope, receive, send_and_remember)
        except ClientDisconnect:
            return  # in the middle of its own body: no client is left to answer
        except Exception as error:  # one broken call must not look like anything but status 500
            # As text: a structured traceback shows local variables, and so the caller's key.
            text = "".join(traceback.format_exception(error))
            _log.error("request_failed", method=scope["method"], path=scope["path"], traceback=text)
            if started:
                raise
            detail = "internal error; the log of the service has the reason"
            response = problem_response(500, detail, scope["path"])
            await response(scope, receive, send)


class AccessGate:
    """Nothing under ``/api`` is even read for an unknown caller."""

    def __init__(self, app: ASGIApp, check: AccessCheck) -> None:
        self.app = app
        self.check = check

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request through, or answer 401."""
        if scope["type"] == "websocket" and scope["path"] != STREAM_PATH:
            await receive()  # the connect message
            detail = f"there is no stream at {scope['path']}, expected {STREAM_PATH}"
            response = problem_response(404, detail, scope["path"])
            await WebSocket(scope, receive, send).send_denial_response(response)
            return
        if scope["type"] == "http":
            try:
                await self.check(Request(scope))
            except Problem as problem:
                response = problem_response(
                    problem.status_code,
                    problem.detail,
                    scope["path"],
                    errors=problem.errors,
                    headers=problem.headers,
                )
                await response(scope, receive, send)
                return
        await self.app(scope, receive, send)


class BodyLimit:
    """Refuse a body that is longer than its call needs, before it fills the memory."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, counting the bytes of its body."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = _upload(scope["path"]).most_bytes
        problem = Problem(413, f"the body is too long, expected at most {limit} bytes")
        announced = Request(scope).headers.get("content-length", "0")
        if announced.isdecimal() and int(announced) > limit:
            response = problem_response(413, problem.detail, scope["path"])
            response.headers["Connection"] = "close"
            await response(scope, receive, send)
            return
        read = 0

        async def receive_and_count() -> Message:
            nonlocal read
            message = await receive()
            if message["type"] == "http.request":
                read += len(message.get("body", b""))
                if read > limit:
                    raise problem
            return message

        await self.app(scope, receive_and_count, send)


class Gunzip:
    """Decompress a body that came with ``Content-Encoding: gzip``, piece by piece.

    It stands behind one `BodyLimit`, which counts the compressed bytes, and before another, which
    counts what the body really holds. For a caller without a key nothing is decompressed.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with a plain body, or answer 400 or 415."""
        encoding = ""
        if scope["type"] == "http":
            encoding = Request(scope).headers.get("content-encoding", "").strip().lower()
        if encoding in ("", "identity"):
            await self.app(scope, receive, send)
            return
        known = known_caller(scope) is not None
        if encoding != "gzip" or not known:
            response = problem_response(
                415,
                f"Content-Encoding {encoding!r}, expected {'gzip or none' if known else 'none'}",
                scope["path"],
            )
            await response(scope, receive, send)
            return
        plain = (b"content-encoding", b"content-length")
        scope = {**scope, "headers": [one for one in scope["headers"] if one[0] not in plain]}
        unpacker = zlib.decompressobj(zlib.MAX_WBITS | 16)
        waiting, ended = b"", False

        async def receive_unpacked() -> Message:
            nonlocal waiting, ended
            while not (waiting or ended):
                message = await receive()
                if message["type"] != "http.request":
                    return message
                waiting, ended = message.get("body", b""), not message.get("more_body", False)
                if waiting and unpacker.eof:
                    raise _too_much_behind()
            try:
                body = unpacker.decompress(waiting, _UNPACKED_BYTES)
            except zlib.error as error:
                raise Problem(400, f"the body is not gzip: {error}") from None
            waiting = unpacker.unconsumed_tail
            if unpacker.unused_data:
                raise _too_much_behind()
            more = bool(waiting) or not ended
            if not (more or unpacker.eof):
                raise Problem(400, "the body is not gzip: it ends too early")
            return {"type": "http.request", "body": body, "more_body": more}

        await self.app(scope, receive_unpacked, send)


def _too_much_behind() -> Problem:
    return Problem(
        400,
        "the body goes on after the end of its gzip member, expected one member and nothing after",
    )


class JsonBodies:
    """Refuse a body that does not say that it is JSON, or CSV where that is taken too."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer 415."""
        if scope["type"] == "http" and scope["method"] in ("POST", "PUT", "PATCH"):
            headers = Request(scope).headers
            has_body = headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
            given = headers.get("content-type", "")
            kind = given.partition(";")[0].strip().lower()
            others = _upload(scope["path"]).media_types
            if has_body and kind not in others and not _JSON.fullmatch(kind):
                expected = ("application/json", *others)
                detail = f"Content-Type {given!r}, expected {' or '.join(expected)}"
                response = problem_response(
                    415, detail, scope["path"], headers={"Accept-Post": ", ".join(expected)}
                )
                await response(scope, receive, send)
                return
        await self.app(scope, receive, send)
