"""Work next to work: what works as long as its process does, and ends it if it ever fails."""

import asyncio
import contextlib
from collections.abc import (
    AsyncIterator,
    Awaitable,
    Callable,
    Collection,
    Coroutine,
    Mapping,
    Sequence,
)
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
    """Run a task next to the rest; should it ever end, the service stops.

    Parameters
    ----------
    work : coroutine
        What is to be done until it is cancelled.
    name : str
        What the log calls it.
    stop : asyncio.Event
        Is set when the work ends without a stop.
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


class Part:
    """What works in a process as long as that runs: one life cycle for all of them.

    `start` begins the work of `run`. `stop` ends it; it may be called without `start`, and twice,
    and when it returns nothing of the part works any more. The holder of parts asks all of them
    alike for what is wrong and for what they answer, and announces assets that come and go.

    Attributes
    ----------
    name : str
        What the log calls it.
    is_first : bool
        Whether it starts before the others and stops after them: it takes what these still bring.
    """

    name: str = ""
    is_first: bool = False
    _life: contextlib.AsyncExitStack | None = None

    async def run(self) -> None:
        """Work until cancelled."""
        await asyncio.Event().wait()

    async def start(self, stop: asyncio.Event) -> None:
        """Begin to work; ``stop`` is set when the work fails."""
        self._life = contextlib.AsyncExitStack()
        await self._life.enter_async_context(background(self.run(), self.name, stop))

    async def stop(self) -> None:
        """End the work."""
        running, self._life = self._life, None
        if running is not None:
            await running.aclose()

    def problems(self) -> Mapping[str, str | None]:
        """What is wrong with it, by the name of the check; None where all is well."""
        return {}

    def handlers(self) -> Mapping[type, Callable[[Any], Awaitable[Any]]]:
        """What it answers, by the type of the command."""
        return {}

    def alarm_changed(self, alarm: Any) -> None:
        """Note that an alarm has changed; returns at once, from any thread."""

    def clock_set(self, by_us: int) -> None:
        """Move the times from which spans are counted: process time was set by so much.

        Returns at once. Alarms have their times from before still; they are moved next.
        """

    def keep_moved(self) -> None:
        """Have written what was moved as it was loaded: the clock was set since the last run."""

    def settle(self, twin: Any) -> None:
        """Prepare what follows an asset, new or made again."""

    def take_over(self, assets: Collection[str] | None) -> None:
        """Go on with some assets, or with all, where an earlier run ended; may read the store."""

    def read_store(self) -> None:
        """Read from the store what there is before any asset is followed."""

    async def apply_changes(self) -> None:
        """Put into effect what has changed in the store; returns when it is."""

    def expire(self, now_us: int) -> int:
        """Remove what is older than is configured, from the store too; returns how many rows.

        ``now_us``: process time from which the days count; it may lag behind the clock.
        """
        return 0

    def leave(self, assets: Sequence[str]) -> None:
        """Know nothing of some assets any more: another process goes on with them."""


class Working(Part):
    """A part that is its work and nothing else."""

    def __init__(self, name: str, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self.name = name
        self._work = work

    async def run(self) -> None:
        """Work until cancelled."""
        await self._work()


def _cancel_sources_again() -> None:
    """Cancel the tasks of drivers that have missed their cancellation.

    `asyncio.wait_for` of Python 3.11, which pymodbus uses, swallows a cancellation that comes
    together with the answer it waits for; the driver would then poll without end.
    """
    for task in asyncio.all_tasks():
        if task.get_name().startswith("source "):
            _log.warning("source_cancelled_again", task=task.get_name())
            task.cancel()
