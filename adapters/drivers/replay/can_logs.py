"""Frames of recorded CAN logs, ASC and BLF."""

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

from adapters.configuration import ConfigurationError
from adapters.drivers.replay.asc_log import AscText, encoding
from adapters.words import one_line

if TYPE_CHECKING:
    import can

# What python-can raises for a log that is damaged, or in a dialect it does not know.
_DAMAGED = (ValueError, LookupError, TypeError, ArithmeticError, OSError, EOFError)


@contextmanager
def open_log(path: Path, *, needs_dates: bool) -> Iterator[Iterator["can.Message"]]:
    """Open a log and give its frames with their times, in seconds since the epoch.

    The date of an ASC file has no time zone: it counts as the local time of this machine. Without
    a date times count from zero; ``needs_dates`` refuses one in a form that is not known. Frames
    without a time are left out. Raises `ConfigurationError` if the log cannot be read, also in the
    middle of it, and at the end of one that is cut.
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
                if not has_ended():
                    why = str(error) or "no object follows"
                    raise wrong(f"cannot be read further than {read} frames ({why})") from error
                frame = None
            if frame is None:
                if was_cut():
                    raise wrong(f"is cut behind {read} frames: its last part is not whole")
                return
            if read == 0 and getattr(log, "timestamps_format", None) == "relative":
                raise wrong("times count from frame to frame; expected a log of absolute times")
            read += 1
            if math.isfinite(frame.timestamp):
                yield frame

    has_ended: Callable[[], bool] = bool
    was_cut: Callable[[], bool]
    with ExitStack() as stack:
        try:
            if path.suffix.lower() == ".asc":
                file = stack.enter_context(path.open(encoding=encoding(path), errors="replace"))
                text = AscText(file, needs_dates=needs_dates)
                log: can.io.generic.MessageReader = can.ASCReader(
                    cast("TextIO", text), relative_timestamp=False
                )
                was_cut = partial(getattr, text, "is_cut")
            else:
                from adapters.drivers.replay import blf_log

                log = blf = blf_log.CheckedBlfReader(stack.enter_context(path.open("rb")))
                was_cut = partial(blf_log.is_cut, path, blf)
                has_ended = partial(blf_log.has_ended, path, blf)
        except damaged as error:
            raise wrong(f"cannot be read ({error})") from error
        yield frames()
