"""The Modbus TCP driver: polls on the process clock and hands over what can be trusted."""

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from types import TracebackType
from typing import Self

from adapters.backoff import Backoff
from adapters.drivers.modbus.config import (
    PLAN_ROW_REGISTERS,
    ModbusPlan,
    ModbusRtuSource,
    ModbusSource,
)
from adapters.drivers.modbus.link import DeviceRefusedError, Link, LinkLostError, NoAnswerError
from adapters.drivers.modbus.mapping import (
    MAX_REGISTERS,
    Group,
    Point,
    UnitMap,
    check,
    compile_units,
)
from adapters.drivers.modbus.plan import ImplausiblePlanError, decode_plan
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
PLAN_INTERVAL_S = 0.2
PLAN_FAILED_FIRST_S = 5.0
LOG_INTERVAL_S = 10.0  # between two lines on the same channel
PLAN_ROWS_PER_READ = MAX_REGISTERS // PLAN_ROW_REGISTERS


class _Probe(Enum):
    """What trying a silent unit over a second connection gave."""

    ANSWERS = "answers"
    STILL_SILENT = "still no answer"
    NO_SECOND_CONNECTION = "no second connection"  # the unit must be tried over the first one


@dataclass(slots=True)
class _Unit:
    """A unit with its standing: alive, or silent and tried again now and then."""

    map: UnitMap
    backoff: Backoff
    silent: str = ""  # why, or empty
    retry_at: float = 0.0  # wall, monotonic
    tried_at: float = 0.0  # wall, monotonic
    lost: bool = False  # the bad samples that mark the gap have been handed over
    probe: asyncio.Task[_Probe] | None = None


