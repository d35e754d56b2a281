"""The dashboard's first page, which learns whether someone opened it by hand.

A link may carry a key (``#key=…``, as the demo prints it). From another site such a link would
log a browser in without its user knowing. Only the browser knows where the link was, and it tells
the service alone.
"""

from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

_BEGIN = b"<html "
_BY_HAND = b'<html data-opened="by-hand" '


def page_route(index: Path) -> Route:
    """Make the route of ``/``.

    Parameters
    ----------
    index : pathlib.Path
        The page; its `html` element says `data-opened="by-hand"` when no page led here.
    """
    otherwise = index.read_bytes()
    by_hand = otherwise.replace(_BEGIN, _BY_HAND, 1)

    async def page(request: Request) -> Response:
        # The header comes over HTTPS and on the machine itself; without it no one knows.
        opened_by_hand = request.headers.get("Sec-Fetch-Site") == "none"
        body = by_hand if opened_by_hand else otherwise
        return Response(body, media_type="text/html", headers={"Cache-Control": "no-store"})

    return Route("/", page, include_in_schema=False)
