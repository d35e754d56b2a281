"""Answers commands: with a deadline each, and a limited number at a time of each caller."""

import asyncio
import time
import traceback
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec
import structlog

from service.bus.errors import dump_error
from service.bus.interface import Handlers
from service.bus.loop_share import LoopShare
from service.bus.messages import Answer, Command, Request, decoder_of, encode
from service.domain.errors import CellUnavailableError, RoleRefusedError
from service.pauses import MeasuredCoroutine, next_turn

#: Commands under way: of one caller, and of all together.
AT_ONCE_EACH = 128
AT_ONCE = 256
#: Commands of one user or program that wait for their turn in the loop.
WAITING_EACH = 48

_log = structlog.get_logger(__name__)


class Dispatcher:
    """Takes requests in and gives answers out, both as bytes; used in one event loop.

    Parameters
    ----------
    handlers : mapping of type to callable
        What answers which command.
    """

    def __init__(self, handlers: Handlers) -> None:
        self._handlers = {
            kind.__name__: (decoder_of(kind), handler) for kind, handler in handlers.items()
        }
        self._request = msgspec.msgpack.Decoder(Request)
        self._running: Counter[bytes] = Counter()
        self._share = LoopShare()
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
        account = f"{caller.hex()} {asked.caller}"
        if asked.caller and self._share.waiting(account) >= WAITING_EACH:
            text = "the cell has as much to do for this caller as it may"
            send(_failed(asked.number, CellUnavailableError(text)))
            return
        self._running[caller] += 1
        answering = self._answer(caller, account, asked, left_s, send)
        task = asyncio.create_task(
            MeasuredCoroutine(answering, partial(self._share.charge, account))
        )
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Cancel what is under way."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _answer(
        self,
        caller: bytes,
        account: str,
        asked: Request,
        left_s: float,
        send: Callable[[bytes], None],
    ) -> None:
        next_turn.set(partial(self._share.turn, account))
        try:
            send(await self._work(account, asked, left_s))
        finally:
            self._running[caller] -= 1
            if not self._running[caller]:
                del self._running[caller]

    async def _work(self, account: str, asked: Request, left_s: float) -> bytes:
        found = self._handlers.get(asked.name)
        if found is None:
            return _failed(
                asked.number, CellUnavailableError(f"the cell does not answer {asked.name} now")
            )
        decoder, handle = found
        try:
            command: Command[Any] = decoder.decode(asked.body)
            if not command.may_be_asked_for(asked.role):
                _log.warning("command_refused", command=asked.name, role=asked.role)
                raise RoleRefusedError(f"{asked.name}: not for role {asked.role or 'none'!r}")
            async with asyncio.timeout(left_s):
                await self._share.turn(account)
                result = await handle(command)
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
