"""Answers that a caller who has them already is spared (ETag and 304)."""

import hashlib
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Final

from fastapi import Header
from starlette.responses import Response

from service.documents.base import Document
from service.web.api.access import Responses

_ENTITY_TAG = re.compile(r'(?:W/)?("[^"]*")')

IfNoneMatch = Annotated[str | None, Header(description="`ETag` of the answer that the caller has.")]

CONDITIONAL: Final[Responses] = {
    200: {
        "headers": {
            "ETag": {
                "description": "Changes with the answer.",
                "schema": {"type": "string", "examples": ['W/"5f0c1d2e"']},
            }
        }
    },
    304: {"description": "Nothing has changed since the `ETag` of `If-None-Match`."},
}
"""For OpenAPI."""


def entity_tag(body: bytes) -> str:
    """Tag of an answer; weak, since compressed or not it is the same answer."""
    return f'W/"{hashlib.blake2b(body, digest_size=12).hexdigest()}"'


def tagged_response(
    body: bytes,
    tag: str,
    if_none_match: str | None,
    more: Mapping[str, str] = MappingProxyType({}),
) -> Response:
    """Answer with JSON text under its tag, or with 304 to a caller who has just this."""
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", **more}
    if if_none_match and _matches(tag, if_none_match):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")


def conditional_response(
    answer: Document,
    if_none_match: str | None,
    headers: Mapping[str, str] = MappingProxyType({}),
) -> Response:
    """Answer with a document, or with 304 to a caller who has just this."""
    body = answer.to_bytes()
    return tagged_response(body, entity_tag(body), if_none_match, headers)


def _matches(tag: str, if_none_match: str) -> bool:
    return if_none_match.strip() == "*" or tag[2:] in _ENTITY_TAG.findall(if_none_match)
