"""A night's run over some machines, one of which kills or stops its workers."""

import asyncio
import pickle
import time
from datetime import datetime

import pytest
from job_shop import WHO, Shop
from site_files import asset_section

from adapters.protocol import Clock
from service.domain.errors import TemporaryError
from service.features.nights.account import ExecutorName, FleetIdentification
from service.features.nights.batch_executors import BatchFailedError, WorkerLostError
from service.features.nights.batches import OtherSoftwareError, packed_orders, run_batch
from service.features.nights.identification import (
    MAX_ATTEMPTS,
    batches_of,
    identify_fleet,
    night_of,
)
from service.features.nights.night import Night
from service.features.nights.results import NightModel, Nights
from service.features.nights.tables import FleetRuns
from service.store import AuditEntry, Job

pytestmark = pytest.mark.wires

ASSETS = ("bench-1", "bench-2", "bench-3", "bench-4", "bench-5")
DEADLY = "bench-2"


class Workers:
    """Compute here; a batch with one of the machines fails."""

    name: ExecutorName = "process"
    worker_count = 1

    def __init__(self, error: RuntimeError) -> None:
        self.error = error
        self.workers_lost = 0
        self.sizes: list[int] = []

    async def compute(self, content: bytes) -> bytes:
        _, orders = pickle.loads(content)
        self.sizes.append(len(orders))
        if any(order.asset == DEADLY for order in orders):
            self.workers_lost += 1
            raise self.error
        return run_batch(content)


@pytest.mark.parametrize(
    ("error", "tries", "reason"),
    [
        (WorkerLostError("killed"), MAX_ATTEMPTS, f"{MAX_ATTEMPTS} workers died of it"),
        (BatchFailedError("hangs"), 1, "hangs"),
    ],
)
async def test_a_machine_that_kills_or_stops_workers_does_not_stop_the_others(
    shop: Shop, error: RuntimeError, tries: int, reason: str
) -> None:
    for asset in ASSETS[1:4]:
        shop.copy_run(asset)
    running, _ = shop.store.jobs.add("bench-3", WHO, 1)
    night = Night(
        "2026-11-22",
        shop.store,
        shop.clock,
        "night shift",
        lambda action, target, detail: AuditEntry(1, "night shift", "", action, target, detail),
    )
    progress: list[float] = []
    workers = Workers(error)
    assets = [asset_section(id=asset) for asset in ASSETS]
    found = await identify_fleet(
        night, assets, workers, lambda done, _: progress.append(done), {"bench-6": "model: wrong"}
    )
    items = {item.asset: (item.status, item.reason) for item in found.items}
    assert items["bench-1"][0] == items["bench-4"][0] == "identified"
    assert items[DEADLY] == ("failed", reason)
    assert items["bench-3"] == ("skipped", f"identification {running.id} is queued")
    assert items["bench-5"] == ("skipped", "no low-risk window in the store")
    assert items["bench-6"] == ("failed", "model: wrong")
    assert (found.machines, found.skipped, found.failed) == (2, 2, 2)
    # Three machines, divided until the one is alone.
    assert workers.sizes == [3] * tries + [1] + [2] * tries + [1] * tries + [1]
    assert found.workers_lost == 3 * tries
    assert progress == sorted(progress)
    assert progress[-1] == 1.0
    assert set(shop.store.part(Nights).done("2026-11-22", ASSETS)) == {"bench-1", "bench-4"}
    (kept,) = shop.store.part(FleetRuns).all()
    assert kept.ended_us is not None
    assert (kept.asked, kept.identified, kept.skipped, kept.failed) == (6, 2, 2, 2)
    assert kept.problems == {DEADLY: reason, "bench-6": "model: wrong"}
    assert kept.processor_s == pytest.approx(found.processor_seconds, abs=0.1)


async def test_a_run_that_loses_its_workers_reports_what_was_done_until_then(shop: Shop) -> None:
    class Lost(Workers):
        async def compute(self, content: bytes) -> bytes:
            raise TemporaryError("scheduler: the connection is lost")

    night = Night(
        "2026-11-22",
        shop.store,
        shop.clock,
        "night shift",
        lambda action, target, detail: AuditEntry(1, "night shift", "", action, target, detail),
    )
    assets = [asset_section(id=asset) for asset in ("bench-5", "bench-1")]
    reports: list[FleetIdentification] = []
    with pytest.raises(TemporaryError, match="the connection is lost"):
        await identify_fleet(
            night,
            assets,
            Lost(WorkerLostError()),
            lambda done, text: None,
            {"bench-6": "model: wrong"},
            reports.append,
        )
    (found,) = reports
    items = {item.asset: item.status for item in found.items}
    assert items == {"bench-5": "skipped", "bench-6": "failed"}