class ModbusDriver:
    """Polls one Modbus TCP server or serial line, see `adapters.protocol.Driver`.

    Requests go out one at a time over one connection. A unit that does not answer is left out and
    tried again after growing waits: over a connection of its own where there can be one, so that
    it costs the others one time-out and no more. When a cycle comes too late it is skipped and
    counted; requests never queue up.
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
        last_s = RECONNECT_LAST_S if len(maps) == 1 else SILENT_UNIT_LAST_S
        self._units = [_Unit(unit, Backoff(RECONNECT_FIRST_S, last_s)) for unit in maps]
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
        """Tell how the source is doing."""
        health = self._health
        health.up = not self._link_problem and any(not unit.silent for unit in self._units)
        problems = [self._link_problem] if self._link_problem else []
        problems += [f"unit {u.map.unit}: {u.silent}" for u in self._units if u.silent]
        points = [point for unit in self._units for point in unit.map.points if point.problem]
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
        due_us = self._clock.now_us()
        interval_us = round(self._source.poll_interval_s * 1e6)
        try:
            while True:
                if not self._link.connected and not await self._connect():
                    lost = self._lose_everything()
                    if lost:
                        yield Batch(lost)
                    await asyncio.sleep(self._reconnect_backoff.next())
                    continue
                now_us = self._clock.now_us()
                if due_us - now_us > interval_us:  # the clock was set back
                    due_us = now_us
                if now_us < due_us:
                    await self._clock.sleep((due_us - now_us) / 1e6)
                else:
                    late = (now_us - due_us) // interval_us
                    self._health.skipped += late
                    due_us += late * interval_us
                due_us += interval_us
                batch = await self._poll()
                if batch.samples or batch.plans:
                    yield batch
        finally:
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

    async def _poll(self) -> Batch:
        """Read every unit that is due once."""
        started = time.monotonic()
        samples: list[Sample] = []
        plans: list[PlannedProfile] = []
        read: list[UnitMap] = []
        for unit in self._units:
            if unit.silent and not self._is_due_on_this_link(unit):
                continue
            if await self._poll_unit(unit, samples):
                read.append(unit.map)
            elif not self._link.connected and not await self._connect():
                break
        # All units at once: a quarter faster than each between two requests.
        for unit_map in read:
            self._evaluate(unit_map.points, samples)
        if self._link.connected and started >= self._plans_due:
            self._plans_due = started + PLAN_INTERVAL_S
            await self._read_plans(plans)
        if not self._link.connected and not await self._connect():
            samples += self._lose_everything()
        if read:
            self._health.polls += 1
        return Batch(samples, plans, time.monotonic() - started if read else None)

    def _is_due_on_this_link(self, unit: _Unit) -> bool:
        """Decide how a silent unit is tried again: on this link only if that delays no one."""
        if unit.probe is not None:
            if not unit.probe.done():
                return False
            verdict = unit.probe.result()
            unit.probe = None
            if verdict is _Probe.STILL_SILENT:
                unit.retry_at = time.monotonic() + unit.backoff.next()
                return False
            return True
        now = time.monotonic()
        # The long waits spare the others a delay; where no one answers there are no others.
        soon = unit.tried_at + RECONNECT_LAST_S
        alone = all(other.silent for other in self._units)
        if now < (min(unit.retry_at, soon) if alone else unit.retry_at):
            return False
        if isinstance(self._source, ModbusRtuSource):
            return True  # a serial line has no second connection
        witness = next((u for u in self._units if not u.silent and u.map.groups), None)
        if witness is None:
            return True
        unit.probe = asyncio.create_task(self._probe(unit, witness))
        return False

    async def _probe(self, unit: _Unit, witness: _Unit) -> _Probe:
        """Ask a silent unit over a second connection, if the server serves one."""
        link = Link(self._source)
        try:
            if not await link.connect() or not await _answers(link, witness.map):
                return _Probe.NO_SECOND_CONNECTION
            return _Probe.ANSWERS if await _answers(link, unit.map) else _Probe.STILL_SILENT
        finally:
            link.drop()

    async def _poll_unit(self, unit: _Unit, samples: list[Sample]) -> bool:
        """Read one unit's channels; tell if it answered."""
        if not unit.map.groups:
            return False
        try:
            try:
                await self._read_groups(unit.map)
            except LinkLostError:
                # a server that closes now and then costs no sample
                self._health.count_error("connection")
                if not await self._connect():
                    return False
                await self._read_groups(unit.map)
        except (NoAnswerError, LinkLostError) as error:
            self._health.count_error("no_answer")
            self._silence(unit, str(error), samples)
            return False
        if unit.silent:
            logger.info("source %s: unit %d answers again", self.name, unit.map.unit)
            if all(other.silent for other in self._units):
                for other in self._units:  # the line is back, not only this unit
                    other.retry_at = 0.0
            unit.silent = ""
        unit.backoff.reset()
        unit.lost = False
        return True

    def _evaluate(self, points: Sequence[Point], samples: list[Sample]) -> None:
        """Make samples of what has been read."""
        for point in points:
            time_us = point.reading.time_us
            value, quality, kind, reason = point.evaluate(time_us)
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
        self._health.samples += len(points)

    def _silence(self, unit: _Unit, reason: str, samples: list[Sample]) -> None:
        """Leave a unit out for a while and mark the gap in its channels."""
        if not unit.silent:
            logger.warning("source %s: unit %d: %s", self.name, unit.map.unit, reason)
        unit.silent = reason
        unit.tried_at = time.monotonic()
        unit.retry_at = unit.tried_at + unit.backoff.next()
        samples += self._lose(unit)

    def _lose_everything(self) -> list[Sample]:
        return [sample for unit in self._units for sample in self._lose(unit)]

    def _lose(self, unit: _Unit) -> list[Sample]:
        """One bad sample per channel, once per loss."""
        if unit.lost:
            return []
        unit.lost = True
        now_us = self._clock.now_us()
        samples = []
        for point in unit.map.points:
            point.last_good_us = 0
            point.problem = ""
            point.last_time_us = time_us = next_time_us(point.last_time_us, now_us)
            quality = int(Quality.COMM_FAILURE)
            samples.append(Sample(point.asset, point.channel, time_us, math.nan, quality, time_us))
        self._health.samples += len(samples)
        return samples

    async def _read_groups(self, unit: UnitMap) -> None:
        """Read all groups; one that the device calls wrong is split to find the wrong cell."""
        if unit.join_at and time.monotonic() >= unit.join_at:
            unit.join()
        groups: list[Group] = []
        for group in unit.groups:
            if group.retry_at and time.monotonic() < group.retry_at:
                group.repeat(self._clock.now_us())
                groups.append(group)
            else:
                groups += await self._read_group(unit.unit, group)
        if len(groups) > len(unit.groups):
            unit.note_split()
        unit.groups = groups

    async def _read_group(self, unit: int, group: Group) -> tuple[Group, ...]:
        try:
            values = await self._link.read(group.kind, unit, group.start, group.count)
        except DeviceRefusedError as error:
            halves = group.halves() if error.code in (2, 3) else None
            if halves:
                low, high = halves
                return await self._read_group(unit, low) + await self._read_group(unit, high)
            group.fail(error.code, self._clock.now_us())
            if error.code in (1, 2, 3):
                group.retry_at = time.monotonic() + REFUSED_READ_S
        else:
            group.store(values, self._clock.now_us())
        return (group,)

    def _note(self, point: Point, quality: int, kind: str, reason: str) -> None:
        """Count what is wrong with a channel, and tell of it when it changes."""
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

    async def _read_plans(self, plans: list[PlannedProfile]) -> None:
        """Read the planned profiles; whatever fails here leaves the channels alone."""
        problem = ""
        for unit in self._units:
            if unit.silent:
                continue
            for binding in unit.map.plans:
                config = binding.config
                if not isinstance(config, ModbusPlan):
                    continue
                try:
                    registers = await self._read_plan(unit.map.unit, config)
                    steps = decode_plan(registers, config.word_order)
                except (NoAnswerError, LinkLostError, DeviceRefusedError) as error:
                    problem = f"plan of {binding.asset}: {error}"
                    if not (isinstance(error, DeviceRefusedError) and error.busy):
                        self._plans_due = time.monotonic() + self._plan_backoff.next()
                except ImplausiblePlanError as error:
                    problem = f"plan of {binding.asset}: implausible {error}"
                else:
                    plans.append(PlannedProfile(binding.asset, self._clock.now_us(), steps))
        if problem:
            self._health.count_error("plan")
            if not self._plan_problem:
                logger.warning("source %s: %s", self.name, problem)
        else:
            self._plan_backoff.reset()
        self._plan_problem = problem

    async def _read_plan(self, unit: int, config: ModbusPlan) -> list[int]:
        """Read all rows; raise ImplausiblePlanError when the table moved between two requests."""
        registers: list[int] = []
        while len(registers) < config.rows * PLAN_ROW_REGISTERS:
            left = config.rows * PLAN_ROW_REGISTERS - len(registers)
            count = min(left, PLAN_ROWS_PER_READ * PLAN_ROW_REGISTERS)
            address = config.address + len(registers)
            registers += await self._link.read(config.kind, unit, address, count)
        if config.rows > PLAN_ROWS_PER_READ:
            first = await self._link.read(config.kind, unit, config.address, PLAN_ROW_REGISTERS)
            if list(first[2:]) != registers[2:PLAN_ROW_REGISTERS]:
                raise ImplausiblePlanError("table: the step changed while it was read")
        return registers


async def _answers(link: Link, unit: UnitMap) -> bool:
    """Tell if a unit answers anything to the read of its first group."""
    group = unit.groups[0]
    try:
        await link.read(group.kind, unit.unit, group.start, group.count)
    except DeviceRefusedError:
        return True
    except (NoAnswerError, LinkLostError):
        return False
    return True
