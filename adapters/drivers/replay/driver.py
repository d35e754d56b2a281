"""The replay driver."""

import asyncio
import dataclasses
import logging
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from adapters.configuration import ConfigurationError, suggestion
from adapters.drivers.can.binding import bind
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.replay.can_logs import open_log
from adapters.drivers.replay.config import ReplayChannel, ReplaySource
from adapters.drivers.replay.order import GAP_S, ROWS_LOOKED_AT, SHORT_WAIT_S, descent, said
from adapters.drivers.replay.tables import Recording, open_recording
from adapters.protocol import ChannelBinding, Clock, PlanBinding, SourceHealth
from adapters.samples import Batch, Quality, Sample, is_good
from adapters.tables import RowError, TableFileError, units_stated
from adapters.times import EARLIEST_US, POSSIBLE, dated, is_possible
from adapters.units import KELVIN_OR_NOT, UnitError, factors_of, kelvin_doubt, unit_in

if TYPE_CHECKING:
    import can

logger = logging.getLogger(__name__)

# At full speed: less than what ingest takes in, so that nothing is left behind.
FAST_BATCH_SAMPLES = 5000
FAST_PAUSE_WALL_S = 0.05
#: Rows that are left out in one go.
FEW_ROWS = 200
QUIET_S = 600.0  # wall seconds between two lines of the log about gaps
REPEAT_PAUSE_S = 1.0  # process seconds between the end and the next beginning

Event = tuple[int, list[Sample]]
Found = Event | RowError


class ReplayDriver:
    """Plays a recorded file, see `adapters.protocol.Driver`."""

    def __init__(
        self,
        source: ReplaySource,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
        clock: Clock,
    ) -> None:
        check(source, channels, plans)
        self._source = source
        self._channels = list(channels)
        self._clock = clock
        self._health = SourceHealth(source.name, "replay")
        self._quiet_until_s = 0.0  # wall (monotonic) time before which no further gap is logged

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
        self._health.up = False

    def health(self) -> SourceHealth:
        """Say how far the file has been played."""
        return self._health

    async def batches(self) -> AsyncIterator[Batch]:
        """Yield what is due; when the file has ended, wait without end or begin again."""
        self._health.up, self._health.detail = True, "ok"
        ended = "the file has ended"
        while True:
            try:
                async for batch in self._once():
                    self._health.samples += len(batch.samples)
                    self._health.polls += 1
                    good = [one.time_us for one in batch.samples if is_good(one.quality)]
                    self._health.last_good_us = max(good, default=self._health.last_good_us)
                    yield batch
            except ConfigurationError as error:  # played again it would end there again
                self._health.count_error("file")
                ended = str(error)
                break
            if not self._source.repeat:
                break
            await self._clock.sleep(REPEAT_PAUSE_S)
        logger.info("source %s: %s has ended: %s", self.name, self._source.file, ended)
        if "row" in self._health.errors:
            ended += f"; {self._health.detail}"
        self._health.up, self._health.detail = False, ended
        await asyncio.Event().wait()

    async def _leave_out(self, error: RowError) -> None:
        """Report a row that cannot be played; of many, others have their turn between them."""
        self._health.count_error("row")
        count = self._health.errors["row"]
        if count % FEW_ROWS == 0:
            await asyncio.sleep(0)
        if count == 1:
            logger.warning("source %s: left out: %s", self.name, error)
        self._health.detail = f"{count} rows left out, the latest: {error}"

    def _say_gap(self, gap_s: float, time_us: int, due_us: int) -> None:
        """Report that nothing will be played for a long time."""
        self._health.detail = (
            f"{gap_s / 3600.0:.1f} h without a row, up to {said(time_us)}: "
            f"plays on at {dated(due_us)}"
        )
        if time.monotonic() >= self._quiet_until_s:
            self._quiet_until_s = time.monotonic() + QUIET_S
            logger.warning("source %s: %s", self.name, self._health.detail)

    async def _once(self) -> AsyncIterator[Batch]:
        speed = self._source.speed
        began_us, first_us = self._clock.now_us(), None
        latest_us: int | None = None
        waiting: list[Sample] = []
        problem: ConfigurationError | None = None
        with _events(self._source, self._channels, self._clock) as events:
            while True:
                try:
                    event = next(events, None)
                except ConfigurationError as error:  # what came before it is played
                    problem = error
                    break
                if event is None:
                    break
                if isinstance(event, RowError):
                    await self._leave_out(event)
                    continue
                time_us, samples = event
                if not samples:
                    continue
                if speed == 0.0:
                    waiting += samples
                    if len(waiting) >= FAST_BATCH_SAMPLES:
                        yield Batch(waiting)
                        waiting = []
                        await asyncio.sleep(FAST_PAUSE_WALL_S)
                    continue
                first_us = time_us if first_us is None else first_us
                if time_us < first_us:  # it would be stamped before the play began
                    await self._leave_out(RowError(f"{said(time_us)} is before the first row"))
                    continue
                due_us = began_us + round((time_us - first_us) / speed)
                ahead_s = (due_us - self._clock.now_us()) / 1e6
                gap_s = 0.0 if latest_us is None else (time_us - latest_us) / 1e6
                latest_us = time_us
                if ahead_s > 0.0:
                    before = self._health.detail
                    if max(gap_s, ahead_s) > GAP_S and ahead_s > SHORT_WAIT_S:
                        self._say_gap(gap_s, time_us, due_us)
                    if waiting:
                        yield Batch(waiting)
                        waiting = []
                    await self._clock.sleep(ahead_s)
                    self._health.detail = before
                waiting += [one._replace(time_us=due_us, received_us=due_us) for one in samples]
        if waiting:
            yield Batch(waiting)
        if problem is not None:
            raise problem


