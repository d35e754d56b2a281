"""The live messages of the cell in another process, without a gap."""

import asyncio
import contextlib
from collections.abc import Callable, Collection
from typing import Any, Final, cast

import msgspec
import structlog

from service.bus.calls import call
from service.bus.commands import LiveStream, StreamMessage
from service.bus.interface import STREAM_TOPIC, ReaderBus
from service.bus.messages import encode
from service.bus.stream import LiveMessages
from service.bus.subscription import Message
from service.domain.errors import CellUnavailableError

#: Wall seconds for a part of what was missed.
PATIENCE_S: Final = 5.0
#: Wall seconds between two comparisons with the number that the cell reports.
COMPARE_EVERY_S: Final = 1.0
#: Wall seconds between two words to the cell of what is followed here.
FOLLOW_EVERY_S: Final = 5.0
# The reader hears of a new cell within a fraction of a second.
_LOOK_EVERY_S: Final = 0.05
_LOOKS: Final = 40
#: Live messages in one answer.
PART: Final = 200

_log = structlog.get_logger(__name__)


def packed(message: Message) -> bytes:
    """Write a live message for the bus."""
    return encode(StreamMessage(message.seq, message.type, message.asset, message.text))


class Following:
    """Brings the cell's live messages into a `LiveMessages` of this process.

    Parameters
    ----------
    reader : ReaderBus
        Where they come from.
    bus : LiveMessages
        Takes them, and keeps them for subscribers that come back.
    followed : callable, optional
        Gives the assets whose live messages are wanted; None for all. Default: those that the
        subscribers of the bus want.
    replays : bool
        Whether what a cell has sent before it was heard first is handed out too. Not where it
        comes under new numbers: no client can resume from it, and old messages would look new.
    """

    def __init__(
        self,
        reader: ReaderBus,
        bus: LiveMessages,
        followed: Callable[[], Collection[str] | None] | None = None,
        replays: bool = True,
    ) -> None:
        self._replays = replays
        self._followed = followed or bus.followed
        self._reader = reader
        self._bus = bus
        self._decoder = msgspec.msgpack.Decoder(StreamMessage)
        self._catching_up = asyncio.Lock()
        self.caught_up = asyncio.Event()

    async def run(self) -> None:
        """Follow until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._compare())
            tasks.create_task(self._go_on_following())
            async for change in self._reader.changes(STREAM_TOPIC):
                if change.epoch != self._bus.epoch:
                    await self._catch_up(change.epoch, change.number)
                elif change.number > self._bus.seq + 1:
                    await self._catch_up(change.epoch, change.number - 1)
                if self.caught_up.is_set():
                    self._bus.mirror(_message(self._decoder.decode(change.body)))

    async def follow(self, assets: Collection[str] | None) -> int:
        """Have the cell make the live messages of some assets, or of all.

        Returns
        -------
        int
            Number after which there are all of them; who resumes from an earlier one has a gap.

        Raises
        ------
        CellUnavailableError
            If the cell does not answer.
        """
        command = call(LiveStream.follow, None if assets is None else sorted(assets))
        made = await self._reader.ask(command, PATIENCE_S)
        # A cell that has just started again may not have sent anything yet.
        for _ in range(_LOOKS):
            if self._reader.epoch == made.epoch:
                break
            await asyncio.sleep(_LOOK_EVERY_S)
        if made.epoch == self._reader.epoch != self._bus.epoch:
            await self._catch_up(made.epoch, made.after)
        return made.after

    async def _go_on_following(self) -> None:
        while True:
            await asyncio.sleep(FOLLOW_EVERY_S)
            followed = self._followed()
            if followed is None or followed:
                with contextlib.suppress(CellUnavailableError):
                    await self.follow(followed)

    async def _compare(self) -> None:
        """Find what was missed last, which no later message shows."""
        behind = 0
        while True:
            reader, bus = self._reader, self._bus
            state = reader.state
            other = bool(reader.epoch) and reader.epoch != bus.epoch
            if state.ready and (other or state.stream > bus.seq == behind):
                await self._catch_up(reader.epoch, state.stream)
            behind = bus.seq
            await asyncio.sleep(COMPARE_EVERY_S if self.caught_up.is_set() else 0.05)

    async def _catch_up(self, epoch: str, number: int) -> None:
        """Ask for everything up to a number."""
        bus = self._bus
        async with self._catching_up:
            if epoch != bus.epoch:
                self.caught_up.clear()
                bus.restart(epoch, "the cell has started again")
                if not self._replays:
                    number = max(number, self._reader.state.stream)
                    bus.skip_to(number, number)
            try:
                while bus.seq < number and bus.epoch == epoch:
                    before = bus.seq
                    part = await self._reader.ask(call(LiveStream.after, epoch, before), PATIENCE_S)
                    if part.forgotten > before:
                        bus.skip_to(part.forgotten, part.forgotten)
                        self._miss(part.forgotten - before)
                    for message in part.messages:
                        bus.mirror(_message(message))
                    if not part.messages:
                        bus.skip_to(max(part.number, number), 0)
                self.caught_up.set()
            except CellUnavailableError:
                # At the beginning it is tried again; later the next messages must not wait.
                if self.caught_up.is_set() and bus.epoch == epoch and bus.seq < number:
                    self._miss(number - bus.seq)
                    bus.skip_to(number, number)

    def _miss(self, count: int) -> None:
        if self.caught_up.is_set():
            _log.warning("live_messages_missed", count=count)
            self._bus.end_subscriptions("live messages are gone")


def _message(packed: StreamMessage) -> Message:
    return Message(cast(Any, packed.type), packed.number, packed.asset, packed.text)
