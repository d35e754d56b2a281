"""Work next to work: a task that ends by itself ends the service."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import structlog

CANCEL_AGAIN_WALL_S = 1.0
#: The task of the drivers and the writer.
INGEST = "ingest"

Work = tuple[str, Callable[[], Coroutine[Any, Any, None]]]
"""Name of a task and its work, which goes on until it is cancelled."""

_log = structlog.get_logger(__name__)


@contextlib.asynccontextmanager
async def background(
    work: Coroutine[Any, Any, None], name: str, stop: asyncio.Event
) -> AsyncIterator[None]:
    """Run a task next to the rest; should it ever end by itself, the service stops.

    Parameters
    ----------
    work : coroutine
        What is to be done until it is cancelled.
    name : str
        What the log calls it.
    stop : asyncio.Event
        Is set when the work ends by itself.
    """
    task = asyncio.create_task(work, name=name)

    def ended(done: "asyncio.Task[None]") -> None:
        if not done.cancelled():
            error = done.exception()
            _log.error("task_ended", task=name, exc_info=error)
            stop.set()

    task.add_done_callback(ended)
    try:
        yield
    finally:
        task.remove_done_callback(ended)
        task.cancel()
        while not task.done():
            await asyncio.wait({task}, timeout=CANCEL_AGAIN_WALL_S)
            if name == INGEST and not task.done():
                _cancel_sources_again()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def _cancel_sources_again() -> None:
    """Cancel the tasks of drivers that have missed their cancellation.

    `asyncio.wait_for` of Python 3.11, which pymodbus uses, swallows a cancellation that comes
    together with the answer it waits for; the driver would then poll without end.
    """
    for task in asyncio.all_tasks():
        if task.get_name().startswith("source "):
            _log.warning("source_cancelled_again", task=task.get_name())
            task.cancel()