async def test_a_result_that_is_being_stored_when_the_run_ends_is_counted(
    shop: Shop, monkeypatch: pytest.MonkeyPatch
) -> None:
    shop.copy_run("bench-5")
    nights, storing = shop.store.part(Nights), asyncio.Event()
    keep, loop = nights.keep, asyncio.get_running_loop()

    def slowly(night: str, job: Job, model: NightModel | None) -> Job | None:
        loop.call_soon_threadsafe(storing.set)
        time.sleep(0.5)  # long enough for the end of the run
        return keep(night, job, model)

    monkeypatch.setattr(nights, "keep", slowly)

    class Lost(Workers):
        async def compute(self, content: bytes) -> bytes:
            _, orders = pickle.loads(content)
            if orders[0].asset == "bench-1":
                return run_batch(content)
            await storing.wait()
            raise TemporaryError("scheduler: the connection is lost")

    def audit(action: str, target: str, detail: str) -> AuditEntry:
        return AuditEntry(1, "night shift", "", action, target, detail)

    night = Night("2026-11-22", shop.store, shop.clock, "night shift", audit)
    assets = [asset_section(id=asset) for asset in ASSETS]
    reports: list[FleetIdentification] = []
    with pytest.raises(TemporaryError):
        await identify_fleet(
            night, assets, Lost(WorkerLostError()), lambda *_: None, {}, reports.append
        )
    (found,) = reports
    assert found.machines == 1
    assert list(nights.done("2026-11-22", ASSETS)) == ["bench-1"]


class Earlier:
    """The clock of a night before."""

    def __init__(self, clock: Clock, by_us: int) -> None:
        self._clock, self._by_us, self.rate = clock, by_us, clock.rate

    def now_us(self) -> int:
        return self._clock.now_us() - self._by_us

    async def sleep(self, process_seconds: float) -> None:
        await self._clock.sleep(process_seconds)


async def test_an_asset_without_new_data_is_left_out_until_there_are_some(shop: Shop) -> None:
    class Here(Workers):
        async def compute(self, content: bytes) -> bytes:
            return run_batch(content)

    section = asset_section(id=ASSETS[0])

    async def night(name: str, minutes_ago: int) -> FleetIdentification:
        def audit(action: str, target: str, detail: str) -> AuditEntry:
            return AuditEntry(1, "night shift", "", action, target, detail)

        clock = Earlier(shop.clock, minutes_ago * 60_000_000)
        of_night = Night(name, shop.store, clock, "night shift", audit)
        workers = Here(RuntimeError())
        return await identify_fleet(of_night, [section], workers, lambda *_: None, {})

    assert (await night("2026-11-20", 30)).machines == 1
    # A pause between two nights: a look at the night before is one at the last that there was.
    for name in ("2026-11-21", "2026-11-23"):
        nothing_new = await night(name, 30)
        (item,) = nothing_new.items
        assert item.status == "skipped"
        assert item.reason == "no new low-risk data since the night of 2026-11-20"
    assert shop.store.part(FleetRuns).all()[0].without_new_data == 1
    assert (await night("2026-11-24", 0)).machines == 1
    latest = shop.store.part(Nights).latest(ASSETS)[ASSETS[0]]
    assert latest.idempotency_key == "fleet 2026-11-24"
    # The priors were made active: there is something to find again.
    document = shop.store.models.versions(ASSETS[0])[0].document
    number = shop.store.models.add(ASSETS[0], "candidate", "again", document, 1)
    shop.store.models.activate(ASSETS[0], number, "eva", "", 1)
    assert (await night("2026-11-25", 0)).machines == 1


def test_a_worker_with_other_software_refuses_the_work() -> None:
    software, _ = pickle.loads(packed_orders([]))
    with pytest.raises(OtherSoftwareError, match=r"has numpy \S+; expected numpy 1\.0"):
        run_batch(pickle.dumps((software | {"numpy": "1.0"}, [])))


def test_a_night_has_the_date_of_its_evening_and_ends_at_noon() -> None:
    for hour, night in ((12, "2026-11-22"), (23, "2026-11-22"), (0, "2026-11-21")):
        assert night_of(datetime(2026, 11, 22, hour)) == night


def test_batches_are_small_enough_to_end_together_and_hold_every_asset() -> None:
    assets = [asset_section(id=f"m-{k}") for k in range(300)]
    for count, workers, size in ((3, 8, 3), (100, 2, 6), (300, 1, 16), (300, 64, 4)):
        batches = batches_of(assets[:count], workers)
        assert [one for batch in batches for one in batch] == assets[:count]
        assert max(len(batch) for batch in batches) == size
