"""A test without the mark `wires` or `browser` opens no connection and starts no process.

So `make check` stays quick and runs wherever Python runs. Unix sockets and pipes, with which a loop
wakes itself, do not count.
"""

import socket
import sys
from collections.abc import Iterator

import pytest

MARKS = ("wires", "browser")
_CALLS = {
    "socket.bind": "binds a socket",
    "socket.connect": "connects a socket",
    "subprocess.Popen": "starts a process",
    "os.fork": "forks",
    "os.posix_spawn": "starts a process",
}
#: The test without one of the marks that runs now.
_unmarked: list[str] = []


class ReachesOutsideError(BaseException):
    """A test without a mark reached out of its process; no handler of the product takes it."""


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if _unmarked and event in _CALLS:
        (first, *_) = arguments or (None,)
        if not isinstance(first, socket.socket) or first.family != socket.AF_UNIX:
            raise ReachesOutsideError(
                f"{_unmarked[-1]} {_CALLS[event]}: it needs pytest.mark.wires"
            )


sys.addaudithook(_watch)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Watch the test itself; what its fixtures start is seen in `leftovers`."""
    if not any(item.get_closest_marker(mark) for mark in MARKS):
        _unmarked.append(item.nodeid)
    try:
        yield
    finally:
        _unmarked.clear()
