"""An event loop whose clock jumps to the next event, so that a test of hours takes milliseconds.

As trio's `MockClock` with autojump: when nothing can run and nothing is waited for but a time, it
is that time at once. While it waits for a thread that computes, or for a socket or another process
that may answer, the clock runs as any other. While the loop itself computes, it stands: no test
fails because its machine is slow. (The package `looptime` does not see threads, and lets time-outs
pass while one computes.)
"""

import asyncio
import selectors
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import anyio.to_thread
import pytest

_OWN_FILES = 1  # the end of the pipe by which threads wake a loop


class _Selector(selectors.DefaultSelector):
    loop: "JumpingLoop"

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        if timeout is None or self.loop.working or len(self.get_map()) > _OWN_FILES:
            began_s = time.monotonic()
            try:
                return super().select(timeout)
            finally:
                self.loop.passed_s += time.monotonic() - began_s
        self.loop.passed_s += timeout
        return []


class JumpingLoop(asyncio.SelectorEventLoop):
    """See the module."""

    def __init__(self) -> None:
        self.passed_s = 0.0
        self.working = 0
        selector = _Selector()
        selector.loop = self
        super().__init__(selector)
        # What is due at a time runs at it: a sum of years and nanoseconds is not exact.
        self._clock_resolution = 1e-6

    def time(self) -> float:
        return self.passed_s

    def run_in_executor(self, *arguments: Any) -> Any:
        future = super().run_in_executor(*arguments)
        self.working += 1
        future.add_done_callback(self._has_worked)
        return future

    def _has_worked(self, _: object) -> None:
        self.working -= 1


@contextmanager
def work() -> Iterator[None]:
    """Time that somebody needs whom the loop does not see: its clock does not jump meanwhile."""
    loop = asyncio.get_running_loop()
    if not isinstance(loop, JumpingLoop):
        yield
        return
    loop.working += 1
    try:
        yield
    finally:
        loop.working -= 1


class LoopClock:
    """Process time of the running loop; a `ProcessClock` for tests whose clock jumps."""

    def __init__(self, rate: float, start_us: int) -> None:
        self.rate = rate
        self._loop = asyncio.get_running_loop()
        self._start_us, self._start_s = start_us, self._loop.time()

    def now_us(self) -> int:
        return self._start_us + round((self._loop.time() - self._start_s) * self.rate * 1e6)

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(max(process_seconds, 0.0) / self.rate)


Loops = dict[str, Callable[[], asyncio.AbstractEventLoop]]


def pytest_asyncio_loop_factories() -> Loops:
    """Run a folder's tests in jumping loops, where its conftest.py imports this hook."""
    return {"jumping": JumpingLoop}


def jumping_in(*files: str) -> Callable[[pytest.Item], Loops]:
    """Make a hook that runs only some files of a folder so."""

    def pytest_asyncio_loop_factories(item: pytest.Item) -> Loops:
        if item.path.name in files:
            return {"jumping": JumpingLoop}
        return {"asyncio": asyncio.new_event_loop}

    return pytest_asyncio_loop_factories


@pytest.fixture(autouse=True)
def seen_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a jumping loop know of anyio's threads; to be imported with a hook above."""
    run_sync = anyio.to_thread.run_sync

    async def seen(*arguments: Any, **options: Any) -> Any:
        with work():
            return await run_sync(*arguments, **options)

    monkeypatch.setattr(anyio.to_thread, "run_sync", seen)
