"""A night's run over some machines, one of which kills or stops its workers."""

import pickle
from collections.abc import Callable
from datetime import datetime
from typing import Any

import pytest
from job_shop import WHO, Shop

from service.documents.fleet_identification import ExecutorName
from service.jobs.batch_executors import BatchFailedError, WorkerLostError
from service.jobs.batches import OtherSoftwareError, packed_orders, run_batch
from service.jobs.fleet import MOST_ATTEMPTS, Night, batches_of, identify_fleet, night_of
from service.store import AuditEntry

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
        (WorkerLostError("killed"), MOST_ATTEMPTS, f"{MOST_ATTEMPTS} workers died of it"),
        (BatchFailedError("hangs"), 1, "hangs"),
    ],
)
async def test_a_machine_that_kills_or_stops_workers_does_not_stop_the_others(
    shop: Shop, make_section: Callable[..., Any], error: RuntimeError, tries: int, reason: str
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
    told: list[float] = []
    workers = Workers(error)
    assets = [make_section(id=asset) for asset in ASSETS]
    found = await identify_fleet(
        night, assets, workers, lambda done, _: told.append(done), {"bench-6": "model: wrong"}
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
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert set(shop.store.nights.done("2026-11-22", ASSETS)) == {"bench-1", "bench-4"}


def test_a_worker_with_other_software_refuses_the_work() -> None:
    software, _ = pickle.loads(packed_orders([]))
    with pytest.raises(OtherSoftwareError, match=r"has numpy \S+; expected numpy 1\.0"):
        run_batch(pickle.dumps((software | {"numpy": "1.0"}, [])))


def test_a_night_has_the_date_of_its_evening_and_ends_at_noon() -> None:
    for hour, night in ((12, "2026-11-22"), (23, "2026-11-22"), (0, "2026-11-21")):
        assert night_of(datetime(2026, 11, 22, hour)) == night


def test_batches_are_small_enough_to_end_together_and_hold_every_asset(
    make_section: Callable[..., Any],
) -> None:
    assets = [make_section(id=f"m-{k}") for k in range(300)]
    for count, workers, size in ((3, 8, 3), (100, 2, 6), (300, 1, 16), (300, 64, 4)):
        batches = batches_of(assets[:count], workers)
        assert [one for batch in batches for one in batch] == assets[:count]
        assert max(len(batch) for batch in batches) == size
