"""The time of the cell's event loop, shared out among those who ask."""

import asyncio
import math
import time
from collections import deque
from typing import Final

#: Share of the loop's time that all callers have together; polls and twins have the rest.
CALLERS_SHARE: Final = 0.6
#: Processor seconds that may be used beyond that at once.
_AHEAD_S: Final = 0.004
#: Seconds after which two thirds of what a caller has used are forgotten.
_MEMORY_S: Final = 1.0


class LoopShare:
    """Gives one step at a time to those who wait, and between two steps all else has its turn.

    The next step is of the caller whose steps have cost least in the last second or so: who asks
    for much waits, and no other caller waits for it.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}
        self._used: dict[str, tuple[float, float]] = {}
        self._giving = False
        self._debt_s, self._paid_s = 0.0, time.monotonic()

    def waiting(self, caller: str) -> int:
        """How many steps a caller waits for."""
        return len(self._waiting.get(caller, ()))

    async def turn(self, caller: str) -> None:
        """Wait for the next step."""
        loop = asyncio.get_running_loop()
        turn = loop.create_future()
        self._waiting.setdefault(caller, deque()).append(turn)
        if not self._giving:
            self._giving = True
            loop.call_soon(self._give)
        await turn

    def charge(self, caller: str, seconds: float) -> None:
        """Note what a step has cost."""
        now_s = time.monotonic()
        self._used[caller] = self._cost_s(caller, now_s) + seconds, now_s
        self._debt_s = self._debt_now_s(now_s) + seconds
        self._paid_s = now_s

    def _cost_s(self, caller: str, now_s: float) -> float:
        used_s, at_s = self._used.get(caller, (0.0, now_s))
        return used_s * math.exp((at_s - now_s) / _MEMORY_S)

    def _debt_now_s(self, now_s: float) -> float:
        """Processor seconds that callers have had beyond their share."""
        return max(self._debt_s - CALLERS_SHARE * (now_s - self._paid_s), 0.0)

    def _give(self) -> None:
        """Let the next caller go on; then the loop goes round once."""
        loop, now_s = asyncio.get_running_loop(), time.monotonic()
        rest_s = (self._debt_now_s(now_s) - _AHEAD_S) / CALLERS_SHARE
        if rest_s > 0.0:
            loop.call_later(rest_s, self._give)
            return
        while self._waiting:
            caller = min(self._waiting, key=lambda one: self._cost_s(one, now_s))
            turns = self._waiting[caller]
            turn = turns.popleft()
            if not turns:
                del self._waiting[caller]
            if not turn.done():  # else its caller has left
                turn.set_result(None)
                loop.call_soon(self._give)
                return
        self._giving = False
        self._used = {
            one: used for one, used in self._used.items() if now_s - used[1] < 10 * _MEMORY_S
        }
