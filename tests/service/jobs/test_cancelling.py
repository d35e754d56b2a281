"""Jobs that are cancelled, at whatever moment."""

import asyncio

from job_shop import ASSET, QUICK, WHO, HeldExecutor, Shop, until
from patience import wait_for, within

from service.domain.requests import IdentificationRequest


async def test_a_cancelled_worker_stops_early(shop: Shop) -> None:
    jobs = await shop.open()
    endless = IdentificationRequest(method="noa", budget=5_000_000)
    shown, _ = await jobs.create(ASSET, endless, None, "x")
    await until(lambda: shop.row(shown.id).progress > 0.0)
    cancelled = await jobs.cancel(ASSET, shown.id)
    assert cancelled is not None
    assert cancelled.status == "cancelled"
    await until(lambda: not jobs.busy(ASSET))
    assert len(shop.store.models.versions(ASSET)) == 1
    assert not (shop.folder / shown.id).exists()


async def test_cancelled_while_its_data_are_read_the_worker_never_begins_in_earnest(
    shop: Shop,
) -> None:
    jobs = await shop.open()
    shown, _ = await jobs.create(
        ASSET, IdentificationRequest(method="noa", budget=5_000_000), None, "x"
    )
    async with within(30):
        for _ in iter(lambda: shop.row(shown.id).status, "running"):
            await asyncio.sleep(0)
    await jobs.cancel(ASSET, shown.id)
    await until(lambda: not jobs.busy(ASSET))
    assert shop.row(shown.id).status == "cancelled"


async def test_a_job_cancelled_at_the_very_end_takes_no_effect(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await wait_for(held.computed.wait(), 120)
    await jobs.cancel(ASSET, shown.id)
    held.let_go.set()
    job = await shop.ended(jobs, shown.id)
    assert job.status == "cancelled"
    assert len(shop.store.models.versions(ASSET)) == 1
    assert shop.active() == (1, 1)


async def test_whoever_cancels_while_the_result_takes_effect_is_told_that_it_did(
    shop: Shop,
) -> None:
    """Whatever the moment: either it is cancelled and there is no version, or there is one."""
    for steps in (0, 4, 8, 16):
        held = HeldExecutor()
        jobs = await shop.open(held)
        before = len(shop.store.models.versions(ASSET))
        shown, _ = await jobs.create(ASSET, QUICK, None, "x")
        await wait_for(held.computed.wait(), 120)
        held.let_go.set()
        for _ in range(steps):
            await asyncio.sleep(0.001)
        answer = await jobs.cancel(ASSET, shown.id)
        assert answer is not None
        job = await shop.ended(jobs, shown.id)
        assert answer.status == job.status
        added = len(shop.store.models.versions(ASSET)) - before
        assert added == (1 if job.status == "succeeded" else 0)
        assert shop.active()[0] == shop.active()[1]
        await jobs.stop()


async def test_a_queued_job_that_is_cancelled_never_runs(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    await jobs.create(ASSET, QUICK, None, "x")
    job, _ = shop.store.jobs.add("bench-2", {"windows": [], "windows_us": []} | WHO, 1)
    jobs.runner.begin(job)  # the API would refuse it: this asset has no data
    await wait_for(held.computed.wait(), 120)
    answer = await jobs.cancel("bench-2", job.id)
    assert answer is not None
    assert answer.status == "cancelled"
    held.let_go.set()
    await shop.ended(jobs, job.id)
    assert len(held.orders) == 1


async def test_a_job_that_has_ended_cannot_be_cancelled(shop: Shop) -> None:
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await shop.ended(jobs, shown.id)
    answer = await jobs.cancel(ASSET, shown.id)
    assert answer is not None
    assert answer.status == "succeeded"
    assert await jobs.cancel("bench-2", shown.id) is None
    assert await jobs.cancel(ASSET, "no such job") is None
