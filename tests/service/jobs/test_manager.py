"""Identification jobs, from the request to the live twin."""

import json
from pathlib import Path

import pytest
from job_shop import ASSET, QUICK, WHO, HeldExecutor, Shop, away, until
from patience import wait_for
from site_files import asset_section
from structlog.testing import capture_logs

from service.clock import rfc3339
from service.domain.errors import JobConflictError, KeyUsedBeforeError, RequestRefusedError
from service.domain.requests import IdentificationRequest, TimeWindow

pytestmark = pytest.mark.wires

MINUTE_US = 60_000_000


def windows(shop: Shop, *spans_min: tuple[int, int]) -> IdentificationRequest:
    """A request for spans in minutes from the start of the run."""
    start_us = shop.clock.us - 150 * MINUTE_US
    return IdentificationRequest(
        windows=[
            TimeWindow.model_validate(
                {
                    "start": rfc3339(start_us + first * MINUTE_US),
                    "end": rfc3339(start_us + last * MINUTE_US),
                }
            )
            for first, last in spans_min
        ],
        method="refine",
    )


async def test_a_job_ends_with_a_version_that_the_twin_runs_on(shop: Shop) -> None:
    jobs = await shop.open()
    subscription = shop.bus.subscribe()
    shown, created = await jobs.create(ASSET, QUICK, None, "engineer x")
    assert created
    assert (shown.status, shown.requested_by) == ("queued", "engineer x")
    assert jobs.busy(ASSET)
    job = await shop.ended(jobs, shown.id)
    assert (job.status, job.progress, job.model_version, job.attempts) == ("succeeded", 1.0, 2, 1)
    assert job.evaluations > 0
    assert job.best_fitness is not None
    assert shop.active() == (2, 2)
    version = shop.store.models.version(ASSET, 2)
    assert version is not None
    assert version.document["job"] == job.id
    assert version.document["gates"]["accepted"] is True
    assert version.document["windows"][0]["speed_rpm_max"] == pytest.approx(4200, abs=1)
    assert set(version.document["scores"]) >= {"train_rms_k", "extrapolation"}
    assert set(version.document["naive"]["extrapolation"]) >= {"persistence", "arx"}
    assert not (shop.folder / job.id).exists(), "nothing is left behind"
    assert len(shop.seconds) == 1
    messages = []
    while not messages or messages[-1]["data"]["status"] != "succeeded":
        messages.append(json.loads((await subscription.get()).text))
    assert [one["data"]["status"] for one in messages[:2]] == ["queued", "running"]
    whole = await jobs.job(ASSET, job.id)
    assert whole is not None
    evaluations, fitness = zip(*whole.convergence, strict=True)
    assert list(evaluations) == sorted(evaluations)
    assert list(fitness) == sorted(fitness, reverse=True)
    assert fitness[-1] == pytest.approx(job.best_fitness)
    # The priors, which are active, cannot meet the data as well as what was fitted to them.
    assert whole.active_fitness > 2 * fitness[-1]
    assert (whole.phase, whole.seconds_left) == (None, None), "it has ended"
    after_restart = await (await shop.open()).job(ASSET, job.id)
    assert after_restart is not None
    assert after_restart.active_fitness == pytest.approx(whole.active_fitness)
    assert after_restart.convergence[-1] == whole.convergence[-1]
    # Who sees the end of the job sees its version at work.
    assert shop.store.models.activations(ASSET)[-1].who == "automatic"
    assert shop.outbox.flush(30)
    (line,) = shop.store.audit.page().items
    assert (line.who, line.action) == ("automatic", "model.activate")
    assert line.target == f"asset {ASSET}, version 2"


async def test_a_second_version_is_compared_with_the_first(shop: Shop) -> None:
    jobs = await shop.open()
    for number, seed in ((2, 0), (3, 1)):
        request = IdentificationRequest(method="refine", seed=seed)
        shown, _ = await jobs.create(ASSET, request, None, "x")
        job = await shop.ended(jobs, shown.id)
        assert job.model_version == number
    first, second = (shop.store.models.version(ASSET, number) for number in (2, 3))
    assert first is not None
    assert second is not None
    assert first.document["drift"]["changed"] is None
    assert first.document["drift"]["quantities"]["friction"]["value"] > 0.0
    drift = second.document["drift"]
    assert drift["changed"] is False  # the same data, found from other starts
    assert drift["comparison"]["version"] == 2
    assert drift["comparison"]["shared"] == pytest.approx(1.0)
    assert drift["point"] == first.document["drift"]["point"]
    assert "drift" not in second.reason


