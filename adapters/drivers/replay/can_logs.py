"""Frames of recorded CAN logs, ASC and BLF."""

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.configuration import ConfigurationError
from adapters.words import one_line

if TYPE_CHECKING:
    import can

# What python-can raises for a log that is damaged, or in a dialect it does not know.
_DAMAGED = (ValueError, LookupError, TypeError, ArithmeticError, OSError, EOFError)
_HEADER_BYTES = 4096


@contextmanager
def open_log(path: Path) -> Iterator[Iterator["can.Message"]]:
    """Open a log and give its frames with their times, in seconds since the epoch.

    The date of an ASC file has no time zone: it counts as the local time of this machine. Without
    a date times count from zero. Frames without a time are left out. Raises `ConfigurationError`
    if the log cannot be read, also in the middle of it.
    """
    import can
    from can.io.blf import BLFParseError

    damaged = (*_DAMAGED, can.CanError, BLFParseError, struct.error, zlib.error)

    def wrong(text: str) -> ConfigurationError:
        return ConfigurationError(f"file {str(path)!r}: {one_line(text)}")

    def frames() -> Iterator["can.Message"]:
        found, read = iter(log), 0
        while True:
            try:
                frame = next(found, None)
            except damaged as error:
                raise wrong(f"cannot be read further than {read} frames ({error})") from error
            if frame is None:
                return
            if read == 0 and getattr(log, "timestamps_format", None) == "relative":
                raise wrong("times count from frame to frame; expected a log of absolute times")
            read += 1
            if math.isfinite(frame.timestamp):
                yield frame

    with ExitStack() as stack:
        try:
            if path.suffix.lower() == ".asc":
                text = stack.enter_context(path.open(encoding=_encoding(path), errors="replace"))
                log: can.io.generic.MessageReader = can.ASCReader(text, relative_timestamp=False)
            else:
                log = can.BLFReader(stack.enter_context(path.open("rb")))
        except damaged as error:
            raise wrong(f"cannot be read ({error})") from error
        yield frames()


def _encoding(path: Path) -> str:
    """Encoding of a text: UTF-8, or the one of Windows where its head is none of it."""
    with path.open("rb") as file:
        # A character that is cut in two at the end does no harm.
        head = file.read(_HEADER_BYTES).rpartition(b"\n")[0]
    try:
        head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"
