"""How what went wrong is said: in one line, and not at any length."""

from typing import Final

_CHARACTERS: Final = 60


def shown(value: object) -> str:
    """Give a value that is wrong, for a message."""
    text = repr(value[:_CHARACTERS] if isinstance(value, str) else value)
    return text if len(text) <= 2 * _CHARACTERS else f"{text[:_CHARACTERS]}…"


def one_line(error: object) -> str:
    """Give what an error says, or a text, as one line."""
    return " ".join(str(error).split())
