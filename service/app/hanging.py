"""Judges whether a process that gives no sign of life hangs, or waits for a busy machine."""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

#: Wall seconds of silence in which none of its threads ran, or processor seconds that its main
#: thread used without a sign of life: after either a process hangs.
HUNG_S = 4.0
_PROC = Path("/proc")
#: States of a thread that would go on if the machine let it: running or ready to, or at the disk.
_WOULD_GO_ON = frozenset(b"RD")
_STATE, _USER, _SYSTEM = 0, 11, 12


@dataclass(frozen=True, slots=True)
class Look:
    """What a look at a process shows.

    ``waits_for_machine``: a thread of it has work and waits for the processor or the disk;
    ``processor_s``: processor time of its main thread so far.
    """

    waits_for_machine: bool
    processor_s: float


class SilentTime:
    """The silence of a process since its last sign of life."""

    def __init__(self, now_s: float) -> None:
        self._since_s = now_s
        self._began_processor_s: float | None = None
        self._waited_for_machine = False

    def lasts_s(self, now_s: float) -> float:
        """Seconds since the last sign of life."""
        return now_s - self._since_s

    def excuse(self) -> None:
        """Take the machine for busy: only the longest silence is that of a process that hangs."""
        self._waited_for_machine = True

    def is_hanging(self, look: Look | None, now_s: float, limit_s: float) -> bool:
        """Judge, after another look at the process.

        ``look``: None where the system shows nothing of its processes; ``limit_s``: after such a
        silence a process hangs, however busy the machine is.
        """
        silent_s = self.lasts_s(now_s)
        if silent_s > limit_s:
            return True
        if look is None:
            return False
        if look.waits_for_machine:
            self.excuse()
        if self._began_processor_s is None:
            self._began_processor_s = look.processor_s
        hung_s = min(HUNG_S, limit_s)
        if look.processor_s - self._began_processor_s > hung_s:
            return True
        return silent_s > hung_s and not self._waited_for_machine


def look_at(pid: int) -> Look | None:
    """Look at a process; None where it is gone, or where the system does not show it."""
    waits, processor_s = False, None
    with contextlib.suppress(OSError):
        for thread in (_PROC / str(pid) / "task").iterdir():
            with contextlib.suppress(OSError):  # a thread that has just ended
                # The name of a thread may hold anything; behind its last bracket are the numbers.
                fields = (thread / "stat").read_bytes().rpartition(b")")[2].split()
                waits |= fields[_STATE][0] in _WOULD_GO_ON
                if thread.name == str(pid):
                    ticks = int(fields[_USER]) + int(fields[_SYSTEM])
                    processor_s = ticks / os.sysconf("SC_CLK_TCK")
    return None if processor_s is None else Look(waits, processor_s)
