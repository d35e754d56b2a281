"""A process reports to the cell that it runs."""

import asyncio
import contextlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, Literal

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import generate_latest

from service.bus.calls import call
from service.bus.commands import Presence, Present
from service.bus.interface import ReaderBus
from service.domain.errors import CellUnavailableError

HEARTBEAT_S: Final = 2.0


async def report_presence(
    reader: ReaderBus,
    process: Literal["web", "plant"],
    registry: CollectorRegistry | None = None,
    publishers: Callable[[], Mapping[str, str]] = dict,
) -> None:
    """Report to the cell that this process runs, until cancelled.

    Parameters
    ----------
    reader : ReaderBus
        The way to the cell.
    process : str
        What the process is called.
    registry : CollectorRegistry, optional
        Its metrics, where it does not show them itself.
    publishers : callable, optional
        What is wrong with each of its publishers; empty where one hands everything on.
    """
    while True:
        metrics = b"" if registry is None else generate_latest(registry)
        with contextlib.suppress(CellUnavailableError):
            present = Present(process, resident_bytes(), metrics, dict(publishers()))
            await reader.ask(call(Presence.present, present), HEARTBEAT_S)
        await asyncio.sleep(HEARTBEAT_S)


def resident_bytes() -> int:
    """Memory of this process; from the kernel's memory, not from a disk."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
