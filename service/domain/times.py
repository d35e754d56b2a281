"""Times on the wire: RFC 3339 with an offset in, UTC with milliseconds out."""

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

from service.clock import from_rfc3339, rfc3339

_RFC3339 = re.compile(
    r"\d{4}-\d{2}-\d{2}[Tt ]\d{2}:\d{2}:\d{2}(\.\d{1,9})?(?P<offset>[Zz]|[+-]\d{2}:\d{2})?"
)
LATEST_US = 32_503_680_000_000_000  # the year 3000
_FRACTION = re.compile(r"(\.\d{1,6})\d*")


def parse_time(text: Any) -> int:
    """RFC 3339 text with an offset as UTC microseconds.

    Raises `ValueError` if it is anything else; the text says what was expected.
    """
    if not isinstance(text, str):
        raise ValueError("expected an RFC 3339 time such as 2026-11-21T08:00:00Z")
    # A plus sign that was not percent-encoded arrives as a blank.
    repaired = re.sub(r" (\d{2}:\d{2})$", r"+\1", text) if "T" in text.upper() else text
    match = _RFC3339.fullmatch(repaired)
    if match is None:
        raise ValueError("expected an RFC 3339 time such as 2026-11-21T08:00:00Z")
    if match["offset"] is None:
        raise ValueError("expected a time with an offset, such as Z or +01:00")
    try:
        time_us = from_rfc3339(_FRACTION.sub(r"\1", repaired.upper()))
    except (ValueError, OverflowError) as error:
        raise ValueError("expected a time that exists, such as 2026-11-21T08:00:00Z") from error
    if not 0 <= time_us < LATEST_US:
        raise ValueError("expected a time from 1970 to 2999")
    return time_us


Instant = Annotated[
    int,
    BeforeValidator(parse_time),
    PlainSerializer(rfc3339, return_type=str),
    WithJsonSchema(
        {"type": "string", "format": "date-time", "examples": ["2026-11-21T08:00:00.000Z"]}
    ),
]
"""A moment: RFC 3339 text outside, UTC microseconds inside."""
