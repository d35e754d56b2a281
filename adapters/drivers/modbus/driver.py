"""The Modbus driver: polls on the process clock and hands over what can be trusted."""

import asyncio
import logging
import math
import time
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import aclosing
from dataclasses import replace
from types import TracebackType
from typing import Self

from adapters.backoff import Backoff
from adapters.drivers.modbus.config import ModbusPlan, ModbusSource
from adapters.drivers.modbus.groups import MISFIT, Group
from adapters.drivers.modbus.link import DeviceRefusedError, Link, LinkLostError, NoAnswerError
from adapters.drivers.modbus.mapping import PolledChannel, UnitMap, check, compile_units
from adapters.drivers.modbus.plan import ImplausiblePlanError, decode_plan, read_rows
from adapters.drivers.modbus.rounds import Round, Rounds
from adapters.drivers.modbus.units import Probe, Unit
from adapters.protocol import ChannelBinding, Clock, PlanBinding, SourceHealth
from adapters.samples import (
    Batch,
    PlannedProfile,
    Quality,
    Sample,
    is_bad,
    make_sample,
    next_time_us,
)

logger = logging.getLogger(__name__)

# Wall seconds.
RECONNECT_FIRST_S = 0.2
RECONNECT_LAST_S = 5.0
SILENT_UNIT_LAST_S = 30.0  # between two tries of a dead unit while others are alive
REFUSED_READ_S = 5.0  # before a read that the device refused as wrong is tried again
REFUSED_SHARE = 0.05  # of the time at most is for such reads
SEARCH_S = 2.0  # for the register that a read is refused for, before others have their turn
# On a line an answer of another length costs a time-out, and the next read listens for three.
_MISFIT_COST = 4.0
# Exceptions that one register of a read can be the cause of.
_OF_ONE_REGISTER = (2, 3, 4, MISFIT)
PLAN_INTERVAL_S = 0.2
PLAN_FAILED_FIRST_S = 5.0
LOG_INTERVAL_S = 10.0  # between two lines on the same channel


