"""A value that is wrong is shown by its first characters, whatever its length."""

from datetime import UTC, date, datetime, time, timedelta
from decimal import Decimal

import pytest

from adapters.words import shown, shown_name


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("hot", "'hot'"),
        ("x" * 100, repr("x" * 100)),
        ("x" * 101, repr("x" * 100) + "…"),
        ("\x1b" * 10**8, repr("\x1b" * 100) + "…"),
        (1.5, "1.5"),
        (date(2026, 1, 1), "2026-01-01"),
        (datetime(2026, 1, 1, 12, tzinfo=UTC), "2026-01-01 12:00:00+00:00"),
        (time(12, 30), "12:30:00"),
        (timedelta(minutes=90), "1:30:00"),
        (Decimal("40.50"), "40.50"),
        (list(range(10**5)), repr(list(range(99)))[:100] + "…"),
    ],
)
def test_a_value_is_shown_by_its_first_hundred_characters(value: object, said: str) -> None:
    assert shown(value) == said


@pytest.mark.parametrize(
    ("name", "said"),
    [("max_age_s", "max_age_s"), ("a\tb", "'a\\tb'"), ("x" * 101, repr("x" * 100) + "…")],
)
def test_a_key_reads_as_a_word_or_is_quoted(name: str, said: str) -> None:
    assert shown_name(name) == said
