"""The ledger's part of the cell: keeps forecasts, and compares them with what comes."""

import asyncio
import math
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry, Counter

from service.cell.core import Core
from service.clock import DAY_US, ProcessClock
from service.features.ledger.keeping import KeptForecastsOf
from service.features.ledger.record import RECORD_DAYS, Kind, Record, records_of
from service.features.ledger.scoring import ForecastScoring, Score
from service.features.ledger.tables import FORECASTS_FILE_NAME, ForecastBatch, KeptForecasts
from service.live.asset import AssetRuntime
from service.store import Outbox, Store, StoreError
from service.store.forecast_records import IssuedForecast
from service.tasks import Part

#: Wall seconds in which others may join a batch.
GATHER_S = 1.0
#: Process seconds between two looks at what is due, and at least so many wall seconds.
SCORING_EVERY_S, SCORING_LEAST_WALL_S = 60.0, 1.0
#: Process seconds after which the record of an asset is read again, where an alarm has asked for it
#: and where none has, and at least so many wall seconds.
RECORD_EVERY_S, RECORD_IDLE_S, RECORD_LEAST_WALL_S = 600.0, 3600.0, 10.0
#: Batches that wait for a store that is offline; beyond these forecasts are dropped and counted.
MAX_WAITING, MAX_UNSAVED = 50_000, 10_000
#: Wall seconds until the queue is tried again, and for its last batches at the stop.
_RETRY_S, _CLOSE_S = 2.0, 0.5

_log = structlog.get_logger(__name__)


def part(core: Core) -> "ForecastLedger":
    """Make the ledger of a cell."""
    return ForecastLedger(
        core.store,
        core.settings.data_dir,
        core.clock,
        core.registry,
        core.is_maintenance_leader,
        core.run_name,
        core.settings.retention.forecast_days,
    )


