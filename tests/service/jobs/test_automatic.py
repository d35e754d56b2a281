"""Identification by itself."""

import asyncio
from pathlib import Path

import pytest
from job_shop import ASSET, HeldExecutor, Shop, away, until
from structlog.testing import capture_logs

from service.jobs.automatic import LOOK_EVERY_S, identify_automatically

pytestmark = pytest.mark.wires


async def test_new_windows_are_identified_by_itself_and_what_was_cancelled_is_not_repeated(
    shop: Shop, tmp_path: Path
) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    with away(tmp_path, "samples"), capture_logs() as logs:
        looking = asyncio.create_task(identify_automatically(jobs, shop.histories, shop.clock))
        # Looks that fail; the next ones must come all the same.
        await until(lambda: len([one for one in logs if "failed" in one["event"]]) > 3)
        assert shop.store.jobs.of_asset(ASSET) == []
    shop.clock.us += 24 * 3600 * 1_000_000
    try:
        await until(lambda: shop.store.jobs.of_asset(ASSET))
        (job,) = shop.store.jobs.of_asset(ASSET)
        assert job.request["who"] == "automatic"
        await jobs.cancel(ASSET, job.id)
        held.let_go.set()
        await shop.ended(jobs, job.id)
        await asyncio.sleep(100 * LOOK_EVERY_S / shop.clock.rate)
        assert len(shop.store.jobs.of_asset(ASSET)) == 1
        assert not looking.done()
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)
