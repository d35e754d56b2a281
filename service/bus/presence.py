"""A process that tells the cell that it is there."""

import asyncio
import contextlib
import os
from pathlib import Path
from typing import Final, Literal

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import generate_latest

from service.bus.commands import Present
from service.bus.interface import ReaderBus
from service.domain.errors import CellUnavailableError

TELL_EVERY_S: Final = 2.0


async def tell_presence(
    reader: ReaderBus,
    process: Literal["web", "plant"],
    registry: CollectorRegistry | None = None,
) -> None:
    """Tell the cell that this process is there, until cancelled.

    Parameters
    ----------
    reader : ReaderBus
        The way to the cell.
    process : str
        What the process is called.
    registry : CollectorRegistry, optional
        Its metrics, where it does not show them itself.
    """
    while True:
        metrics = b"" if registry is None else generate_latest(registry)
        with contextlib.suppress(CellUnavailableError):
            await reader.ask(Present(process, resident_bytes(), metrics), TELL_EVERY_S)
        await asyncio.sleep(TELL_EVERY_S)


def resident_bytes() -> int:
    """Memory of this process; from the kernel's memory, not from a disk."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
