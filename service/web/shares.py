"""Fair shares: this many turns at once for everybody together and for each caller."""

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Executor
from typing import TypeVar

from service.domain.errors import BearingTwinError

Result = TypeVar("Result")

_WORDS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]


class BusyError(BearingTwinError):
    """A caller has as many turns, and waits for as many, as it may; the text says at what."""


class Shares:
    """Turns at something that costs much; used in one event loop.

    Callers take turns one after the other, however many of them one caller asks for.

    - ``what``: what the turns are at, in the plural, for the refusal.
    - ``at_once``: turns at the same time.
    - ``at_once_each``: of those, turns of one caller.
    - ``waiting_each``: how many more a caller may wait for; who asks for yet another is refused.
    - ``waiting``: how many all callers together may wait for.
    """

    def __init__(
        self,
        what: str,
        *,
        at_once: int,
        at_once_each: int,
        waiting_each: int = 0,
        waiting: int = 1000,
    ) -> None:
        self._what = what
        self._at_once, self._at_once_each = at_once, at_once_each
        self._waiting_each, self._waiting = waiting_each, waiting
        self._running: Counter[str] = Counter()
        self._queues: dict[str, deque[asyncio.Future[None]]] = {}
        # Numbers of the last turns of those who wait or have one: the longest ago is the next.
        self._last: dict[str, int] = {}
        self._turns = 0

    @contextlib.asynccontextmanager
    async def turn(self, caller: str) -> AsyncIterator[None]:
        """Wait for a turn and have it until the end of the context.

        Raises `BusyError` if the caller may not wait for any more.
        """
        await self.enter(caller)
        try:
            yield
        finally:
            self.leave(caller)

    async def enter(self, caller: str) -> None:
        """Wait for a turn; `leave` must follow."""
        queue = self._queues.get(caller, ())
        total = sum(map(len, self._queues.values()))
        if not self._is_free(caller) and (
            len(queue) >= self._waiting_each or total >= self._waiting
        ):
            raise BusyError(self._refusal(caller))
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._queues.setdefault(caller, deque()).append(turn)
        self._give()
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self.leave(caller)  # it was given at the last moment
            else:
                self._forget(caller, turn)
            raise

    def leave(self, caller: str) -> None:
        """Give a turn back."""
        self._running[caller] -= 1
        if not self._running[caller]:
            del self._running[caller]
            if caller not in self._queues:
                self._last.pop(caller, None)
        self._give()

    async def run(
        self, caller: str, executor: Executor, work: Callable[..., Result], *arguments: object
    ) -> Result:
        """Wait for a turn and work in a thread; as `hold`."""
        loop = asyncio.get_running_loop()
        return await self.hold(caller, lambda: loop.run_in_executor(executor, work, *arguments))

    async def hold(self, caller: str, begin: Callable[[], Awaitable[Result]]) -> Result:
        """Wait for a turn and work; the turn lasts as long as the work does.

        Also where the caller has gone meanwhile: a thread cannot be stopped.
        """
        await self.enter(caller)
        try:
            working = asyncio.ensure_future(begin())
        except BaseException:
            self.leave(caller)
            raise

        def done(future: "asyncio.Future[Result]") -> None:
            self.leave(caller)
            if not future.cancelled():
                future.exception()  # looked at, also where no caller waits for it any more

        working.add_done_callback(done)
        return await asyncio.shield(working)

    def _refusal(self, caller: str) -> str:
        """Why a caller may not wait: its own share is full, or what all callers share."""
        own = self._running[caller] + len(self._queues.get(caller, ()))
        if own < self._at_once_each + self._waiting_each:
            return f"busy: too many {self._what} for other callers at the moment"
        count = _WORDS[own] if own < len(_WORDS) else str(own)
        what, are = (self._what, "are") if own != 1 else (self._what.removesuffix("s"), "is")
        return f"busy: {count} {what} {are} running with this key"

    def _is_free(self, caller: str) -> bool:
        return (
            self._running.total() < self._at_once
            and self._running[caller] < self._at_once_each
            and caller not in self._queues
        )

    def _give(self) -> None:
        """Hand out what is free, to each caller in turn."""
        while self._running.total() < self._at_once:
            able = [one for one in self._queues if self._running[one] < self._at_once_each]
            if not able:
                return
            caller = min(able, key=lambda one: self._last.get(one, 0))
            queue = self._queues[caller]
            turn = queue.popleft()
            if not queue:
                del self._queues[caller]
            if not turn.done():  # else its caller has gone
                self._turns += 1
                self._last[caller] = self._turns
                self._running[caller] += 1
                turn.set_result(None)

    def _forget(self, caller: str, turn: "asyncio.Future[None]") -> None:
        queue = self._queues.get(caller)
        if queue is not None and turn in queue:
            queue.remove(turn)
            if not queue:
                del self._queues[caller]
