"""A long computation ends cleanly on SIGTERM and SIGINT."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, NoReturn

_AGAIN_S: Final = 1.0


@contextmanager
def exit_on_signals() -> Iterator[None]:
    """Leave the process with status 0 on SIGTERM or SIGINT, from wherever it is at work.

    Files are moved to their places only when complete, so nothing half written stays behind.
    """
    is_said = False

    def leave(number: int, frame: FrameType | None) -> NoReturn:
        nonlocal is_said
        if not is_said:
            is_said = True
            sys.stderr.write("bearing-twin: stopped; nothing is written\n")
        # Python drops an exception in a finalizer or the callback of a weak reference, as each
        # pool of threads has one: a signal comes again until the process has ended.
        signal.signal(signal.SIGALRM, leave)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        sys.exit(0)

    before = {number: signal.signal(number, leave) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        if is_said:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
