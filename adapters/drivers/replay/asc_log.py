"""Text of an ASC log as python-can's reader needs it."""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

_DATE = re.compile(r"date\s", re.IGNORECASE)
_BASE = re.compile(r"base\s", re.IGNORECASE)
_KNOWN_BASE = re.compile(
    r"base\s+(hex|dec)(\s+timestamps\s+(absolute|relative))?\s*(//.*)?$", re.IGNORECASE
)
_BODY = re.compile(r"\d|begin\s+triggerblock", re.IGNORECASE)
_END_OF_HEADER = "no internal events logged\n"
#: A frame in hexadecimal: with all its bytes, or with something behind them.
_DATA = re.compile(r"\sd\s+([0-9a-f])((?:\s+[0-9a-f]{2})*)(\s+\S.*)?$", re.IGNORECASE)
_HEADER_BYTES = 4096


class AscText(io.TextIOBase):
    """The lines of a log.

    The reader takes whatever line it does not know for the end of the header, and as a part of it:
    it gets date and base alone, and an end. A last line without its end may be a frame whose last
    byte lacks a digit: it is left out unless it is whole.

    Attributes
    ----------
    is_cut : bool
        Whether such a line was left out, once all have been read.
    """

    def __init__(self, text: TextIO) -> None:
        self.is_cut = False
        self._lines = self._read(text)

    def __next__(self) -> str:  # type: ignore[override]  # as that of every text does
        """Give the next line."""
        return next(self._lines)

    def _read(self, text: TextIO) -> Iterator[str]:
        is_header, is_hex = True, True
        for line in text:
            stripped = line.strip()
            if is_header and _BODY.match(stripped):
                is_header = False
                yield _END_OF_HEADER
            if is_header:
                if _BASE.match(stripped):
                    if not _KNOWN_BASE.match(stripped):
                        raise ValueError(f"{stripped!r}: expected base hex or dec")
                    is_hex = "hex" in stripped.lower()
                if _BASE.match(stripped) or _DATE.match(stripped):
                    yield line
                continue
            if not line.endswith("\n") and stripped[:1].isdigit():
                self.is_cut = not (is_hex and _is_whole(stripped))
                if self.is_cut:
                    return
            yield line


def _is_whole(line: str) -> bool:
    """Whether a line in hexadecimal is a frame that has all its bytes."""
    found = _DATA.search(line)
    return found is not None and len(found[2].split()) == int(found[1], 16)


def encoding(path: Path) -> str:
    """Encoding of a text: UTF-8 or 16, or the one of Windows where its head is none of them."""
    with path.open("rb") as file:
        # A character that is cut in two at the end does no harm.
        head = file.read(_HEADER_BYTES).rpartition(b"\n")[0]
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"
