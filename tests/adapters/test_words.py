"""A value that is wrong is shown by its first characters, whatever its length."""

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
