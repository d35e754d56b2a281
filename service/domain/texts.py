"""Texts of one line that people give: names, labels, comments, notes."""

import re
from typing import Annotated, Final

from pydantic import StringConstraints

#: Control characters, ends of lines, direction marks, and what has no width and no use in a word:
#: the joiners U+200C and U+200D stay, since names of several scripts are written with them.
_REFUSED: Final = (
    r"\u0000-\u001f\u007f-\u009f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff"
)
#: As pydantic, OpenAPI and JavaScript read it; none of them takes half of a surrogate pair.
ONE_LINE: Final = f"^[^{_REFUSED}]*$"
EXPECTED: Final = "expected one line of text, without control characters"
_NOT_SHOWN = re.compile(rf"[{_REFUSED}\ud800-\udfff]")


def is_one_line(text: str) -> bool:
    """Whether a text is one line of visible characters."""
    return _NOT_SHOWN.search(text) is None


def visible(text: str) -> str:
    """Give a text that was kept before such characters were refused: blanks in their place."""
    return _NOT_SHOWN.sub(" ", text)


OneLine = Annotated[str, StringConstraints(strip_whitespace=True, pattern=ONE_LINE)]
"""A text of one line in a request; blanks and ends of lines around it do not count."""