@pytest.mark.parametrize("ladder", ["suggest", "observe"])
async def test_below_apply_a_candidate_waits_for_an_engineer(shop: Shop, ladder: str) -> None:
    shop.assets[ASSET].settings = asset_section(identification={"ladder": ladder})
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    job = await shop.ended(jobs, shown.id)
    assert (job.status, job.model_version) == ("succeeded", 2)
    version = shop.store.models.version(ASSET, 2)
    assert version is not None
    assert version.status == "candidate"
    assert shop.active() == (1, 1)
    await jobs.activate(ASSET, 2, "engineer x", None, force=False)
    assert shop.active() == (2, 2)


async def test_without_a_window_there_is_no_job(shop: Shop) -> None:
    jobs = await shop.open()
    with pytest.raises(RequestRefusedError, match="no low-risk window") as refusal:
        await jobs.create("bench-2", QUICK, None, "x")
    assert refusal.value.pointer == "/windows"
    assert shop.store.jobs.of_asset("bench-2") == []


async def test_given_windows_are_judged_one_by_one(shop: Shop) -> None:
    jobs = await shop.open()
    with pytest.raises(RequestRefusedError, match="less than 30 min") as refusal:
        await jobs.create(ASSET, windows(shop, (0, 60), (60, 70)), None, "x")
    assert refusal.value.pointer == "/windows/1"
    with pytest.raises(RequestRefusedError, match="overlaps"):
        await jobs.create(ASSET, windows(shop, (50, 100), (0, 60)), None, "x")


async def test_windows_are_identified_from_in_the_order_of_time(shop: Shop) -> None:
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, windows(shop, (95, 140), (0, 95)), None, "x")
    job = await shop.ended(jobs, shown.id)
    assert job.status == "succeeded", job.error
    version = shop.store.models.version(ASSET, job.model_version or 0)
    assert version is not None
    starts = [window["start"] for window in version.document["windows"]]
    assert starts == sorted(starts)
    assert [w["speed_rpm_max"] for w in version.document["windows"]] == [
        pytest.approx(2400, abs=1),
        pytest.approx(4200, abs=1),
    ]


async def test_one_job_at_a_time_per_asset(shop: Shop) -> None:
    jobs = await shop.open(HeldExecutor())
    first, _ = await jobs.create(ASSET, QUICK, "key", "x")
    with pytest.raises(JobConflictError) as conflict:
        await jobs.create(ASSET, QUICK, None, "x")
    assert conflict.value.job.id == first.id
    again, created = await jobs.create(ASSET, QUICK, "key", "x")
    assert (again.id, created) == (first.id, False)
    with pytest.raises(KeyUsedBeforeError, match=first.id):
        await jobs.create(ASSET, QUICK.model_copy(update={"seed": 1}), "key", "x")
    assert await jobs.job("bench-2", first.id) is None
    assert [one.id for one in await jobs.jobs(ASSET)] == [first.id]


async def test_a_job_that_cannot_be_done_fails_with_the_reason(shop: Shop) -> None:
    gone = {"windows": [{"start": "", "end": ""}], "windows_us": [[60_000_000, 240_000_000]]}
    job, _ = shop.store.jobs.add(ASSET, gone | WHO, shop.clock.us)
    jobs = await shop.open()
    ended = await shop.ended(jobs, job.id)
    assert ended.status == "failed"
    assert (ended.error or "").startswith("ValueError: no data from 1970")
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    assert (await shop.ended(jobs, shown.id)).status == "succeeded", "the next one may"


@pytest.mark.parametrize("table", ["jobs", "model_versions"])
async def test_a_job_waits_for_a_store_that_is_away(
    shop: Shop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str
) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await wait_for(held.computed.wait(), 120)
    monkeypatch.setattr("service.jobs.runner.STORE_RETRY_WALL_S", 0.1)
    with away(tmp_path, table), capture_logs() as logs:
        held.let_go.set()
        await until(lambda: len([one for one in logs if "waits_for_the_store" in one["event"]]) > 2)
        assert jobs.busy(ASSET)
    job = await shop.ended(jobs, shown.id)
    assert job.status == "succeeded"
    assert shop.active() == (2, 2)


async def test_stopping_without_a_store_is_no_error(shop: Shop, tmp_path: Path) -> None:
    jobs = await shop.open(HeldExecutor())
    await jobs.create(ASSET, QUICK, None, "x")
    with away(tmp_path, "jobs"):
        await wait_for(jobs.stop(), 60)