def check(
    source: ReplaySource, channels: Sequence[ChannelBinding], plans: Sequence[PlanBinding]
) -> None:
    """Check a file with everything bound to it. Raises `ConfigurationError`, also for a plan."""
    if plans:
        raise ConfigurationError(
            f"plan of {plans[0].asset}: source {source.name!r} is a file, "
            "a plan needs a Modbus source"
        )
    for binding in channels:
        config = _config(binding)
        if source.is_can_log != (config.column is None):
            expected = "message and signal" if source.is_can_log else "column"
            raise ConfigurationError(
                f"channel {binding.asset}/{binding.channel}: expected {expected}, since source "
                f"{source.name!r} plays {source.file.name!r}"
            )
    try:
        with source.file.open("rb"):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"source {source.name!r}: file {str(source.file)!r} cannot be read: {error.strerror}"
        ) from None
    if source.is_can_log:
        bind(*_as_can(source, channels))
        with open_log(source.file, needs_dates=source.speed == 0.0) as frames:
            first = next(frames, None)
        if first is None:
            raise ConfigurationError(
                f"source {source.name!r}: file {str(source.file)!r} holds no frame"
            )
        if source.speed == 0.0 and not _is_dated(first.timestamp):
            raise _undated(source, "a date at the beginning of the log")
        return
    with open_recording(source.file) as recording:
        columns = recording.columns
        if source.speed == 0.0 and not recording.is_dated:
            raise _undated(source, "a column time")
        if source.speed > 0.0:
            _check_order(source, recording)
        for binding in channels:
            column = _config(binding).column or ""
            if columns is not None and column not in columns:
                raise ConfigurationError(
                    f"channel {binding.asset}/{binding.channel}: column {column!r} is not in "
                    f"{source.file.name!r}; {suggestion(column, columns)}"
                )
    _scaled(source, channels)


