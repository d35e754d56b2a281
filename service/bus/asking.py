"""Commands under way, on the side of who asks."""

import asyncio
import time
from collections.abc import Callable
from contextvars import ContextVar

import msgspec

from service.bus.errors import load_error
from service.bus.messages import Answer, AnswerT, Command, Request, encode
from service.domain.errors import CellUnavailableError

#: Role of the caller for whom a question is asked; empty where a process asks for itself.
caller_role: ContextVar[str] = ContextVar("caller_role", default="")
#: Questions that wait for their answer.
MOST_WAITING = 512

on_behalf_of: ContextVar[str] = ContextVar("on_behalf_of", default="")
"""Whose share of the cell's time a question takes: a user or program; empty: the process itself."""


class Asking:
    """Numbers the commands of a reader and brings the answers to who waits for them.

    Parameters
    ----------
    send : callable
        Takes an encoded request and the wall seconds that its answer may take, or raises
        `CellUnavailableError`; must not wait.
    """

    def __init__(self, send: Callable[[bytes, float], None]) -> None:
        self._send = send
        self._number = 0
        self._waiting: dict[int, asyncio.Future[Answer]] = {}
        self._answer = msgspec.msgpack.Decoder(Answer)

    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        if len(self._waiting) >= MOST_WAITING:
            raise CellUnavailableError("too many questions wait for the cell")
        self._number += 1
        number = self._number
        name = type(command).__name__
        deadline_s, body = time.monotonic() + patience_s, msgspec.Raw(encode(command))
        request = Request(number, deadline_s, name, body, caller_role.get(), on_behalf_of.get())
        waiting = self._waiting[number] = asyncio.get_running_loop().create_future()
        try:
            self._send(encode(request), patience_s)
            async with asyncio.timeout(patience_s):
                answer = await waiting
        except TimeoutError:
            raise CellUnavailableError(f"the cell did not answer within {patience_s:g} s") from None
        finally:
            self._waiting.pop(number, None)
        if answer.error:
            raise load_error(answer.error, bytes(answer.body))
        found: AnswerT = command.result.decode(answer.body)
        return found

    def take(self, answer: bytes) -> None:
        """Bring an answer to who waits for it."""
        try:
            found = self._answer.decode(answer)
        except msgspec.DecodeError:
            return
        waiting = self._waiting.get(found.number)
        if waiting is not None and not waiting.done():
            waiting.set_result(found)

    def give_up(self, why: str) -> None:
        """End the wait of all: no answer will come."""
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(CellUnavailableError(why))
