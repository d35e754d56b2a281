"""The CAN driver: listens to a bus and hands over what a DBC file makes of its frames."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Sequence
from types import TracebackType
from typing import Self

from adapters.drivers.can.binding import bind, check
from adapters.drivers.can.config import CanSource
from adapters.drivers.can.reader import Reader
from adapters.protocol import ChannelBinding, Clock, PlanBinding, SourceHealth
from adapters.samples import Batch

logger = logging.getLogger(__name__)

BATCH_S = 0.02  # wall; frames that come within this time travel together
MOST_NAMED = 5  # channels in the one line that says what is wrong
STOP_S = 2.0  # wall; longest wait for the listening thread to end


class CanDriver:
    """Listens to one CAN bus, see `adapters.protocol.Driver`.

    Samples carry the process time at which their frame was received. Whether a channel has become
    stale is for its user to judge; `health` names the messages that have stopped coming.
    """

    def __init__(
        self,
        source: CanSource,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
        clock: Clock,
    ) -> None:
        check(source, channels, plans)
        self._source = source
        self._clock = clock
        self._messages = bind(source, channels)
        self._reader: Reader | None = None
        self._arrived = asyncio.Event()
        self._samples = 0

    @property
    def name(self) -> str:
        """The source's name in the configuration."""
        return self._source.name

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()

        def notify() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has been closed: no one listens
                loop.call_soon_threadsafe(self._arrived.set)

        self._arrived.clear()
        self._reader = Reader(self._source, self._messages, self._clock, notify)
        self._reader.start()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        reader = self._reader
        if reader is None:
            return
        reader.stop()
        await asyncio.to_thread(reader.join, STOP_S)
        if reader.is_alive():
            logger.warning("source %s: its library is slow to close the bus", self.name)

    async def batches(self) -> AsyncIterator[Batch]:
        """Yield what has come without end. Raises `RuntimeError` if the thread has failed."""
        reader = self._reader
        if reader is None:
            raise RuntimeError(f"source {self.name}: used without 'async with'")
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            await asyncio.sleep(BATCH_S)
            samples = reader.take()
            if samples:
                self._samples += len(samples)
                yield Batch(samples)
            if reader.failure is not None:
                raise RuntimeError(f"source {self.name}: listening failed") from reader.failure

    def health(self) -> SourceHealth:
        """Give the state of the source."""
        health = SourceHealth(self.name, "can", samples=self._samples)
        reader = self._reader
        if reader is None:
            return health
        now_us = self._clock.now_us()
        problems = [reader.problem] if reader.problem else []
        fresh = False
        for message in self._messages.values():
            age_us = abs(now_us - message.last_frame_us)  # the clock may have been set back
            if not message.last_frame_us:
                problems.append(f"{message.message.name}: no frame yet")
            elif age_us > message.age_limit_us(self._clock.rate):
                problems.append(f"{message.message.name}: no frame for {age_us / 1e6:.1f} s")
            else:
                fresh = True
            note = message.senders.note() if message.senders is not None else ""
            problems += [f"{message.message.name} {note}"] if note else []
        channels = {
            signal.label: signal.problem
            for message in self._messages.values()
            for signal in message.signals
            if signal.problem
        }
        problems += [f"{label}: {text}" for label, text in list(channels.items())[:MOST_NAMED]]
        if len(channels) > MOST_NAMED:
            problems.append(f"and {len(channels) - MOST_NAMED} more channels")
        last_good_us = max((m.last_good_us for m in self._messages.values()), default=0)
        health.up = fresh and not reader.problem
        health.detail = "; ".join(problems) or "ok"
        health.last_good_us = last_good_us or None
        health.polls = reader.frames
        health.skipped = reader.skipped
        health.reconnects = reader.reconnects
        health.errors = reader.errors()
        health.problems = channels
        senders = [one.senders for one in self._messages.values() if one.senders is not None]
        health.settled = all(one.is_settled(now_us) for one in senders)
        return health
