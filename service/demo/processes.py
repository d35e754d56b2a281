"""The demo's processes, virtual bench and service, started as a user would start them."""

import asyncio
import contextlib
import os
import shutil
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from pathlib import Path

from service.domain.errors import BearingTwinError

#: Long: the first start compiles the kernels, and this may be a slow machine.
START_WALL_S = 900.0
STOP_WALL_S = 15.0


class DemoError(BearingTwinError, RuntimeError):
    """A part of the demo did not start or ended early.

    ``status``: exit status of the demo: 2 where the part found something that the user can mend.
    """

    def __init__(self, text: str, status: int = 1) -> None:
        super().__init__(text)
        self.status = status


class Process:
    """A running ``bearing-twin`` command.

    ``first_line``: its first line of output, which says where it listens.
    """

    def __init__(self, name: str, process: asyncio.subprocess.Process, log: Path) -> None:
        self.first_line = ""
        self._name = name
        self._process = process
        self._log = log

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether it has ended, for whatever reason."""
        return self._process.returncode is not None

    async def wait(self) -> None:
        """Wait for its end."""
        await self._process.wait()

    def error(self) -> DemoError:
        """What to say of its untimely end."""
        lines = self._log.read_text(errors="replace").strip().splitlines()
        status = self._process.returncode
        if status == 2 and lines:
            return DemoError(lines[-1].removeprefix("bearing-twin: "), status)
        last = f": {lines[-1]}" if lines else ""
        return DemoError(f"the {self._name} ended with status {status}{last}")


@contextlib.contextmanager
def folder_of(prefix: str) -> Iterator[Path]:
    """Give a folder for data and logs, which is kept when the demo fails, however it does."""
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    try:
        yield folder
    except DemoError as error:
        raise DemoError(f"{error}; data and logs are kept in {folder}", error.status) from error
    except Exception as error:
        error.add_note(f"data and logs are kept in {folder}")
        raise
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)


@contextlib.asynccontextmanager
async def running(
    name: str, arguments: Sequence[str], log: Path, environment: Mapping[str, str] = os.environ
) -> AsyncIterator[Process]:
    """Run ``bearing-twin ARGUMENTS`` and yield it once it has said its first line.

    Its standard error goes to ``log``. On leaving it gets SIGTERM, and SIGKILL if it does not end.
    Raises `DemoError` if it ends before it has said where it listens.
    """
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "service",
            *arguments,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            env=environment,
            stdin=asyncio.subprocess.DEVNULL,
            # Ctrl-C is for the demo alone: it still has to ask the service for the account.
            process_group=0,
        )
    started = Process(name, process, log)
    try:
        if process.stdout is None:
            raise DemoError(f"{name}: no output to read")
        try:
            async with asyncio.timeout(START_WALL_S):
                first = await process.stdout.readline()
        except TimeoutError:
            raise DemoError(f"the {name} did not start within {START_WALL_S:g} s") from None
        if not first:
            await process.wait()
            raise started.error()
        started.first_line = first.decode().strip()
        yield started
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(STOP_WALL_S):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