class ModbusDriver:
    """Polls one Modbus TCP server or serial line, see `adapters.protocol.Driver`.

    Requests go out one at a time over one connection; of several poll intervals that are due those
    of the shortest first, so that a fast one waits for one request of a slow one at most. A unit
    that does not answer is left out and tried again after growing waits: over a connection of its
    own where there can be one, so that it costs the others one time-out and no more. When a cycle
    comes too late it is skipped and counted; requests never queue up.
    """

    def __init__(
        self,
        source: ModbusSource,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
        clock: Clock,
    ) -> None:
        check(source, channels, plans)
        self._source = source
        self._clock = clock
        self._link = Link(source)
        self._was_connected = False
        self._reconnect_backoff = Backoff(RECONNECT_FIRST_S, RECONNECT_LAST_S)
        maps = compile_units(source, channels, plans, clock.rate)
        numbers = dict.fromkeys(one.unit for one in maps)
        last_s = RECONNECT_LAST_S if len(numbers) == 1 else SILENT_UNIT_LAST_S
        units = {number: Unit(number, Backoff(RECONNECT_FIRST_S, last_s)) for number in numbers}
        for one in maps:
            units[one.unit].maps.append(one)
        self._units = list(units.values())
        self._rounds = Rounds(clock, maps)
        self._health = SourceHealth(source.name, source.driver)
        self._link_problem = "not connected yet"
        self._plan_problem = ""
        self._plans_due = 0.0  # wall, monotonic
        self._plan_backoff = Backoff(PLAN_FAILED_FIRST_S, SILENT_UNIT_LAST_S)

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
        health.up = not self._link_problem and any(unit.answers for unit in self._units)
        problems = [self._link_problem] if self._link_problem else []
        problems += [f"unit {u.number}: {u.silent}" for u in self._units if u.silent]
        points = [point for unit in self._units for point in unit.points if point.problem]
        problems += [f"{point.label}: {point.problem}" for point in points[:5]]
        if len(points) > 5:
            problems.append(f"and {len(points) - 5} more channels")
        if self._plan_problem:
            problems.append(self._plan_problem)
        health.detail = "; ".join(problems) or "ok"
        return replace(
            health,
            errors=dict(health.errors),
            problems={point.label: point.problem for point in points},
        )

    async def batches(self) -> AsyncIterator[Batch]:
        """Yield one batch per poll without end; cancel to stop."""
        self._rounds.begin()
        try:
            while True:
                if not self._link.connected and not await self._connect():
                    lost = self._lose_everything()
                    if lost:
                        yield Batch(lost)
                    await asyncio.sleep(self._reconnect_backoff.next())
                    continue
                next_round = await self._rounds.next()
                self._health.skipped = self._rounds.skipped
                if next_round.steps is None:
                    next_round.steps = self._poll(next_round)
                batch = await anext(next_round.steps)
                if batch is None:
                    continue
                await next_round.end()
                if batch.samples or batch.plans:
                    yield batch
        finally:
            await self._rounds.end()
            await self._close()

    async def _connect(self) -> bool:
        if await self._link.connect():
            if self._was_connected:
                self._health.reconnects += 1
                # A device that accepts and hangs up at once would fill the log.
                if self._link_problem:
                    logger.info("source %s: reconnected", self.name)
            self._was_connected = True
            self._reconnect_backoff.reset()
            self._link_problem = ""
            return True
        where = self._source.where
        if not self._link_problem.startswith("cannot"):
            logger.warning("source %s: cannot connect to %s, retrying", self.name, where)
        self._link_problem = f"cannot connect to {where}"
        self._health.count_error("connect")
        return False

    async def _close(self) -> None:
        probes = [unit.probe for unit in self._units if unit.probe is not None]
        for probe in probes:
            probe.cancel()
        await asyncio.gather(*probes, return_exceptions=True)
        for unit in self._units:
            unit.probe = None
        self._link.drop()

    async def _poll(self, this: Round) -> AsyncGenerator[Batch | None]:
        """Read every unit of a round once; None after each request, the batch at the end."""
        started = time.monotonic()
        samples: list[Sample] = []
        plans: list[PlannedProfile] = []
        read: list[UnitMap] = []
        for unit in self._units:
            part = this.parts.get(unit.number)
            if part is None or (unit.silent and not self._is_due_on_this_link(unit)):
                continue
            async with aclosing(self._poll_unit(unit, part, samples, read)) as requests:
                async for _ in requests:
                    yield None
            if not self._link.connected and part not in read and not await self._connect():
                break
        # All units at once: a quarter faster than each between two requests.
        for part in read:
            self._evaluate(part.points, samples)
        if this.has_plans and self._link.connected and started >= self._plans_due:
            self._plans_due = started + PLAN_INTERVAL_S
            async with aclosing(self._read_plans(plans)) as requests:
                async for _ in requests:
                    yield None
        if not self._link.connected and not await self._connect():
            samples += self._lose_everything()
        if read:
            self._health.polls += 1
        yield Batch(samples, plans, time.monotonic() - started if read else None)

    def _is_due_on_this_link(self, unit: Unit) -> bool:
        """Decide how a silent unit is tried again: on this link only if that delays no one."""
        if unit.probe is not None:
            if not unit.probe.done():
                return False
            verdict = unit.probe.result()
            unit.probe = None
            if verdict is Probe.STILL_SILENT:
                unit.retry_at = time.monotonic() + unit.backoff.next()
                return False
            return True
        now = time.monotonic()
        # The long waits spare the others a delay; where no one answers there are no others.
        soon = unit.tried_at + RECONNECT_LAST_S
        alone = all(other.silent for other in self._units)
        if now < (min(unit.retry_at, soon) if alone else unit.retry_at):
            return False
        if not self._source.has_second_connection:
            return True
        witness = next((u.witness for u in self._units if not u.silent and u.witness), None)
        if witness is None or unit.witness is None:
            return True
        unit.probe = asyncio.create_task(self._probe(unit.witness, witness))
        return False

    async def _probe(self, unit: UnitMap, witness: UnitMap) -> Probe:
        """Ask a silent unit over a second connection, if the server serves one."""
        link = Link(self._source)
        try:
            if not await link.connect() or not await _answers(link, witness):
                return Probe.NO_SECOND_CONNECTION
            # An answer that does not fit costs the connection.
            if not link.connected and not await link.connect():
                return Probe.NO_SECOND_CONNECTION
            return Probe.ANSWERS if await _answers(link, unit) else Probe.STILL_SILENT
        finally:
            link.drop()

    async def _poll_unit(
        self, unit: Unit, part: UnitMap, samples: list[Sample], read: list[UnitMap]
    ) -> AsyncGenerator[None]:
        """Read one unit's channels, stopping after each request; put `part` to `read` at the end.

        Another round may read the same unit meanwhile. When it finds the unit silent, what has
        been read here is older than the gap and worth nothing.
        """
        if not part.groups:
            return
        losses = unit.losses
        for last_try in (False, True):
            try:
                async with aclosing(self._read_groups(part)) as requests:
                    async for _ in requests:
                        yield
                        if unit.losses != losses:
                            return
            except LinkLostError as error:
                if not last_try:
                    # a server that closes now and then costs no sample
                    self._health.count_error("connection")
                    if not await self._connect():
                        return
                    continue
                self._no_answer(unit, str(error), samples)
                return
            except NoAnswerError as error:
                self._no_answer(unit, str(error), samples)
                return
            break
        if unit.silent:
            logger.info("source %s: unit %d answers again", self.name, unit.number)
            if all(other.silent for other in self._units):
                for other in self._units:  # the line is back, not only this unit
                    other.retry_at = 0.0
            unit.silent = ""
        if unit.lost:
            self._rounds.hurry(part)
        unit.backoff.reset()
        unit.lost = False
        read.append(part)

    def _evaluate(self, points: Sequence[PolledChannel], samples: list[Sample]) -> None:
        """Make samples of what has been read."""
        for point in points:
            time_us = point.reading.time_us
            value, quality, kind, reason = point.evaluate(time_us)
            if kind == "misfit" and point.problem == reason:
                continue  # the gap is marked
            if kind or point.problem:
                self._note(point, quality, kind, reason)
            if not kind:
                self._health.last_good_us = time_us
            if time_us <= point.last_time_us:
                time_us = next_time_us(point.last_time_us, time_us)
            point.last_time_us = time_us
            samples.append(
                make_sample((point.asset, point.channel, time_us, value, quality, time_us))
            )
            self._health.samples += 1

    def _no_answer(self, unit: Unit, reason: str, samples: list[Sample]) -> None:
        """Leave a unit out for a while and mark the gap in its channels."""
        self._health.count_error("no_answer")
        if not unit.silent:
            logger.warning("source %s: unit %d: %s", self.name, unit.number, reason)
        unit.silent = reason
        unit.tried_at = time.monotonic()
        unit.retry_at = unit.tried_at + unit.backoff.next()
        samples += self._lose(unit)

    def _lose_everything(self) -> list[Sample]:
        return [sample for unit in self._units for sample in self._lose(unit)]

    def _lose(self, unit: Unit) -> list[Sample]:
        """One bad sample per channel, once per loss."""
        if unit.lost:
            return []
        unit.lost = True
        unit.losses += 1
        now_us = self._clock.now_us()
        samples = []
        for point in unit.points:
            point.last_good_us = 0
            point.problem = ""
            point.last_time_us = time_us = next_time_us(point.last_time_us, now_us)
            quality = int(Quality.COMM_FAILURE)
            samples.append(Sample(point.asset, point.channel, time_us, math.nan, quality, time_us))
        self._health.samples += len(samples)
        return samples

    async def _read_groups(self, part: UnitMap) -> AsyncGenerator[None]:
        """Read all groups, stopping after each request; a wrong one is split to find its cell."""
        if part.join_at and time.monotonic() >= part.join_at:
            part.join()
        waiting = deque(part.groups)
        groups: list[Group] = []
        search_s = 0.0
        while waiting:
            group = waiting.popleft()
            if group.retry_at and (time.monotonic() < group.retry_at or search_s > SEARCH_S):
                group.repeat(self._clock.now_us())
                groups.append(group)
                continue
            began = time.monotonic()
            try:
                values = await self._link.read(group.kind, part.unit, group.start, group.count)
            except DeviceRefusedError as error:
                connected = self._link.connected or await self._connect()
                cost_s = time.monotonic() - began
                search_s += cost_s
                cost_s *= _MISFIT_COST if error.code == MISFIT else 1.0
                halves = group.halves() if error.code in _OF_ONE_REGISTER else None
                if halves and search_s < SEARCH_S:
                    waiting.extendleft(reversed(halves))
                else:
                    group.fail(error.code, self._clock.now_us())
                    if not halves and (error.code == 1 or error.code in _OF_ONE_REGISTER):
                        refused = 1 + self._refused_elsewhere(part)
                        refused += sum(one.retry_at > 0.0 for one in (*groups, *waiting))
                        wait_s = max(REFUSED_READ_S, refused * cost_s / REFUSED_SHARE)
                        group.retry_at = time.monotonic() + wait_s
                    groups += halves or [group]
                if not connected:
                    part.keep([*groups, *waiting])
                    raise LinkLostError("connection lost") from error
            else:
                if group.retry_at:  # what was wrong with it is over, perhaps with others as well
                    group.retry_at = 0.0
                    following = next((one for one in (*waiting, *groups) if one.retry_at), None)
                    if following is not None:
                        following.retry_at = min(following.retry_at, began)
                group.store(values, self._clock.now_us())
                groups.append(group)
            yield
        part.keep(groups)

    def _refused_elsewhere(self, part: UnitMap) -> int:
        """Count the refused reads of the source but for those of a part."""
        parts = [one for unit in self._units for one in unit.maps if one is not part]
        return sum(group.retry_at > 0.0 for one in parts for group in one.groups)

    def _note(self, point: PolledChannel, quality: int, kind: str, reason: str) -> None:
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

    async def _read_plans(self, plans: list[PlannedProfile]) -> AsyncGenerator[None]:
        """Read the planned profiles; whatever fails here leaves the channels alone."""
        problem = ""
        for unit in self._units:
            if unit.silent:
                continue
            for binding in [plan for one in unit.maps for plan in one.plans]:
                config = binding.config
                if not isinstance(config, ModbusPlan):
                    continue
                registers: list[int] = []
                try:
                    async with aclosing(
                        read_rows(self._link, unit.number, config, registers)
                    ) as rows:
                        async for _ in rows:
                            yield
                    steps = decode_plan(registers, config.word_order)
                except (NoAnswerError, LinkLostError, DeviceRefusedError) as error:
                    problem = problem or f"plan of {binding.asset}: {error}"
                    if not (isinstance(error, DeviceRefusedError) and error.busy):
                        self._plans_due = time.monotonic() + self._plan_backoff.next()
                    if not self._link.connected and not await self._connect():
                        break
                except ImplausiblePlanError as error:
                    problem = problem or f"plan of {binding.asset}: implausible {error}"
                else:
                    plans.append(PlannedProfile(binding.asset, self._clock.now_us(), steps))
        if problem:
            self._health.count_error("plan")
            if not self._plan_problem:
                logger.warning("source %s: %s", self.name, problem)
        else:
            self._plan_backoff.reset()
        self._plan_problem = problem


async def _answers(link: Link, unit: UnitMap) -> bool:
    """Whether a unit answers anything to the read of its first group."""
    group = unit.groups[0]
    try:
        await link.read(group.kind, unit.unit, group.start, group.count)
    except DeviceRefusedError:
        return True
    except (NoAnswerError, LinkLostError):
        return False
    return True
