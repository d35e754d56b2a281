"""Keeps the states of all twins of a cell: those that come together go in one transaction."""

import asyncio
from collections.abc import Callable, Mapping, Sequence

from anyio import to_thread

from service.live.kept import KeptState
from service.store import AuditEntry

#: Wall seconds in which others may join a transaction.
GATHER_S = 0.05


class StateKeeper:
    """Writes the states of assets, many at a time; all methods are called in one event loop.

    Parameters
    ----------
    write : callable
        Keeps documents by asset, and lines of the audit trail, in a thread.
    """

    def __init__(
        self,
        write: Callable[[Mapping[str, KeptState], Sequence[AuditEntry]], None],
    ) -> None:
        self._write = write
        self._waiting: dict[str, KeptState] = {}
        self._lines: list[AuditEntry] = []
        self._next: asyncio.Task[None] | None = None
        self._writing = asyncio.Lock()

    def save(
        self, asset: str, document: KeptState, lines: Sequence[AuditEntry] = ()
    ) -> "asyncio.Task[None]":
        """Keep a document, with lines of the audit trail about what changed it.

        The task ends when all of it is kept, and fails with what the store raises: then nothing is.
        It is that of all who come together, so that no one may cancel it.
        """
        self._waiting[asset] = document
        self._lines += lines
        if self._next is None:
            self._next = asyncio.create_task(self._write_next())
            # No one may be there any more to hear that it failed.
            self._next.add_done_callback(lambda done: done.cancelled() or done.exception())
        return self._next

    async def _write_next(self) -> None:
        await asyncio.sleep(GATHER_S)
        # Whatever comes while the one before is being written goes with this one.
        async with self._writing:
            documents, self._waiting, self._next = self._waiting, {}, None
            lines, self._lines = self._lines, []
            await to_thread.run_sync(self._write, documents, lines, abandon_on_cancel=True)
