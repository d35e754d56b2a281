"""The forecast ledger of a cell: keeps forecasts, and holds them against what comes."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry, Counter

from service.cell.settling import News, Settling
from service.clock import ProcessClock
from service.store import Outbox, Store, StoreError
from service.store.forecast_records import IssuedForecast
from service.store.outbox import ForecastBatch

#: Wall seconds in which others may join a batch.
GATHER_S = 1.0
#: Process seconds between two looks at what is due, and at least so many wall seconds.
LOOK_EVERY_S, LOOK_LEAST_WALL_S = 60.0, 1.0
#: Its queue is not that of the alarms: it takes neither their turn nor their room on a full disk.
OUTBOX_FILE = "outbox-forecasts.db"
#: Batches that wait for a store that is away; beyond these forecasts are dropped and counted.
MOST_WAITING, MOST_UNKEPT = 50_000, 10_000
#: Wall seconds until the queue is tried again, and for its last batches at the stop.
_RETRY_S, _CLOSE_S = 2.0, 0.5

_log = structlog.get_logger(__name__)


class ForecastLedger:
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
    """

    def __init__(
        self,
        store: Store,
        data_dir: Path,
        clock: ProcessClock,
        registry: CollectorRegistry,
        is_ours: Callable[[], bool] = lambda: True,
        run: str = "",
    ) -> None:
        self._is_ours, self._run_name = is_ours, run
        self._store = store
        self._data_dir = data_dir
        self._clock = clock
        self._settling = Settling(store, clock.rate)
        self._new: list[IssuedForecast] = []
        self._failing = False
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
            "outside of the 95 % band, or set aside.",
            ["lead_time_s", "risk", "outcome"],
            registry=registry,
        )

    def take(self, issued: IssuedForecast) -> None:
        """Keep a forecast, with the next batch."""
        self._new.append(issued)

    async def run(self) -> None:
        """Keep what is taken and look at what is due, until cancelled."""
        wall_s = asyncio.get_running_loop().time
        every_wall_s = max(LOOK_EVERY_S / self._clock.rate, LOOK_LEAST_WALL_S)
        look_wall_s = wall_s() + every_wall_s
        outbox = await self._opened()
        try:
            while True:
                await asyncio.sleep(GATHER_S)
                self._hand_over(outbox)
                if wall_s() >= look_wall_s and self._is_ours():
                    await self._look()
                    look_wall_s = wall_s() + every_wall_s
        finally:
            self._hand_over(outbox)
            await to_thread.run_sync(outbox.close, _CLOSE_S)

    async def _opened(self) -> Outbox:
        """Open the queue; a disk without room for it holds up nothing else."""
        failing = False
        while True:
            try:
                return await to_thread.run_sync(
                    Outbox.open, self._data_dir, self._store, OUTBOX_FILE, self._run_name
                )
            except StoreError as error:
                if not failing:
                    _log.error("forecasts_not_kept", error=str(error))
                failing = True
                self._drop(MOST_UNKEPT)
                await asyncio.sleep(_RETRY_S)

    def _drop(self, most: int) -> None:
        """Forget the oldest of what has not been handed over, but for so many."""
        count = max(len(self._new) - most, 0)
        if count:
            del self._new[:count]
            self._dropped.inc(count)

    def _hand_over(self, outbox: Outbox) -> None:
        if outbox.waiting >= MOST_WAITING:
            self._drop(0)
        batch, self._new = tuple(self._new), []
        if not batch:
            return
        outbox.record(ForecastBatch(batch))
        for one in batch:
            self._kept.labels(one.reason).inc()

    async def _look(self) -> None:
        more = True
        while more:
            try:
                more, news = await to_thread.run_sync(
                    self._settling.look,
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
                # Whatever it was: forecasts are made and shown without it.
                if not self._failing:
                    _log.exception("forecasts_not_verified")
                self._failing = True
                return
            self._failing = False
            for one in news:
                self._count(one)

    def _count(self, one: News) -> None:
        words = {True: "inside", False: "outside", None: "set aside"}
        risk = "high" if one.high_risk else "low"
        self._readings.labels(str(one.lead_time_s), risk, words[one.inside]).inc()