def _check_order(source: ReplaySource, recording: Recording) -> None:
    """Refuse a table of which a play would leave out all but the first row."""
    times_us: list[int] = []
    with suppress(ConfigurationError):  # it is played up to where it is damaged
        for row in islice(recording.rows, ROWS_LOOKED_AT):
            if isinstance(row, RowError):
                continue
            if not recording.is_dated or is_possible(row[0], time.time_ns() // 1000):
                times_us.append(row[0])
    found = descent(times_us)
    if found is not None:
        raise ConfigurationError(
            f"source {source.name!r}: file {str(source.file)!r}: times descend, from "
            f"{said(found[0])} to {said(found[1])}; expected the earliest row first, or speed = 0"
        )


def _scaled(source: ReplaySource, channels: Sequence[ChannelBinding]) -> list[ChannelBinding]:
    """Give the channels of a table scale and offset of the units that it states.

    Raises `ConfigurationError` for one that is none of the channel's.
    """
    try:
        stated = units_stated(source.file)
    except TableFileError as error:
        raise ConfigurationError(f"file {str(source.file)!r}: {error}") from None
    found = []
    for binding in channels:
        config = _config(binding)
        column = config.column or ""
        where = f"channel {binding.asset}/{binding.channel}: column {column!r}"
        doubt = "" if stated.get(column) else kelvin_doubt(config, binding.unit, column)
        if doubt:
            raise ConfigurationError(f"{where}: {doubt}; expected {KELVIN_OR_NOT}")
        unit = stated.get(column) or unit_in(column, binding.unit)
        try:
            factors = factors_of(config, binding.unit, unit)
        except UnitError as error:
            raise ConfigurationError(f"{where} is {error}, or scale") from None
        keys = {"scale": factors[0], "offset": factors[1]}
        found.append(dataclasses.replace(binding, config=config.model_copy(update=keys)))
    return found


def _undated(source: ReplaySource, expected: str) -> ConfigurationError:
    return ConfigurationError(
        f"source {source.name!r}: speed = 0 keeps the times of {source.file.name!r}, which has no "
        f"date; expected {expected}, or a speed above 0"
    )


def _is_dated(timestamp_s: float) -> bool:
    return timestamp_s * 1e6 >= EARLIEST_US


@contextmanager
def _events(
    source: ReplaySource, channels: Sequence[ChannelBinding], clock: Clock
) -> Iterator[Iterator[Found]]:
    now_us = clock.now_us()
    if source.is_can_log:
        with open_log(source.file, needs_dates=source.speed == 0.0) as log:
            yield _frames(source, channels, log, now_us)
        return
    by_column: dict[str, list[ChannelBinding]] = {}
    for binding in _scaled(source, channels):
        by_column.setdefault(_config(binding).column or "", []).append(binding)
    with open_recording(source.file) as recording:

        def played() -> Iterator[Found]:
            for row in recording.rows:
                if isinstance(row, RowError):
                    yield row
                    continue
                time_us, cells = row
                if recording.is_dated and not is_possible(time_us, now_us):
                    yield _impossible(time_us)
                    continue
                yield (
                    time_us,
                    [
                        _sample(binding, time_us, *cell)
                        for column, cell in cells.items()
                        for binding in by_column.get(column, ())
                    ],
                )

        yield played()


def _impossible(time_us: int) -> RowError:
    return RowError(f"{dated(time_us)}: expected {POSSIBLE}")


def _sample(binding: ChannelBinding, time_us: int, value: float, quality: int) -> Sample:
    config = _config(binding)
    value = value * config.scale + config.offset
    limits = config.valid_range
    if is_good(quality) and limits is not None and not limits[0] <= value <= limits[1]:
        quality = int(Quality.EU_EXCEEDED)
    return Sample(binding.asset, binding.channel, time_us, value, quality, time_us)


def _frames(
    source: ReplaySource,
    channels: Sequence[ChannelBinding],
    log: Iterator["can.Message"],
    now_us: int,
) -> Iterator[Found]:
    messages = bind(*_as_can(source, channels))
    is_dated = None
    for frame in log:
        message = messages.find(frame.arbitration_id, frame.is_extended_id)
        if message is None or frame.is_error_frame or frame.is_remote_frame:
            continue
        time_us = round(frame.timestamp * 1e6)
        if is_dated is None:
            is_dated = _is_dated(frame.timestamp)
        if is_dated and not is_possible(time_us, now_us):
            yield _impossible(time_us)
        elif not is_dated and not 0 <= time_us < EARLIEST_US:
            # Such a log is played by the distances of its frames.
            yield RowError(f"{dated(time_us)} in a log without a date: expected seconds")
        else:
            yield time_us, message.receive(frame.arbitration_id, frame.data, time_us)


def _as_can(
    source: ReplaySource, channels: Sequence[ChannelBinding]
) -> tuple[CanSource, list[ChannelBinding]]:
    """The same as if the frames came from a bus."""
    bus = CanSource(name=source.name, interface="virtual", channel="", dbc=source.dbc or Path())
    bound = []
    for binding in channels:
        keys = _config(binding).model_dump(include=set(CanChannel.model_fields))
        bound.append(
            ChannelBinding(
                binding.asset, binding.channel, CanChannel.model_validate(keys), binding.unit
            )
        )
    return bus, bound


def _config(binding: ChannelBinding) -> ReplayChannel:
    if not isinstance(binding.config, ReplayChannel):
        raise TypeError(f"{binding.asset}/{binding.channel}: expected a ReplayChannel")
    return binding.config
