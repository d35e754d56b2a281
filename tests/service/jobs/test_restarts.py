"""Jobs across restarts and crashes of the service."""

import pytest
from job_shop import ASSET, QUICK, WHO, HeldExecutor, Shop
from patience import wait_for

pytestmark = pytest.mark.wires


async def test_a_stopped_service_takes_its_job_up_again(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await wait_for(held.computed.wait(), 120)
    await jobs.stop()
    waiting = shop.row(shown.id)
    assert (waiting.status, waiting.attempts) == ("queued", 0)
    again = await shop.open()
    job = await shop.ended(again, shown.id)
    assert (job.status, job.model_version) == ("succeeded", 2)
    assert len(shop.store.models.versions(ASSET)) == 2


@pytest.mark.parametrize("activated", [False, True])
async def test_a_version_that_was_stored_before_a_crash_is_not_made_twice(
    shop: Shop, activated: bool
) -> None:
    """Killed between storing the version and ending the job."""
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    done = await shop.ended(jobs, shown.id)
    version = shop.store.models.version(ASSET, 2)
    assert version is not None
    job, _ = shop.store.jobs.add(ASSET, done.request, shop.clock.us)
    shop.store.jobs.update(job.id, status="running", attempts=1)
    number = shop.store.models.add(
        ASSET, "candidate", "passed", version.document | {"job": job.id}, shop.clock.us
    )
    if activated:
        shop.store.models.activate(ASSET, number, "automatic", "passed", shop.clock.us)
    again = await shop.open()
    taken_up = await shop.ended(again, job.id)
    assert (taken_up.status, taken_up.model_version) == ("succeeded", 3)
    assert len(shop.store.models.versions(ASSET)) == 3
    assert [one.version for one in shop.store.models.activations(ASSET)] == [1, 2, 3]


async def test_a_job_that_kills_every_time_is_given_up(shop: Shop) -> None:
    request = {"windows": [], "windows_us": []} | WHO
    job, _ = shop.store.jobs.add(ASSET, request, shop.clock.us)
    shop.store.jobs.update(job.id, status="running", attempts=3)
    jobs = await shop.open()
    ended = await shop.ended(jobs, job.id)
    assert (ended.status, ended.error) == ("failed", "gave up after 3 attempts")


async def test_a_job_of_an_asset_that_is_no_longer_configured_is_left_alone(shop: Shop) -> None:
    job, _ = shop.store.jobs.add("gone", {"windows": [], "windows_us": []} | WHO, 1)
    await shop.open()
    left = shop.row(job.id)
    assert left.status == "queued"


async def test_a_start_clears_away_what_a_crash_left(shop: Shop) -> None:
    (shop.folder / "some job").mkdir(parents=True)
    await shop.open()
    assert not shop.folder.exists()
