"""Answers commands: with a deadline each, and a limited number at a time of each caller."""

import asyncio
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import structlog

from service.bus.errors import dump_error
from service.bus.interface import Handler
from service.bus.messages import Answer, Command, Request, encode
from service.domain.errors import CellUnavailableError

#: Commands under way: of one caller, and of all together.
AT_ONCE_EACH = 128
AT_ONCE = 256

_log = structlog.get_logger(__name__)


class Dispatcher:
    """Takes requests in and gives answers out, both as bytes; used in one event loop.

    Parameters
    ----------
    handlers : mapping of type to callable
        What answers which command.
    """

    def __init__(self, handlers: Mapping[type[Command[Any]], Handler]) -> None:
        self._handlers = {
            kind.__name__: (msgspec.msgpack.Decoder(kind), handler)
            for kind, handler in handlers.items()
        }
        self._request = msgspec.msgpack.Decoder(Request)
        self._running: Counter[bytes] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()
        self._unreadable = 0

    def take(
        self,
        caller: bytes,
        request: bytes,
        send: Callable[[bytes], None],
        patience_s: float | None = None,
    ) -> None:
        """Begin to answer a request; returns at once.

        What is no request, or past its deadline, is not answered: no caller waits for it.

        Parameters
        ----------
        caller : bytes
            Names who asks.
        request : bytes
            The encoded request.
        send : callable
            Takes the encoded answer; must not wait.
        patience_s : float, optional
            Wall seconds that a caller on another machine waits, whose deadline says nothing here.
        """
        try:
            asked = self._request.decode(request)
        except (msgspec.DecodeError, RecursionError):
            if not self._unreadable:
                _log.warning("bus_request_unreadable", bytes=len(request))
            self._unreadable += 1
            return
        left_s = asked.deadline_s - time.monotonic() if patience_s is None else patience_s
        if left_s <= 0.0:
            return
        if self._running[caller] >= AT_ONCE_EACH or self._running.total() >= AT_ONCE:
            send(_failed(asked.number, CellUnavailableError("the cell has enough to do")))
            return
        self._running[caller] += 1
        task = asyncio.create_task(self._answer(caller, asked, left_s, send))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Cancel what is under way."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _answer(
        self, caller: bytes, asked: Request, left_s: float, send: Callable[[bytes], None]
    ) -> None:
        try:
            send(await self._work(asked, left_s))
        finally:
            self._running[caller] -= 1
            if not self._running[caller]:
                del self._running[caller]

    async def _work(self, asked: Request, left_s: float) -> bytes:
        found = self._handlers.get(asked.name)
        if found is None:
            return _failed(
                asked.number, CellUnavailableError(f"the cell does not answer {asked.name} now")
            )
        decoder, handle = found
        try:
            async with asyncio.timeout(left_s):
                result = await handle(decoder.decode(asked.body))
            return encode(Answer(asked.number, "", msgspec.Raw(encode(result))))
        except TimeoutError:
            return _failed(asked.number, CellUnavailableError("not done in time"))
        except Exception as error:
            # One broken command must not end the cell, nor the others.
            name, _ = dump_error(error)
            if name == "CellFaultError":
                # As text: a structured traceback shows local variables.
                text = "".join(traceback.format_exception(error))
                _log.error("command_failed", command=asked.name, traceback=text)
            return _failed(asked.number, error)


def _failed(number: int, error: Exception) -> bytes:
    name, body = dump_error(error)
    return encode(Answer(number, name, msgspec.Raw(body)))
