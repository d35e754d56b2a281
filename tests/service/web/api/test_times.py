import pytest

from service.clock import rfc3339
from service.domain.times import parse_time

EIGHT = 1_795_248_000_000_000


@pytest.mark.parametrize(
    "text",
    [
        "2026-11-21T08:00:00Z",
        "2026-11-21t08:00:00z",
        "2026-11-21 08:00:00Z",
        "2026-11-21T09:00:00+01:00",
        "2026-11-21T09:00:00 01:00",  # an unescaped plus sign in a query
        "2026-11-21T03:30:00-04:30",
        "2026-11-21T08:00:00.000000999Z",
    ],
)
def test_rfc_3339_with_offset_is_understood(text: str) -> None:
    assert parse_time(text) == EIGHT


def test_microseconds_are_kept() -> None:
    assert parse_time("2026-11-21T08:00:00.123456Z") == EIGHT + 123_456
    assert rfc3339(EIGHT + 123_456) == "2026-11-21T08:00:00.123Z"


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ("2026-11-21T08:00:00", "offset"),
        ("2026-11-21", "RFC 3339"),
        ("20261121T080000Z", "RFC 3339"),
        ("2026-W47-6T08:00:00Z", "RFC 3339"),
        ("now", "RFC 3339"),
        ("", "RFC 3339"),
        (1_795_248_000, "RFC 3339"),
        (None, "RFC 3339"),
        ("2026-02-30T08:00:00Z", "exists"),
        ("2026-11-21T25:00:00Z", "exists"),
        ("2026-11-21T08:00:00+99:00", "exists"),
        ("1969-12-31T23:59:59Z", "1970"),
        ("0001-01-01T00:00:00+14:00", "1970"),
        ("9999-12-31T23:59:59-14:00", "2999"),
    ],
)
def test_anything_else_is_refused_with_what_was_expected(wrong: object, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        parse_time(wrong)
