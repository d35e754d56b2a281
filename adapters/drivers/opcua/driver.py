"""The OPC UA driver: subscribes, comes back after a loss, and fetches what was missed."""

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from adapters.backoff import Backoff
from adapters.drivers.opcua.backfill import fill_in
from adapters.drivers.opcua.codes import has_changed_meaning
from adapters.drivers.opcua.config import OpcUaChannel, OpcUaSource, check
from adapters.drivers.opcua.session import Session, SessionError
from adapters.drivers.opcua.unit_questions import UnitQuestions
from adapters.drivers.opcua.values import FollowedNode, code_of, compared, moment_of
from adapters.protocol import ChannelBinding, Clock, PlanBinding, SourceHealth
from adapters.samples import Batch, Quality, Sample, is_bad, is_good, next_time_us

logger = logging.getLogger(__name__)

# Wall seconds.
RECONNECT_FIRST_S = 0.5
RECONNECT_LAST_S = 10.0
UNCHANGED_S = 5.0  # a node that was silent for so long is read
LOG_INTERVAL_S = 10.0  # between two lines on the same channel
HISTORY_WAITS = 4  # answers of the history that wait to be handed over
PORTION = 1000  # samples of the history that are handed over at once
MOST_GAPS = 16  # of a channel that wait for the server's history


