"""Opaque cursors and the link to the next page."""

import base64
import binascii
from typing import TypeVar

from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from service.api.problems import parameter_problem

Place = TypeVar("Place", bound=BaseModel)


def encode_cursor(place: BaseModel) -> str:
    """Wrap a place in a listing as an opaque text."""
    return base64.urlsafe_b64encode(place.model_dump_json().encode()).decode().rstrip("=")


def decode_cursor(cursor: str, kind: type[Place]) -> Place:
    """Unwrap a cursor.

    Raises
    ------
    Problem
        With status 422 when the text is not one of our cursors for this listing.
    """
    padded = cursor + "=" * (-len(cursor) % 4)
    try:
        text = base64.b64decode(padded, altchars=b"-_", validate=True)
        return kind.model_validate_json(text)
    except (binascii.Error, ValueError, ValidationError) as error:
        raise parameter_problem("cursor", "expected the `next` of the page before") from error


def next_link(request: Request, cursor: str | None) -> dict[str, str]:
    """Build the header that points to the next page (RFC 8288); empty on the last page."""
    if cursor is None:
        return {}
    query = request.url.include_query_params(cursor=cursor).query
    return {"Link": f'<{request.url.path}?{query}>; rel="next"'}
