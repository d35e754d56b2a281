"""The processes of a fleet, kept up as systemd would: one that ends is started again."""

import asyncio
import contextlib
import os
import random
import signal
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from service.demo.processes import START_WALL_S, STOP_WALL_S, DemoError

#: Wall seconds after which a part that has ended is started again.
AGAIN_AFTER_S = 1.0
_LOOK_EVERY_S = 0.05


def own_command(*arguments: str) -> list[str]:
    """Give the command line of a ``bearing-twin`` command."""
    return [sys.executable, "-m", "service", *arguments]


class Part:
    """A process that is started again whenever it ends.

    - ``name``: for people; also names its log.
    - ``command``: its command line.
    - ``folder``: where its log goes.
    - ``environment``: beside that of this process.
    - ``port``: it is ready when this port of 127.0.0.1 is open; without it, when it has said a
      line.
    - ``again_after_s``: wall seconds after which it is started again when it has ended.

    - ``first_line``: what it said first, last time.
    - ``ready_s``: when it was ready last time, on the monotonic clock.
    - ``ends``: how often it has ended so far.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        folder: Path,
        environment: Mapping[str, str] | None = None,
        port: int | None = None,
        again_after_s: float = AGAIN_AFTER_S,
    ) -> None:
        self.name = name
        self.first_line = ""
        self.ready_s = 0.0
        self.ends = 0
        self.log = folder / f"{name.replace(' ', '-')}.log"
        self._command = list(command)
        self._environment = {**os.environ, **(environment or {})}
        self._port = port
        self._again_after_s = again_after_s
        self._process: asyncio.subprocess.Process | None = None
        self._ready = asyncio.Event()
        self._keeping: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int:
        """Its process id."""
        if self._process is None:
            raise DemoError(f"{self.name}: not started")
        return self._process.pid

    @property
    def is_ready(self) -> bool:
        """Whether it has been ready since its last start."""
        return self._ready.is_set()

    async def start(self) -> None:
        """Start it, wait until it is ready, and keep it up from then on.

        Raises `DemoError` if it ends, or is not ready in time.
        """
        self._keeping = asyncio.create_task(self._keep())
        ready = asyncio.create_task(self._ready.wait())
        await asyncio.wait(
            {ready, self._keeping}, timeout=START_WALL_S, return_when=asyncio.FIRST_COMPLETED
        )
        ready.cancel()
        if self._keeping.done():
            await self._keeping
        if not self._ready.is_set():
            raise DemoError(f"the {self.name} did not start within {START_WALL_S:g} s")

    async def is_up_again(self) -> None:
        """Wait until it is ready."""
        async with asyncio.timeout(START_WALL_S):
            await self._ready.wait()

    def send(self, number: signal.Signals) -> None:
        """Send a signal to its process."""
        if number == signal.SIGKILL:
            self._ready.clear()
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, number)

    async def end(self) -> None:
        """End it for good: SIGTERM, and SIGKILL if that does not do."""
        if self._keeping is not None:
            self._keeping.cancel()
            await asyncio.gather(self._keeping, return_exceptions=True)
        process = self._process
        if process is None or process.returncode is not None:
            return
        for number, patience_s in ((signal.SIGTERM, STOP_WALL_S), (signal.SIGKILL, None)):
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.send_signal(number)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience_s):
                    await process.wait()
                    return

    async def _keep(self) -> None:
        while True:
            with self.log.open("ab") as errors:
                process = self._process = await asyncio.create_subprocess_exec(
                    *self._command,
                    env=self._environment,
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=errors,
                    process_group=0,  # Ctrl-C is for the demo alone
                )
            began_ready = asyncio.create_task(self._until_ready(process))
            status = await process.wait()
            began_ready.cancel()
            first = not self.ready_s
            self._ready.clear()
            self.ends += 1
            if first:
                lines = self.log.read_text(errors="replace").strip().splitlines()
                raise DemoError(
                    f"the {self.name} ended with status {status}: {lines[-1] if lines else ''}"
                )
            await asyncio.sleep(self._again_after_s)

    async def _until_ready(self, process: asyncio.subprocess.Process) -> None:
        if self._port is None:
            assert process.stdout is not None  # noqa: S101
            line = await process.stdout.readline()
            if not line:
                return
            self.first_line = line.decode().strip()
        else:
            while True:
                if await is_open(self._port):
                    break
                await asyncio.sleep(_LOOK_EVERY_S)
        self.ready_s = time.monotonic()
        self._ready.set()


async def is_open(port: int) -> bool:
    """Return whether a program listens on a port of 127.0.0.1."""
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
    except OSError:
        return False
    writer.close()
    return True


def free_port() -> int:
    """Give a free port, below those that outgoing connections are given."""
    while True:
        port = random.randrange(20_000, 32_000)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
