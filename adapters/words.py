"""How what went wrong is said: in one line, and not at any length."""

from datetime import date, time, timedelta
from decimal import Decimal
from typing import Final

_CHARACTERS: Final = 100
# Of these cells of a typed table Python's own form names a class.
_PLAIN: Final = (date, time, timedelta, Decimal)


def shown(value: object) -> str:
    """Give a value that is wrong, for a message: not more than its first 100 characters."""
    if isinstance(value, str):
        return repr(value) if len(value) <= _CHARACTERS else f"{value[:_CHARACTERS]!r}…"
    text = str(value) if isinstance(value, _PLAIN) else repr(value)
    return text if len(text) <= _CHARACTERS else f"{text[:_CHARACTERS]}…"


def shown_name(name: object) -> str:
    """Give a key that somebody wrote, for a message: as it is where it reads as one word."""
    text = str(name)
    return text if len(text) <= _CHARACTERS and text.isprintable() else shown(text)


def one_line(error: object) -> str:
    """Give what an error says, or a text, as one line."""
    return " ".join(str(error).split())