class ForecastLedger(Part):
    """Keeps the forecasts of all assets in common transactions; all methods in one event loop.

    Parameters
    ----------
    store, data_dir, clock
        Where forecasts end up, where they wait for it, process time.
    registry : prometheus_client.CollectorRegistry
        Where its figures are shown.
    is_ours : callable
        Whether this cell looks at what is due, of several with one store.
    run : str
        Name of this run, where there are several cells.
    kept_days : float
        How long forecasts are kept, in process time; 0 without limit.
    """

    name = "forecast ledger"
    is_first = True

    def __init__(
        self,
        store: Store,
        data_dir: Path,
        clock: ProcessClock,
        registry: CollectorRegistry,
        is_ours: Callable[[], bool] = lambda: True,
        run: str = "",
        kept_days: float = 0.0,
    ) -> None:
        self._kept_us = round(kept_days * DAY_US)
        self._is_ours, self._run_name = is_ours, run
        self._store = store
        self._data_dir = data_dir
        self._clock = clock
        self._scoring = ForecastScoring(store, clock.rate)
        self._new: list[IssuedForecast] = []
        self._failing = False
        self._followers: weakref.WeakSet[KeptForecastsOf] = weakref.WeakSet()
        self._kept = Counter(
            "bearing_twin_forecasts_kept",
            "Live forecasts that were kept, by why: a step, ten minutes, another model version.",
            ["reason"],
            registry=registry,
        )
        self._dropped = Counter(
            "bearing_twin_forecasts_dropped",
            "Live forecasts that were not kept, since too much waits for the store.",
            registry=registry,
        )
        self._readings = Counter(
            "bearing_twin_forecast_readings",
            "Readings of kept forecasts whose time has come, by what came of them: inside or "
            "outside of the 95 % band, left inside or outside of it where the plan was left, "
            "or set aside.",
            ["lead_time_s", "risk", "outcome"],
            registry=registry,
        )

    def settle(self, twin: AssetRuntime) -> None:
        """Follow the live forecasts of an asset."""
        follower = KeptForecastsOf(twin, self._clock, self.take)
        self._followers.add(follower)
        twin.follow_forecasts(follower)

    def expire(self, now_us: int) -> int:
        """Remove forecasts that were made before the days for which they are kept."""
        if not self._kept_us:
            return 0
        return self._store.part(KeptForecasts).expire(now_us - self._kept_us)

    def take(self, issued: IssuedForecast) -> None:
        """Keep a forecast, with the next batch."""
        self._new.append(issued)

    async def run(self) -> None:
        """Keep what is taken and look at what is due, until cancelled."""
        wall_s = asyncio.get_running_loop().time
        every_wall_s = max(SCORING_EVERY_S / self._clock.rate, SCORING_LEAST_WALL_S)
        look_wall_s = wall_s() + every_wall_s
        outbox = await self._opened()
        try:
            while True:
                await asyncio.sleep(GATHER_S)
                self._hand_over(outbox)
                if wall_s() >= look_wall_s and self._is_ours():
                    await self._score_due()
                    look_wall_s = wall_s() + every_wall_s
                await self._read_record()
        finally:
            self._hand_over(outbox)
            await to_thread.run_sync(outbox.close, _CLOSE_S)

    async def _opened(self) -> Outbox:
        """Open the queue; a disk without room for it holds up nothing else."""
        failing = False
        while True:
            try:
                return await to_thread.run_sync(
                    Outbox.open, self._data_dir, self._store, FORECASTS_FILE_NAME, self._run_name
                )
            except StoreError as error:
                if not failing:
                    _log.error("forecasts_not_kept", error=str(error))
                failing = True
                self._drop(MAX_UNSAVED)
                await asyncio.sleep(_RETRY_S)

    def _drop(self, most: int) -> None:
        """Forget the oldest of what has not been handed over, but for so many."""
        count = max(len(self._new) - most, 0)
        if count:
            del self._new[:count]
            self._dropped.inc(count)

    def _hand_over(self, outbox: Outbox) -> None:
        if outbox.waiting >= MAX_WAITING:
            self._drop(0)
        batch, self._new = tuple(self._new), []
        if not batch:
            return
        outbox.record(ForecastBatch(batch))
        for one in batch:
            self._kept.labels(one.reason).inc()

    async def _score_due(self) -> None:
        more = True
        while more:
            try:
                more, scores = await to_thread.run_sync(
                    self._scoring.look,
                    self._clock.now_us(),
                    abandon_on_cancel=True,  # a store that hangs does not hold up the stop
                )
            except StoreError as error:
                # Nothing is lost: what is due stays so.
                if not self._failing:
                    _log.warning("forecasts_wait_for_the_store", error=str(error))
                self._failing = True
                return
            except Exception:
                # Forecasts are made and shown without it.
                if not self._failing:
                    _log.exception("forecasts_not_verified")
                self._failing = True
                return
            self._failing = False
            for one in scores:
                self._count(one)

    async def _read_record(self) -> None:
        """Read the record of the asset that waits for it longest, of one at a time."""
        now_us, least_us = self._clock.now_us(), RECORD_LEAST_WALL_S * 1e6 * self._clock.rate

        def overdue_us(one: KeptForecastsOf) -> float:
            every_s = RECORD_EVERY_S if one.is_asked else RECORD_IDLE_S
            if one.read_us is None or one.read_us > now_us:
                return math.inf
            return now_us - one.read_us - max(every_s * 1e6, least_us)

        follower = max(self._followers, key=overdue_us, default=None)
        if follower is None or overdue_us(follower) < 0.0:
            return
        start_us = now_us - round(RECORD_DAYS * DAY_US)
        asset = follower.asset

        def read() -> Mapping[Kind, Record]:
            return records_of(self._store.part(KeptForecasts).since(asset, start_us))

        try:
            records = await to_thread.run_sync(read, abandon_on_cancel=True)
        except StoreError:
            return  # the alarms have the record before
        follower.note_records(records, now_us)

    def _count(self, one: Score) -> None:
        words = {True: "inside", False: "outside", None: "set aside"}
        risk = "high" if one.high_risk else "low"
        outcome = words[one.inside]
        if one.left_inside is not None:
            outcome = f"left {words[one.left_inside]}"
        self._readings.labels(str(one.lead_time_s), risk, outcome).inc()
