"""Turns of callers at what costs much, so that none of them gets in the way of another.

What a caller may do at once, and the threads that do it. Beyond its share a caller is answered 503
with `Retry-After`.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, TypeVarTuple

from starlette.requests import Request
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.bus.replica import AssetReplica
from service.web.api.access import known_caller
from service.web.api.problems import Problem
from service.web.shares import Shares
from service.web.studies import Studies

Result = TypeVar("Result")
Arguments = TypeVarTuple("Arguments")

#: Threads that read the history; the interpreter runs one thread at a time anyway.
_READERS = 2
_JUDGES = 2


class Turns:
    """The shares of all callers, and threads of their own for reads and pushes.

    - ``long_reads``: downloads, and pages of more than `service.web.api.routes.measurements.LIMIT`
      rows.
    - ``pushes``: pushes from the first byte of the body to the answer.
    - ``judging``: pushes between the last byte of the body and their samples' way to the store.
    - ``catching_up``: streams that send what was missed.
    - ``studies``: envelope, advice, the search for windows and reports.
    - ``imports``: lists of assets, from the last byte of the body to the answer.
    """

    def __init__(self) -> None:
        self.long_reads = Shares("long reads", at_once=4, at_once_each=2, waiting_each=6)
        self.pushes = Shares("pushes", at_once=40, at_once_each=16)
        self.judging = Shares("pushes", at_once=3, at_once_each=2, waiting_each=16)
        self.what_ifs = Shares("what-if forecasts", at_once=1, at_once_each=1, waiting_each=4)
        self.streams = Shares("streams", at_once=1000, at_once_each=600)
        self.catching_up = Shares("streams", at_once=4, at_once_each=2, waiting_each=600)
        # One worker makes them: what waits, waits here, where it can still be given up.
        self.studies = Studies(Shares("calculations", at_once=1, at_once_each=1, waiting_each=4))
        self.imports = Shares("imports of assets", at_once=1, at_once_each=1, waiting_each=2)
        self._reads = Shares("reads", at_once=_READERS, at_once_each=_READERS, waiting_each=64)
        self._readers = ThreadPoolExecutor(_READERS, thread_name_prefix="read")
        self._judges = ThreadPoolExecutor(_JUDGES, thread_name_prefix="push")

    async def read(self, caller: str, work: Callable[..., Result], *arguments: object) -> Result:
        """Read a piece of the history in a thread."""
        return await self._reads.run(caller, self._readers, work, *arguments)

    async def judge(self, work: Callable[..., Result], *arguments: object) -> Result:
        """Work on pushed samples in a thread, within a turn of `judging`."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._judges, work, *arguments)

    def close(self) -> None:
        """Let the threads end."""
        for executor in (self._readers, self._judges):
            executor.shutdown(wait=False, cancel_futures=True)


class HeldResponse(StreamingResponse):
    """An answer in pieces that gives a turn back when it is over, however it ends."""

    def __init__(self, content: Any, leave: Callable[[], None], **options: Any) -> None:
        super().__init__(content, **options)
        self._leave = leave

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._leave()


async def pieces_in_turn(pieces: Sequence[bytes]) -> AsyncIterator[bytes]:
    """Give the pieces of a long answer, each compressed separately, with room between them."""
    for piece in pieces:
        yield piece
        await asyncio.sleep(0)


def turns_of(request: Request) -> Turns:
    """Give the turns of the application."""
    turns: Turns = request.app.state.turns
    return turns


def caller_of(request: Request) -> str:
    """Whose share a request counts in: the key's, whatever browser or program uses it."""
    principal = known_caller(request.scope)
    return principal.key_id if principal is not None else ""


async def study(
    request: Request,
    asset: AssetReplica,
    what: Hashable,
    question: Callable[[Any, *Arguments], Result],
    *arguments: *Arguments,
) -> Result:
    """Answer a question about an asset, as long as the client waits for it.

    Callers who ask for the same share it, unless a caller has changed something between them.
    """
    key = asset.id, asset.changed_s, what
    return await while_there(
        request,
        turns_of(request).studies.answer(
            caller_of(request), key, lambda: asset.compute(question, *arguments)
        ),
    )


async def while_there(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Work for a client as long as it waits for the answer; then the work is cancelled."""
    working = asyncio.ensure_future(work)
    leaving = asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait({working, leaving}, return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            return working.result()
        raise Problem(503, "the client disconnected")
    finally:
        for task in (working, leaving):
            task.cancel()
        await asyncio.gather(working, leaving, return_exceptions=True)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
