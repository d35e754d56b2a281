"""Opaque cursors and the link to the next page."""

import base64
import binascii
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

from fastapi import Query
from pydantic import BaseModel, Field, ValidationError
from starlette.requests import Request

from service.web.api.problems import parameter_problem

LIMIT = 200
LIMIT_MAX = 1000

Position = TypeVar("Position", bound=BaseModel)
Item = TypeVar("Item")

Limit = Annotated[int, Query(ge=1, le=LIMIT_MAX, description="Items of a page, at most.")]
LimitOrAll = Annotated[
    int | None,
    Query(ge=1, le=LIMIT_MAX, description="Items of a page, at most; absent: all at once."),
]
Cursor = Annotated[
    str | None, Query(max_length=8192, description="`next` of the page before; absent: the first.")
]


class Before(BaseModel):
    """Where a page ended of a listing whose rows are numbered, newest first."""

    before: int = Field(ge=0, lt=2**63)


class After(BaseModel):
    """Where a page ended of a listing whose items have names."""

    after: str = Field(max_length=100)


def encode_cursor(place: BaseModel) -> str:
    """Wrap a place in a listing as an opaque text."""
    return base64.urlsafe_b64encode(place.model_dump_json().encode()).decode().rstrip("=")


def decode_cursor(cursor: str, kind: type[Position]) -> Position:
    """Unwrap a cursor.

    Raises `Problem` with status 422 when the text is not one of our cursors for this listing.
    """
    padded = cursor + "=" * (-len(cursor) % 4)
    try:
        text = base64.b64decode(padded, altchars=b"-_", validate=True)
        if b"\\u0000" in text:  # ours never hold it, and PostgreSQL cannot be asked for it
            raise ValueError("NUL")
        return kind.model_validate_json(text)
    except (binascii.Error, ValueError, ValidationError) as error:
        raise parameter_problem("cursor", "expected the `next` of the page before") from error


def next_link(request: Request, cursor: str | None) -> dict[str, str]:
    """Build the header that points to the next page (RFC 8288); empty on the last page."""
    if cursor is None:
        return {}
    query = request.url.include_query_params(cursor=cursor).query
    return {"Link": f'<{request.url.path}?{query}>; rel="next"'}


def page_of(
    items: Sequence[Item], limit: int, cursor: str | None, name: Callable[[Item], object]
) -> tuple[Sequence[Item], str | None]:
    """Cut a page out of a listing that is at hand as a whole.

    ``name`` identifies an item. Returns the page, and the cursor of the next
    one. Raises `Problem` with status 422 when the cursor is not of this listing.
    """
    begin = 0
    if cursor is not None:
        last = decode_cursor(cursor, After).after
        names = [str(name(item)) for item in items]
        if last not in names:
            raise parameter_problem("cursor", "expected the `next` of the page before")
        begin = names.index(last) + 1
    page = items[begin : begin + limit]
    more = begin + limit < len(items)
    return page, encode_cursor(After(after=str(name(page[-1])))) if more else None
