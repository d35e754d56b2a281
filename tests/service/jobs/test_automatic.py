"""Identification by itself."""

import asyncio
from pathlib import Path

from job_shop import ASSET, HeldExecutor, Shop, away, until

from service.jobs.automatic import identify_by_itself


async def test_new_windows_are_identified_by_itself_and_what_was_cancelled_is_not_repeated(
    shop: Shop, tmp_path: Path
) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shop.clock.rate = 3600.0
    with away(tmp_path, "samples"):  # the first look fails; the next ones must come all the same
        looking = asyncio.create_task(identify_by_itself(jobs, shop.histories, shop.clock))
        await asyncio.sleep(1.5)
        assert shop.store.jobs(ASSET) == []
    shop.clock.us += 24 * 3600 * 1_000_000
    try:
        await until(lambda: shop.store.jobs(ASSET))
        (job,) = shop.store.jobs(ASSET)
        assert job.request["who"] == "automatic"
        await jobs.cancel(ASSET, job.id)
        held.let_go.set()
        await shop.ended(jobs, job.id)
        await asyncio.sleep(2.5)
        assert len(shop.store.jobs(ASSET)) == 1
        assert not looking.done()
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)
