"""Waits for what is not there yet: a store, a lock, a port, room on a disk."""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import structlog
from anyio import to_thread

from adapters.backoff import Backoff
from service.domain.errors import BearingTwinError, TemporaryError

#: Wall seconds that another service is given to leave the data directory or a port. One that is
#: stopped needs fifteen at most.
LEAVE_S = 30.0
#: And the database: a server notices within half a minute that another machine is gone.
LEAVE_DATABASE_S = 60.0
#: Wall seconds between two tries: first, and at most.
_FIRST_S = 0.1
_LAST_S = 2.0
#: The log is reminded so often of the same trouble.
_REMIND_S = 60.0

_log = structlog.get_logger(__name__)

_Found = TypeVar("_Found")


class StoppedError(BearingTwinError):
    """The service is to stop; there is nothing left to wait for."""


class Waiting:
    """What the start of a service waits for.

    Parameters
    ----------
    stop : asyncio.Event
        Ends every wait.
    on_change : callable
        Gets what is waited for now and why, or two empty texts when a wait is over.
    """

    def __init__(self, stop: asyncio.Event, on_change: Callable[[str, str], None]) -> None:
        self._stop = stop
        self._on_change = on_change

    async def until(
        self, what: str, work: Callable[[], _Found], at_most_s: float = math.inf
    ) -> _Found:
        """Do some work in a thread, again and again while it meets trouble that passes.

        Parameters
        ----------
        what : str
            What is waited for, for people.
        work : callable
            Raises `TemporaryError` when it is to be tried again.
        at_most_s : float
            Wall seconds after which such an error is passed on.

        Raises
        ------
        TemporaryError
            When the time is over.
        StoppedError
            When the service is to stop. The thread is not waited for.
        """
        ends_s = time.monotonic() + at_most_s
        backoff, said, said_s = Backoff(_FIRST_S, _LAST_S), "", 0.0
        while True:
            try:
                found = await self._unless_stopped(to_thread.run_sync(work, abandon_on_cancel=True))
            except TemporaryError as error:
                now_s = time.monotonic()
                if now_s >= ends_s or not error.passes:
                    raise
                text = str(error)
                if text != said or now_s - said_s > _REMIND_S:
                    _log.warning("waiting", waits_for=what, error=text)
                    said, said_s = text, now_s
                self._on_change(what, text)
                await self._unless_stopped(
                    asyncio.sleep(min(backoff.next(), max(ends_s - now_s, 0.0)))
                )
            else:
                if said:
                    _log.info("wait_is_over", waited_for=what)
                    self._on_change("", "")
                return found

    async def _unless_stopped(self, work: Coroutine[Any, Any, _Found]) -> _Found:
        working = asyncio.ensure_future(work)
        stopping = asyncio.ensure_future(self._stop.wait())
        try:
            await asyncio.wait({working, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if working.done():
                return working.result()
            raise StoppedError
        finally:
            stopping.cancel()
            working.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                if working.done():
                    working.exception()
