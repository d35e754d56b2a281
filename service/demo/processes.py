"""The demo's two processes, virtual bench and service, started as a user would start them."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

START_WALL_S = 120.0
STOP_WALL_S = 15.0


class DemoError(RuntimeError):
    """A part of the demo did not start or ended early."""


@contextlib.asynccontextmanager
async def running(
    name: str, arguments: Sequence[str], log: Path
) -> AsyncIterator[tuple[asyncio.subprocess.Process, str]]:
    """Run ``bearing-twin ARGUMENTS`` and yield it with its first line of output.

    Its standard error goes to ``log``. On leaving it gets SIGTERM, and SIGKILL if it does not end.

    Raises
    ------
    DemoError
        If it ends before it has said where it listens.
    """
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "service",
            *arguments,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            stdin=asyncio.subprocess.DEVNULL,
        )
    try:
        if process.stdout is None:
            raise DemoError(f"{name}: no output to read")
        try:
            first = await asyncio.wait_for(process.stdout.readline(), START_WALL_S)
        except TimeoutError:
            raise DemoError(f"{name} did not start within {START_WALL_S:g} s; see {log}") from None
        if not first:
            status = await process.wait()
            raise DemoError(f"{name} ended with status {status}: {_last_line(log)}")
        yield process, first.decode().strip()
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), STOP_WALL_S)
        except TimeoutError:
            process.kill()
            await process.wait()


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "without a word"
