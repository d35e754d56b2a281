"""A text is one line of visible characters, by one pattern everywhere."""

import re
import sys
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

import service.domain.texts
from service.domain.texts import ONE_LINE, OneLine, is_one_line, visible

HIDDEN = "\u200b\u2060\ufeff"
DIRECTIONS = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


class Body(BaseModel):
    text: OneLine


def takes(text: str) -> bool:
    try:
        Body(text=text)
    except ValidationError:
        return False
    return True


def test_each_control_and_direction_mark_is_refused() -> None:
    for point in range(sys.maxunicode + 1):
        char = chr(point)
        if unicodedata.category(char) in ("Cc", "Cs", "Zl", "Zp") or char in DIRECTIONS + HIDDEN:
            assert not is_one_line(f"a{char}b"), hex(point)
            assert not takes(f"a{char}b"), hex(point)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Prüfstand 3 – ±5 °C",
        "軸受",
        "می\u200cخواهم",
        "क्\u200dष",
        "👩\u200d🔧",
        "a\u00a0b",
        "=1+1",
    ],
)
def test_words_of_all_scripts_stay(text: str) -> None:
    assert is_one_line(text)
    assert takes(text)
    assert visible(text) == text
    assert re.match(ONE_LINE, text)


def test_what_stands_around_a_text_does_not_count() -> None:
    assert Body(text=" from a file\r\n").text == "from a file"


def test_what_was_kept_before_is_shown_with_blanks() -> None:
    assert visible("a\x1b[31m\u202eb\nc") == "a [31m b c"


def test_there_is_one_pattern() -> None:
    """No other module says for itself which characters a text may have."""
    package = Path(service.domain.texts.__file__).parents[1]
    other: list[Any] = [
        file.name
        for file in package.rglob("*.py")
        if re.search(r"\\x1f|\\u202e", file.read_text(encoding="utf-8"))
    ]
    assert other == ["texts.py"]
