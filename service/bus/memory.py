"""A bus within one event loop; its messages are written and read as on every other."""

import asyncio
import uuid
from collections.abc import AsyncIterator

from service.bus.asking import Asking
from service.bus.dispatch import Dispatcher
from service.bus.interface import Handlers
from service.bus.messages import AnswerT, CellState, Change, Command
from service.domain.errors import CellUnavailableError

#: Changes that may wait for a reader.
QUEUE = 1000


class MemoryBus:
    """Both faces of a bus in one object.

    Attributes
    ----------
    epoch : str
        Names this start of the cell.
    state : CellState
        What the cell last reported of itself.
    """

    def __init__(self) -> None:
        self.epoch = uuid.uuid4().hex[:12]
        self.state = CellState()
        self._readers: dict[asyncio.Queue[Change], str] = {}
        self._dispatcher: Dispatcher | None = None
        self._asking = Asking(self._send)
        self._loop: asyncio.AbstractEventLoop | None = None

    # ------------------------------------------------------------------ the cell's face
    def publish(self, topic: str, number: int, body: bytes) -> None:
        """See `service.bus.interface.CellBus.publish`."""
        change = Change(self.epoch, number, body)
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            if self._loop is not None:
                self._loop.call_soon_threadsafe(self._hand_out, topic, change)
            return
        self._hand_out(topic, change)

    def report(self, state: CellState) -> None:
        """See `service.bus.interface.CellBus.report`."""
        self.state = state

    async def serve(self, handlers: Handlers) -> None:
        """See `service.bus.interface.CellBus.serve`."""
        self._loop = asyncio.get_running_loop()
        self._dispatcher = Dispatcher(handlers)
        try:
            await asyncio.Event().wait()
        finally:
            dispatcher, self._dispatcher = self._dispatcher, None
            await dispatcher.close()

    # ------------------------------------------------------------------ the readers' face
    @property
    def away_s(self) -> float:
        """Zero: who is in the same process is there."""
        return 0.0

    async def run(self) -> None:
        """See `service.bus.interface.ReaderBus.run`."""
        await asyncio.Event().wait()

    async def changes(self, topic: str) -> AsyncIterator[Change]:
        """See `service.bus.interface.ReaderBus.changes`."""
        queue: asyncio.Queue[Change] = asyncio.Queue(QUEUE)
        self._readers[queue] = topic
        try:
            while True:
                yield await queue.get()
        finally:
            del self._readers[queue]

    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        return await self._asking.ask(command, patience_s)

    def _send(self, request: bytes, patience_s: float) -> None:
        if self._dispatcher is None:
            raise CellUnavailableError("the cell takes no commands")
        self._dispatcher.take(b"", request, self._asking.take)

    def _hand_out(self, topic: str, change: Change) -> None:
        for queue, wanted in self._readers.items():
            if wanted == topic and not queue.full():
                queue.put_nowait(change)
