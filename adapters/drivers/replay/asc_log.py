"""Text of an ASC log as python-can's reader needs it."""

import io
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Final, TextIO

from adapters.words import shown

_DATE = re.compile(r"(date|begin\s+triggerblock)\s+(.*\S)", re.IGNORECASE)
_MOMENT = re.compile(
    r"(?:[^\W\d]+\.?,?\s+)?(?P<month>[^\W\d]+)\.?\s+(?P<day>[0-9]{1,2})\.?\s+"
    r"(?P<hour>[0-9]{1,2}):(?P<minute>[0-9]{1,2}):(?P<second>[0-9]{1,2})(?:\.(?P<fraction>[0-9]+))?"
    r"(?:\s*(?P<half>[ap])m)?\s+(?P<year>[0-9]{4})",
    re.IGNORECASE,
)
_ISO: Final = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]+)?")
_MONTHS: Final = (
    *(("jan", "january", "januar"), ("feb", "february", "februar")),
    *(("mar", "march", "mär", "mrz", "märz"), ("apr", "april"), ("may", "mai")),
    *(("jun", "june", "juni"), ("jul", "july", "juli"), ("aug", "august")),
    *(("sep", "sept", "september"), ("oct", "october", "okt", "oktober")),
    *(("nov", "november"), ("dec", "december", "dez", "dezember")),
)
#: How the reader has them.
_ENGLISH: Final = [names[0].capitalize() for names in _MONTHS]
_EXPECTED_DATE: Final = "expected one such as 'Fri Mar 20 08:00:00.000 2026'"
#: West of Greenwich the epoch is in it; an earlier one is a year of two figures.
_FIRST_YEAR: Final = 1969
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
    it gets date and base alone, and an end. It passes over both behind the first frame: where
    frames follow that mean something else since, `ValueError` names the line. A last line without
    its end may be a frame whose last byte lacks a digit: it is left out unless it is whole.

    Parameters
    ----------
    needs_dates : bool
        Whether a date in a form that is not known is refused; else times count without it.

    Attributes
    ----------
    is_cut : bool
        Whether such a line was left out, once all have been read.
    """

    def __init__(self, text: TextIO, *, needs_dates: bool) -> None:
        self.is_cut = False
        self._needs_dates = needs_dates
        self._lines = self._read(text)

    def __next__(self) -> str:  # type: ignore[override]  # as that of every text does
        """Give the next line."""
        return next(self._lines)

    def _read(self, text: TextIO) -> Iterator[str]:
        is_header, base = True, ("hex", "absolute")
        date: datetime | None = None
        late = ""
        for line in text:
            stripped = line.strip()
            if is_header and _BODY.match(stripped):
                is_header = False
                yield _END_OF_HEADER
            if _BASE.match(stripped):
                before, base = base, _base(stripped)
                if is_header:
                    yield line
                elif base != before:
                    raise _too_late(stripped)
                continue
            if stated := _DATE.match(stripped):
                word, moment = stated[1], _moment(stated[2])
                is_block = word.lower() != "date"
                if is_header or is_block:
                    if moment is None and self._needs_dates:
                        raise ValueError(f"{shown(stated[2])} is no date; {_EXPECTED_DATE}")
                    if is_header:
                        date = moment
                    late = ""  # a block says when its frames were
                    yield from _as_known(word, moment, is_block=is_block)
                elif moment is not None and moment != date:
                    late = stripped
                continue
            if late and stripped[:1].isdigit():
                raise _too_late(late)
            if is_header:
                continue
            if not line.endswith("\n") and stripped[:1].isdigit():
                self.is_cut = not (base[0] == "hex" and _is_whole(stripped))
                if self.is_cut:
                    return
            yield line


def _base(line: str) -> tuple[str, str]:
    """Base of the numbers, and what times count from. Raises `ValueError` for another one."""
    found = _KNOWN_BASE.match(line)
    if found is None:
        raise ValueError(f"{shown(line)}: expected base hex or dec")
    return found[1].lower(), (found[3] or "absolute").lower()


def _as_known(word: str, moment: datetime | None, *, is_block: bool) -> Iterator[str]:
    """Give the line of a date as the reader knows it."""
    if moment is not None:
        month = _ENGLISH[moment.month - 1]
        yield f"{word} Day {month} {moment:%d %H:%M:%S.%f %Y}\n"
    elif is_block:
        yield f"{word}\n"


def _moment(text: str) -> datetime | None:
    """Read a date, with an English or a German month or as ISO 8601; None where it is none."""
    found = _MOMENT.fullmatch(text)
    try:
        if found is None:
            date = datetime.fromisoformat(text) if _ISO.fullmatch(text) else None
            return date if date is not None and date.year >= _FIRST_YEAR else None
        month, hour, half = found["month"].lower(), int(found["hour"]), found["half"]
        if half is not None:
            if not 1 <= hour <= 12:
                return None
            hour = hour % 12 + (12 if half in "pP" else 0)
        number = next(k for k, names in enumerate(_MONTHS, 1) if month in names)
        microseconds = int(f"{found['fraction'] or '':0<6.6}")
        date = datetime(
            int(found["year"]), number, int(found["day"]), hour,
            int(found["minute"]), int(found["second"]), microseconds,
        )  # fmt: skip
    except (StopIteration, ValueError):
        return None
    return date if date.year >= _FIRST_YEAR else None


def _too_late(line: str) -> ValueError:
    return ValueError(f"{shown(line)} behind the first frame; expected it before")


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