class OpcUaDriver:
    """Follows the nodes of one OPC UA server, see `adapters.protocol.Driver`.

    A server reports changes only: a node that stays silent is read now and then, and its value
    stands as of the server's time. After a loss the values of now come first, and what was missed
    follows from the server's history with its own times, as late samples do.
    """

    def __init__(
        self,
        source: OpcUaSource,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
        clock: Clock,
    ) -> None:
        check(source, channels, plans)
        self._source = source
        self._clock = clock
        self._session = Session(source)
        self._points = [_point(binding) for binding in channels]
        self._by_node: dict[str, list[FollowedNode]] = {}
        for point in self._points:
            self._by_node.setdefault(point.config.node, []).append(point)
        self._health = SourceHealth(source.name, source.driver)
        self._problem = "not connected yet"
        self._was_connected = False
        self._lost = False  # the bad samples that mark the gap have been handed over
        self._back: set[str] = set()  # channels with a value since the connection
        self._behind_us: int | None = None  # the server's clock behind ours, at most
        self._backoff = Backoff(RECONNECT_FIRST_S, RECONNECT_LAST_S)
        self._filling: asyncio.Task[None] | None = None
        self._history: asyncio.Queue[list[Sample]] = asyncio.Queue(HISTORY_WAITS)
        self._unit_questions = UnitQuestions(source.name, self._points)
        self._other_meaning: set[str] = set()  # nodes whose latest value says so

    @property
    def name(self) -> str:
        """The source's name in the configuration."""
        return self._source.name

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self._close()

    def health(self) -> SourceHealth:
        """Give the state of the source."""
        health = self._health
        health.up = not self._problem
        wrong = [f"{one.label}: {one.problem}" for one in self._points if one.problem]
        wrong += [
            f"{one.label}: {one.history_problem}" for one in self._points if one.history_problem
        ]
        problems = [self._problem] if self._problem else []
        problems += wrong[:5]
        if len(wrong) > 5:
            problems.append(f"and {len(wrong) - 5} more")
        health.detail = "; ".join(problems) or "ok"
        return replace(
            health,
            errors=dict(health.errors),
            problems={one.label: one.problem for one in self._points if one.problem},
            clocks_ahead_s={one.label: one.ahead_s for one in self._points if one.ahead_s},
        )

    async def batches(self) -> AsyncIterator[Batch]:
        """Yield what the server reports without end; cancel to stop."""
        try:
            while True:
                try:
                    async for batch in self._follow():
                        yield batch
                except SessionError as error:
                    self._note_loss(f"{error}")
                await self._close()
                lost = self._lose()
                if lost:
                    yield Batch(lost)
                await asyncio.sleep(self._backoff.next())
        finally:
            await self._close()

    async def _follow(self) -> AsyncIterator[Batch]:
        """Connect, and yield what comes until the connection is lost."""
        session = self._session = Session(self._source)
        refused = await session.open(self._by_node)
        await self._unit_questions.begin(session)
        if self._was_connected:
            self._health.reconnects += 1
            logger.info("source %s: reconnected", self.name)
        self._was_connected = True
        self._problem = ""
        self._lost = False
        self._back.clear()
        self._behind_us = None
        self._backoff.reset()
        samples = self._refuse(refused)
        if samples:
            yield Batch(samples)
        while not session.lost:
            if not session.changed.is_set() and self._history.empty():
                await self._wait(session)
            samples = self._take(session.take())
            self._health.skipped += session.dropped
            session.dropped = 0
            silent = self._silent(refused)
            if silent:
                samples += self._take(await session.read(silent), stands=True)
            while not self._history.empty():
                past = self._history.get_nowait()
                for begin in range(0, len(past), PORTION):
                    portion = past[begin : begin + PORTION]
                    self._health.samples += len(portion)
                    yield Batch(portion)
                    await asyncio.sleep(0)  # others of the service have their turn
            if samples:
                self._health.polls += 1
                yield Batch(samples)
            self._begin_to_fill_in(session)
            self._unit_questions.go_on(session)
        raise SessionError(session.lost)

    async def _wait(self, session: Session) -> None:
        """Wait for a notification; not for long, as history may come or a node fall silent."""
        try:
            async with asyncio.timeout(min(UNCHANGED_S / 10.0, 0.25)):
                await session.changed.wait()
        except TimeoutError:
            return
        # What comes together is handed over together.
        await asyncio.sleep(0.01)

    def _silent(self, refused: dict[str, str]) -> list[str]:
        now_us = self._clock.now_us()
        limit_us = now_us - round(UNCHANGED_S * self._clock.rate * 1e6)
        return [
            node
            for node, points in self._by_node.items()
            if node not in refused
            and any(not limit_us <= point.heard_us <= now_us for point in points)
        ]

    def _take(self, found: Sequence[tuple[str, Any]], stands: bool = False) -> list[Sample]:
        """Make samples of data values; with `stands` an unchanged one is valid as of now."""
        now_us = self._clock.now_us()
        self._see_changed_units(found)
        return [
            sample
            for node, value in found
            for point in self._by_node[node]
            if (sample := self._sample(point, value, now_us, stands)) is not None
        ]

    def _see_changed_units(self, found: Sequence[tuple[str, Any]]) -> None:
        """Doubt the nodes of which the server begins to say that their meaning has changed."""
        changed = []
        for node, value in found:
            if not has_changed_meaning(code_of(value)):
                self._other_meaning.discard(node)
            elif node not in self._other_meaning:
                self._other_meaning.add(node)
                changed.append(node)
        self._unit_questions.doubt(changed)

    def _sample(self, point: FollowedNode, value: Any, now_us: int, stands: bool) -> Sample | None:
        found = point.read(value, now_us, self._clock.rate)
        reading, is_same = compared(found, point, now_us)
        time_us = reading.time_us
        first = point.label not in self._back
        if stands or first:
            if time_us <= point.last_us:  # the server says that the old value stands
                time_us = next_time_us(point.last_us, self._server_us(now_us))
        elif is_same:  # sent again
            return None
        elif point.stands:
            time_us = next_time_us(point.last_us, self._server_us(now_us))
        elif time_us > point.last_us:  # a time that went back says nothing of the server's clock
            behind_us = now_us - time_us
            known_us = behind_us if self._behind_us is None else self._behind_us
            self._behind_us = min(behind_us, known_us)
        if point.lost_at_us and first:
            if self._source.backfill and reading.ahead_s:
                # Its history has the times of that clock.
                point.history_problem = (
                    f"the loss until {moment_of(now_us):%Y-%m-%dT%H:%M:%SZ} was not filled in: "
                    f"the clock was ahead by {reading.ahead_s:.0f} s"
                )
            elif self._source.backfill and time_us > point.lost_at_us:
                point.gaps.append((point.lost_at_us, time_us))
                if len(point.gaps) > MOST_GAPS:
                    del point.gaps[1]  # the first one may be under way
                    point.history_problem = f"more than {MOST_GAPS} gaps wait: the oldest stays"
            point.lost_at_us = 0
        self._back.add(point.label)
        late = point.last_us - 1_000_000 <= time_us < point.last_us  # else the clock was set back
        point.last_us = point.last_us if late else time_us
        # A value from long ago is asked for once more: it may still stand.
        is_old = first and time_us < now_us - round(UNCHANGED_S * 1e6)
        point.heard_us = 0 if is_old else now_us
        if reading.overflown:
            self._health.count_error("overflow")
        self._note(point, reading.quality, reading.kind, reading.reason)
        if is_good(reading.quality):
            self._health.last_good_us = time_us
        self._health.samples += 1
        number = math.nan if is_bad(reading.quality) else reading.value
        received_us = max(now_us, time_us)
        return Sample(point.asset, point.channel, time_us, number, reading.quality, received_us)

    def _server_us(self, now_us: int) -> int:
        """Return what time it is by the server's clock, as far as its values show."""
        return now_us - (self._behind_us or 0)

    def _refuse(self, refused: dict[str, str]) -> list[Sample]:
        """One bad sample for each channel whose node the server does not give."""
        now_us = self._clock.now_us()
        samples = []
        for node, reason in refused.items():
            for point in self._by_node[node]:
                self._note(point, int(Quality.CONFIG_ERROR), "node", reason)
                point.ahead_s = 0.0
                samples.append(self._bad(point, Quality.CONFIG_ERROR, now_us))
        return samples

    def _lose(self) -> list[Sample]:
        """One bad sample per channel, once per loss."""
        if self._lost:
            return []
        self._lost = True
        now_us = self._clock.now_us()
        samples = []
        for point in self._points:
            if point.label in self._back:
                point.lost_at_us = point.last_us
            point.problem = ""
            samples.append(self._bad(point, Quality.COMM_FAILURE, now_us))
        return samples

    def _bad(self, point: FollowedNode, quality: Quality, now_us: int) -> Sample:
        point.last_us = time_us = next_time_us(point.last_us, self._server_us(now_us))
        point.heard_us = now_us
        self._health.samples += 1
        received_us = max(now_us, time_us)
        return Sample(point.asset, point.channel, time_us, math.nan, int(quality), received_us)

    def _begin_to_fill_in(self, session: Session) -> None:
        if self._filling is not None and not self._filling.done():
            return
        waits = self._unit_questions.awaited
        points = [one for one in self._points if one.gaps and one.config.node not in waits]
        if points:
            self._filling = asyncio.create_task(self._fill_in(session, points))

    async def _fill_in(self, session: Session, points: Sequence[FollowedNode]) -> None:
        counted = {point.label: point.history_problem for point in points}
        filled = fill_in(session, points, self._source.backfill_max_s, self._clock)
        async for samples in filled:
            await self._history.put(samples)
        for point in points:
            if point.history_problem and point.history_problem != counted[point.label]:
                self._health.count_error("history")
                logger.warning(
                    "source %s: channel %s: %s", self.name, point.label, point.history_problem
                )

    def _note(self, point: FollowedNode, quality: int, kind: str, reason: str) -> None:
        """Count what is wrong with a channel, and log it when it changes."""
        if kind:
            self._health.count_error(kind)
        if reason != point.problem:
            point.problem = reason
            now = time.monotonic()
            if now >= point.quiet_until:
                point.quiet_until = now + LOG_INTERVAL_S
                level = logging.WARNING if is_bad(quality) else logging.INFO
                what = reason or "good again"
                logger.log(level, "source %s: channel %s: %s", self.name, point.label, what)

    def _note_loss(self, reason: str) -> None:
        self._health.count_error("connection" if self._was_connected else "connect")
        if reason != self._problem:
            logger.warning("source %s: %s: %s", self.name, self._source.endpoint, reason)
        self._problem = reason

    async def _close(self) -> None:
        await self._unit_questions.end()
        filling, self._filling = self._filling, None
        if filling is not None:
            filling.cancel()
            await asyncio.gather(filling, return_exceptions=True)
        # Of history that was not taken the gap is open again.
        while not self._history.empty():
            self._reopen(self._history.get_nowait())
        await self._session.close()

    def _reopen(self, samples: Sequence[Sample]) -> None:
        for point in self._points:
            own = [
                one.time_us
                for one in samples
                if (one.asset, one.channel) == (point.asset, point.channel)
            ]
            if own:
                point.gaps.insert(0, (min(own) - 1, max(own) + 1))


def _point(binding: ChannelBinding) -> FollowedNode:
    if not isinstance(binding.config, OpcUaChannel):
        raise TypeError(f"{binding.asset}/{binding.channel}: expected an OpcUaChannel")
    return FollowedNode(binding.asset, binding.channel, binding.config, unit=binding.unit)
