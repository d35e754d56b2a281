"""The dashboard's first page and what is packed for it.

The page learns whether someone opened it by hand. A link may carry a key (``#key=…``, as the demo
prints it). From another site such a link would log a browser in without its user knowing. Only the
browser knows where the link was, and it says so to the service alone.

The page also learns its version, so that one that was opened before an update finds another one
here and loads again.
"""

import hashlib
import mimetypes
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.staticfiles import NotModifiedResponse

_BEGIN = b"<html "
_BY_HAND = b'<html data-opened="by-hand" '
#: Enough for the page to see that it is another one.
_VERSION_LENGTH = 16


def page_route(static: Path) -> Route:
    """Make the route of ``/`` from the folder of the dashboard."""
    index = (static / "index.html").read_bytes()
    otherwise = index.replace(
        _BEGIN, b'<html data-version="%s" ' % page_version(static).encode(), 1
    )
    by_hand = otherwise.replace(_BEGIN, _BY_HAND, 1)

    async def page(request: Request) -> Response:
        # The header comes over HTTPS and on the machine itself; without it no one knows.
        opened_by_hand = request.headers.get("Sec-Fetch-Site") == "none"
        body = by_hand if opened_by_hand else otherwise
        return Response(body, media_type="text/html", headers={"Cache-Control": "no-store"})

    return Route("/", page, include_in_schema=False)


def page_version(static: Path) -> str:
    """Tell the files of a dashboard from those of any other version."""
    digest = hashlib.sha256()
    for path in sorted(one for one in static.rglob("*") if one.is_file()):
        digest.update(path.relative_to(static).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:_VERSION_LENGTH]


def packed_routes(files: Mapping[str, str]) -> list[Route]:
    """Make the routes of files that are made when the service starts.

    ``files``: text by path; a browser that has the same text already is answered 304.
    """
    return [
        Route(f"/{path}", _answering(path, text), include_in_schema=False)
        for path, text in files.items()
    ]


def _answering(path: str, text: str) -> Callable[[Request], Coroutine[Any, Any, Response]]:
    body = text.encode()
    tag = f'"{hashlib.sha256(body).hexdigest()}"'
    media_type, _ = mimetypes.guess_type(path)

    async def answer(request: Request) -> Response:
        response = Response(body, media_type=media_type, headers={"ETag": tag})
        known = request.headers.get("If-None-Match", "").split(",")
        if tag in (one.strip().removeprefix("W/") for one in known):
            return NotModifiedResponse(response.headers)
        return response

    return answer
