"""Work in an event loop that also polls devices: cut into steps, with a pause between two."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, Generator
from contextvars import ContextVar
from typing import Any, Final, TypeVar

Result = TypeVar("Result")

#: Wall seconds of work after which a pause is due.
STEP_S: Final = 0.0005


next_turn: ContextVar[Callable[[], Awaitable[None]] | None] = ContextVar("next_turn", default=None)
"""Waits until work for a caller goes on; None: until all else that is due has had its turn."""


async def _go_round() -> None:
    await asyncio.sleep(0)


class Steps:
    """Cuts long work into steps of `STEP_S`, whatever a piece of it costs.

    Between two pieces ``await steps.pause()``: a poll that is due comes in between.
    """

    def __init__(self) -> None:
        self._begun_s = time.perf_counter()

    async def pause(self) -> None:
        """Let others have their turn where the step has lasted long enough."""
        if time.perf_counter() - self._begun_s >= STEP_S:
            await (next_turn.get() or _go_round)()
            self._begun_s = time.perf_counter()


class MeasuredCoroutine(Coroutine[Any, Any, Result]):
    """A coroutine of which each step, from one wait to the next, is measured.

    Parameters
    ----------
    work : coroutine
        What is done.
    note : callable
        Called after each step with its processor seconds in this thread.
    """

    def __init__(self, work: Coroutine[Any, Any, Result], note: Callable[[float], None]) -> None:
        self._work = work
        self._note = note

    def send(self, value: Any) -> Any:
        """Go on to the next wait."""
        return self._step(self._work.send, value)

    def throw(self, *error: Any) -> Any:
        """Go on to the next wait with an error."""
        return self._step(self._work.throw, *error)

    def close(self) -> None:
        """End it."""
        self._work.close()

    def __await__(self) -> Generator[Any, Any, Result]:
        """Wait for its end; only a task of its own is measured."""
        return self._work.__await__()

    def _step(self, go_on: Callable[..., Any], *arguments: Any) -> Any:
        begun_s = time.thread_time()
        try:
            return go_on(*arguments)
        finally:
            self._note(time.thread_time() - begun_s)
