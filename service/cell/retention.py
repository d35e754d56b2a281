"""Maintenance of the store next to the work: rollups, packing, and what is old is removed."""

import asyncio
import ctypes
import time
from collections.abc import Callable, Sequence
from functools import partial

import structlog
from anyio import to_thread

from adapters.protocol import Clock
from service.clock import DAY_US, HOUR_US, MICROSECONDS, ClockWatch, rfc3339, wall_us
from service.store import Retention, RetentionTime, Store, StoreError, StoreUnavailableError
from service.tasks import Part

#: Wall seconds between two looks for hours to condense, and for samples that are too old.
ROLLUPS_EVERY_S = 30.0
EXPIRE_EVERY_S = 600.0
#: Nothing is removed before the process clock has agreed with time that passes for this many
#: wall seconds.
TRUST_AFTER_S = 3600.0
#: Wall seconds after a start, and between two looks, for damage of the store's file.
CHECK_AFTER_S = 60.0
CHECK_EVERY_S = 86_400.0
#: Process time that a finished hour is given for late samples; later ones are right as well,
#: but cost another computation.
_SETTLE_US = 120_000_000
#: Process time after which an hour is packed: nearly all late samples have come by then.
_PACK_AFTER_US = HOUR_US
#: Wall seconds of one look in which hours are packed.
PACKING_S = 5.0
_HOUR_S = 3600.0
#: What the kernel answers while no time server disciplines its clock.
_TIME_ERROR = 5

_log = structlog.get_logger(__name__)


class StoreMaintenance(Part):
    """Keeps rollups up to date and the store within its retention.

    A clock that is wrong must not empty the store: nothing is removed before the clock has
    agreed with the monotonic clock for an hour, retention never moves on by more than two looks'
    worth at once, and a clock that is more than a week ahead of the look before is not believed
    unless the kernel says that a time server disciplines it.

    Parameters
    ----------
    store
        Open store.
    clock
        Process time.
    retention
        How long each resolution is kept.
    trust_after_s
        Wall seconds for which the clock must have agreed with the monotonic clock.
    is_ours
        Whether this cell, of several with one store, does what is done once for all of it: it
        removes what is old, and looks for damage.
    owns
        Whether this cell condenses and packs the samples of an asset; None: those of all.
    parts
        Those that remove what is old of their own.

    Attributes
    ----------
    problem : str or None
        Why nothing is removed although the clock says that it is due; None while all is well.
    damage : str or None
        What is wrong with the store's file, and what to do; None while nothing was found.
    """

    name = "maintenance"

    def __init__(
        self,
        store: Store,
        clock: Clock,
        retention: Retention,
        trust_after_s: float = TRUST_AFTER_S,
        is_ours: Callable[[], bool] = lambda: True,
        owns: Callable[[str], bool] | None = None,
        parts: Sequence[Part] = (),
    ) -> None:
        self._parts = parts
        self._store = store
        self._clock = clock
        self._retention = retention
        self._trust_after_s = trust_after_s
        self._is_ours = is_ours
        self._owns = owns
        self._packed_us = 0
        self.problem: str | None = None
        self.damage: str | None = None

    async def run(self) -> None:
        """Look again and again, until cancelled."""
        wall_s = asyncio.get_running_loop().time
        watch = ClockWatch(self._clock, wall_s)
        agrees_since_s = wall_s()
        expire_at_s = agrees_since_s + self._trust_after_s
        while True:
            now_s = wall_s()
            if watch.step_s():
                agrees_since_s = now_s
            expire_at_s = max(expire_at_s, agrees_since_s + self._trust_after_s)
            try:
                await to_thread.run_sync(
                    self._refresh,
                    self._clock.now_us() - _SETTLE_US,
                    abandon_on_cancel=True,  # a store that hangs does not hold up the stop
                )
                if now_s >= expire_at_s and self._is_ours():
                    expire_at_s = now_s + EXPIRE_EVERY_S
                    removed = await to_thread.run_sync(
                        partial(self._expire, self._clock.now_us(), wall_us()),
                        abandon_on_cancel=True,
                    )
                    if removed:
                        _log.info("expired", rows=removed)
            except StoreUnavailableError as error:
                _log.warning("upkeep_postponed", error=str(error))
            await asyncio.sleep(min(ROLLUPS_EVERY_S, max(expire_at_s - now_s, 1.0)))

    async def check(self) -> None:
        """Look through the store's file for damage soon and then once a day, until cancelled."""
        await asyncio.sleep(CHECK_AFTER_S)
        while True:
            try:
                if not self._is_ours():
                    await asyncio.sleep(CHECK_AFTER_S)
                    continue
                damage = await to_thread.run_sync(self._store.find_damage, abandon_on_cancel=True)
            except StoreError as error:
                damage = str(error)
            if damage and damage != self.damage:
                _log.error("store_damaged", problem=damage)
            self.damage = damage
            await asyncio.sleep(CHECK_EVERY_S)

    def _refresh(self, before_us: int) -> None:
        self._store.rollups.refresh(before_us, self._owns)
        hour_us = before_us - _PACK_AFTER_US
        hour_us -= hour_us % HOUR_US
        if hour_us == self._packed_us:
            return  # to look for the oldest samples of all channels takes a while
        # A store of an earlier version has years to pack: the rest waits for the next look.
        until_s = time.monotonic() + PACKING_S
        while self._store.packing.pack(hour_us, until_s, self._owns):
            pass
        while self._store.rollups.pack_rows(until_s, self._owns):
            pass
        if time.monotonic() < until_s:
            self._packed_us = hour_us

    def _expire(self, now_us: int, wall_now_us: int) -> int:
        step_s = 2 * EXPIRE_EVERY_S + _HOUR_S
        proven = is_clock_disciplined()
        process = self._store.rollups.retention_time(
            "process",
            now_us,
            round(step_s * max(self._clock.rate, 1.0) * MICROSECONDS),
            clock_proven=proven,
        )
        wall = self._store.rollups.retention_time(
            "wall", wall_now_us, round(step_s * MICROSECONDS), clock_proven=proven
        )
        self._judge(process, wall)
        removed = self._store.rollups.expire_at(self._retention, process.at_us)
        if self._retention.journal_days:
            kept_us = round(self._retention.journal_days * DAY_US)
            removed += self._store.alarms.expire(process.at_us - kept_us)
            removed += self._store.refused.expire(wall.at_us - kept_us)
        removed += sum(part.expire(process.at_us) for part in self._parts)
        if self._retention.audit_days:  # the trail goes by the wall clock
            before_us = wall.at_us - round(self._retention.audit_days * DAY_US)
            removed += self._store.audit.expire(before_us)
        return removed

    def _judge(self, *times: RetentionTime) -> None:
        ahead = max(times, key=lambda one: one.ahead_us)
        if not ahead.ahead_us:
            self.problem = None
            return
        problem = (
            f"the clock is {ahead.ahead_us / DAY_US:.0f} days ahead of the last look at "
            f"{rfc3339(ahead.at_us)}: nothing is removed; "
            "if the clock is right, run 'bearing-twin db horizon --confirm-clock'"
        )
        if self.problem is None:
            _log.error("retention_waits", reason=problem)
        self.problem = problem


def is_clock_disciplined() -> bool:
    """Return whether the kernel says that a time server keeps its clock; False where it cannot say.

    A clock that was set by hand, or that started from a battery, counts as not kept.
    """
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):  # not Linux
        return False
    # struct timex with no mode set only reads; it is 208 bytes long.
    state = int(adjtimex(ctypes.create_string_buffer(512)))
    return state >= 0 and state != _TIME_ERROR
