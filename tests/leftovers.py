"""A test that leaves a task, a thread, a process or an open port behind fails.

What fixtures of a module or of the session hold open was there before the test began.
"""

import asyncio
import contextlib
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
from patience import patience
from pytest_asyncio import is_async_test

#: What ends needs a moment until the system has noted it.
PATIENCE_S = 5.0
#: Helpers of Python's own that live as long as the process, by words of their command lines.
LASTING = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")
#: Threads of the loop of an asynchronous test, which ends after all fixtures.
OF_THE_LOOP = "asyncio_"
_LISTENS = "0A"


def processes() -> Counter[str]:
    """Children of this process that run and are not Python's own, by their command lines.

    One that a test ends and starts again is the same.
    """
    found: Counter[str] = Counter()
    for children in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # the thread, or the child, has ended
            for child in children.read_text().split():
                words = _command(Path("/proc", child))
                if words and not any(name in words for name in LASTING):
                    found[words[:120]] += 1
    return found


def _command(process: Path) -> str:
    """What a process runs; one that is just being made has no words for a moment."""
    for _ in range(20):
        words = (process / "cmdline").read_text().replace("\0", " ")
        if words or (process / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
            return words
        time.sleep(0.005)
    return ""


def threads() -> set[threading.Thread]:
    """Threads of Python that run."""
    return {one for one in threading.enumerate() if not one.name.startswith(OF_THE_LOOP)}


def sockets() -> set[str]:
    """Sockets that this process holds, by their numbers in the system."""
    held = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the one of this very look
            target = str(descriptor.readlink())
            if target.startswith("socket:["):
                held.add(target[8:-1])
    return held


def ports(of: set[str]) -> set[str]:
    """Which of some sockets listen on a TCP port: their addresses."""
    listening = set()
    for table in ("tcp", "tcp6"):
        for line in Path("/proc/self/net", table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTENS and fields[9] in of:
                listening.add(fields[1])
    return listening


def _gone(left: Callable[[], set[str]]) -> set[str]:
    """What is still left after some patience."""
    deadline = time.monotonic() + patience(PATIENCE_S)
    while (found := left()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return found


@pytest.fixture
async def no_task_left() -> AsyncIterator[None]:
    yield
    deadline = time.monotonic() + patience(PATIENCE_S)
    while len(asyncio.all_tasks()) > 1 and time.monotonic() < deadline:  # noqa: ASYNC110 - of tests
        await asyncio.sleep(0.01)
    left = asyncio.all_tasks() - {asyncio.current_task()}
    assert not left, f"tasks left behind: {left}"


@pytest.fixture(autouse=True)
def nothing_left(request: pytest.FixtureRequest) -> Iterator[None]:
    if is_async_test(request.node):
        request.getfixturevalue("no_task_left")
    had_processes, had_threads, had_sockets = processes(), threads(), sockets()
    yield
    left = _gone(lambda: set(processes() - had_processes))
    assert not left, f"processes left behind: {left}"
    left = _gone(lambda: {one.name for one in threads() - had_threads})
    assert not left, f"threads left behind: {left}"
    left = _gone(lambda: ports(new) if (new := sockets() - had_sockets) else set())
    assert not left, f"ports left open: {left}"
