"""The compiled kernels of the live twin, which the cell does without until they are there."""

import asyncio
import sys
from typing import Final

import structlog
from anyio import to_thread

from service.loading import loading
from service.tasks import Part

#: Kernels that a first start compiles, for the progress.
KERNELS: Final = 66

_log = structlog.get_logger(__name__)


class Kernels(Part):
    """Loads the kernels, or has them compiled by a process of its own first.

    Compiling takes 20 s of processor time. In the process of the cell it would delay every poll;
    devices are read meanwhile, values are stored and shown, and limits are watched.

    Parameters
    ----------
    ready : bool
        Whether they are loaded already.

    Attributes
    ----------
    ready : asyncio.Event
        Set when they are loaded.
    """

    name = "kernels"

    def __init__(self, ready: bool) -> None:
        self.ready = asyncio.Event()
        self._compiled = 0
        if ready:
            self.ready.set()

    @property
    def progress(self) -> str:
        """One line about what is being compiled; empty when all is loaded."""
        if self.ready.is_set():
            return ""
        share = min(self._compiled / KERNELS, 0.99)
        return (
            f"the twin is being compiled, which only the first start does: {share:.0%}; measured "
            "values are stored, shown and compared with their limits; estimates and forecasts "
            "follow"
        )

    async def run(self) -> None:
        """Compile and load what is missing, until cancelled."""
        if not self.ready.is_set():
            try:
                await self._compile()
            except OSError as error:  # no room for a process
                _log.error("kernels_not_compiled", error=str(error), instead="compiled by the cell")
            await to_thread.run_sync(_compile_here)
            self.ready.set()
            _log.info("twin_loaded")
        await asyncio.Event().wait()

    async def _compile(self) -> None:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "service", "warm-up", "--live"),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            if process.stdout is not None:
                async for _ in process.stdout:  # one line for each kernel
                    self._compiled += 1
            status = await process.wait()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if status:
            _log.error("kernels_not_compiled", status=status, instead="compiled by the cell")


def _compile_here() -> None:
    with loading():
        from service.kernels import compile_live_kernels

        compile_live_kernels()
