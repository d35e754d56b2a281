"""Identification jobs, from their rows to the live twin."""

import asyncio
import json
import sqlite3
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from service.alarms import AlarmBook
from service.api.context import (
    ActivationRefusedError,
    IdentificationRequest,
    JobConflictError,
    KeyUsedBeforeError,
    RequestRefusedError,
    TimeWindow,
)
from service.clock import rfc3339
from service.jobs.automatic import identify_by_itself
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.models import active_model, first_model
from service.jobs.worker import JobOrder, JobResult
from service.live.asset import AssetRuntime
from service.live.bus import Bus
from service.store import Job, JournalFilter, Outbox, Store
from service.store.opening import FILE_NAME

ASSET = "bench-1"
MINUTE_US = 60_000_000
QUICK = IdentificationRequest(method="refine")


class HeldExecutor(Executor):
    """Computes in a thread, but holds every result back until the test lets it go."""

    def __init__(self) -> None:
        self.let_go = asyncio.Event()
        self.orders: list[JobOrder] = []
        self.computed = asyncio.Event()
        self._threads = ThreadPoolExecutor(1)
        self._loop = asyncio.get_running_loop()

    def submit(  # type: ignore[override]
        self, function: Callable[[JobOrder], JobResult], order: JobOrder
    ) -> "Future[JobResult]":
        held: Future[JobResult] = Future()

        def hold(inner: "Future[JobResult]") -> None:
            self._loop.call_soon_threadsafe(self.computed.set)
            asyncio.run_coroutine_threadsafe(release(inner), self._loop)

        async def release(inner: "Future[JobResult]") -> None:
            await self.let_go.wait()
            held.set_result(inner.result())

        self.orders.append(order)
        self._threads.submit(function, order).add_done_callback(hold)
        return held

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait, cancel_futures=cancel_futures)


@dataclass
class Shop:
    """A job manager on a real store with two assets, and what it told."""

    store: Store
    outbox: Outbox
    clock: Any
    folder: Path
    assets: dict[str, AssetRuntime]
    histories: dict[str, AssetHistory]
    bus: Bus
    alarms: AlarmBook
    seconds: list[float] = field(default_factory=list)
    managers: list[IdentificationJobs] = field(default_factory=list)

    async def open(self, executor: Executor | None = None) -> IdentificationJobs:
        """Start a manager, as a start of the service would."""
        jobs = IdentificationJobs(
            self.store,
            self.outbox,
            self.clock,
            self.bus,
            self.assets,
            self.histories,
            lambda: executor or ThreadPoolExecutor(1),
            self.folder,
            self.seconds.append,
        )
        self.managers.append(jobs)
        await jobs.start()
        return jobs

    def row(self, job_id: str) -> Job:
        job = self.store.job(job_id)
        assert job is not None
        return job

    async def ended(self, jobs: IdentificationJobs, job_id: str) -> Job:
        await until(lambda: self.row(job_id).ended_at_us, 60)
        job = self.row(job_id)
        await until(lambda: not jobs.busy(job.asset), 10)
        return job

    def active(self) -> tuple[int, int]:
        """Active version in the store and in the live twin."""
        stored = self.store.active_model(ASSET)
        assert stored is not None
        return stored.version, self.assets[ASSET].active.version


@pytest.fixture
async def shop(
    run_store: Store, clock: Any, make_section: Callable[..., Any], tmp_path: Path
) -> AsyncIterator[Shop]:
    bus = Bus(clock)
    outbox = Outbox.open(tmp_path, run_store)
    alarms = AlarmBook(outbox, clock, lambda _: None)
    assets, histories = {}, {}
    with ThreadPoolExecutor(1) as executor:
        for asset_id in (ASSET, "bench-2"):
            settings = make_section(id=asset_id)
            number = run_store.add_model_version(
                asset_id, "candidate", "", first_model(settings), 1
            )
            first = run_store.activate(asset_id, number, "service", "first", 1)

            async def nothing(*_: Any) -> list[Any]:
                return []

            assets[asset_id] = AssetRuntime(
                settings,
                {},
                active_model(settings, first),
                clock=clock,
                bus=bus,
                alarms=alarms,
                executor=executor,
                store_samples=lambda _: None,
                save_state=nothing,  # type: ignore[arg-type]
                windows=nothing,
            )
            histories[asset_id] = AssetHistory(settings, run_store, clock)
        shop = Shop(run_store, outbox, clock, tmp_path / "jobs", assets, histories, bus, alarms)
        yield shop
        for jobs in shop.managers:
            await jobs.stop()
    outbox.close()


@contextmanager
def away(store_folder: Path, table: str) -> Iterator[None]:
    """The store cannot serve a table for a while."""
    with closing(sqlite3.connect(store_folder / FILE_NAME)) as connection:
        connection.execute(f"ALTER TABLE {table} RENAME TO {table}_away")
        yield
        connection.execute(f"ALTER TABLE {table}_away RENAME TO {table}")


async def until(look: Callable[[], Any], timeout_s: float = 30.0) -> None:
    async with asyncio.timeout(timeout_s):
        while True:
            if look():
                return
            await asyncio.sleep(0.01)


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


# ---------------------------------------------------------------------- from request to twin
async def test_a_job_ends_with_a_version_that_the_twin_runs_on(shop: Shop) -> None:
    jobs = await shop.open()
    subscription = shop.bus.subscribe()
    shown, created = await jobs.create(ASSET, QUICK, None, "engineer x")
    assert created
    assert (shown["status"], shown["requested_by"]) == ("queued", "engineer x")
    assert jobs.busy(ASSET)
    job = await shop.ended(jobs, shown["id"])
    assert (job.status, job.progress, job.model_version, job.attempts) == ("succeeded", 1.0, 2, 1)
    assert job.evaluations > 0
    assert job.best_fitness is not None
    assert shop.active() == (2, 2)
    version = shop.store.model_version(ASSET, 2)
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
    evaluations, fitness = zip(*whole["convergence"], strict=True)
    assert list(evaluations) == sorted(evaluations)
    assert list(fitness) == sorted(fitness, reverse=True)
    assert fitness[-1] == pytest.approx(job.best_fitness)
    # The priors, which are active, cannot meet the data as well as what was fitted to them.
    assert whole["active_fitness"] > 2 * fitness[-1]
    assert (whole["phase"], whole["seconds_left"]) == (None, None), "it has ended"
    after_restart = await (await shop.open()).job(ASSET, job.id)
    assert after_restart is not None
    assert after_restart["active_fitness"] == pytest.approx(whole["active_fitness"])
    assert after_restart["convergence"][-1] == whole["convergence"][-1]
    # Who sees the end of the job sees its version at work.
    assert shop.store.activations(ASSET)[-1].who == "automatic"
    assert shop.outbox.flush(10)
    (line,) = shop.store.audit().items
    assert (line.who, line.action) == ("automatic", "model.activate")
    assert line.target == f"asset {ASSET}, version 2"


async def test_a_second_version_is_compared_with_the_first(shop: Shop) -> None:
    jobs = await shop.open()
    for number, seed in ((2, 0), (3, 1)):
        request = IdentificationRequest(method="refine", seed=seed)
        shown, _ = await jobs.create(ASSET, request, None, "x")
        job = await shop.ended(jobs, shown["id"])
        assert job.model_version == number
    first, second = (shop.store.model_version(ASSET, number) for number in (2, 3))
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
async def test_below_apply_a_candidate_waits_for_an_engineer(
    shop: Shop, make_section: Callable[..., Any], ladder: str
) -> None:
    shop.assets[ASSET].settings = make_section(identification={"ladder": ladder})
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    job = await shop.ended(jobs, shown["id"])
    assert (job.status, job.model_version) == ("succeeded", 2)
    version = shop.store.model_version(ASSET, 2)
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
    assert shop.store.jobs("bench-2") == []


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
    job = await shop.ended(jobs, shown["id"])
    assert job.status == "succeeded", job.error
    version = shop.store.model_version(ASSET, job.model_version or 0)
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
    assert conflict.value.job["id"] == first["id"]
    again, created = await jobs.create(ASSET, QUICK, "key", "x")
    assert (again["id"], created) == (first["id"], False)
    with pytest.raises(KeyUsedBeforeError, match=first["id"]):
        await jobs.create(ASSET, QUICK.model_copy(update={"seed": 1}), "key", "x")
    assert await jobs.job("bench-2", first["id"]) is None
    assert [one["id"] for one in await jobs.jobs(ASSET)] == [first["id"]]


# ---------------------------------------------------------------------- cancelling
async def test_a_cancelled_worker_stops_early(shop: Shop) -> None:
    jobs = await shop.open()
    endless = IdentificationRequest(method="noa", budget=5_000_000)
    shown, _ = await jobs.create(ASSET, endless, None, "x")
    await until(lambda: shop.row(shown["id"]).progress > 0.0)
    cancelled = await jobs.cancel(ASSET, shown["id"])
    assert cancelled is not None
    assert cancelled["status"] == "cancelled"
    await until(lambda: not jobs.busy(ASSET), 2)
    assert len(shop.store.model_versions(ASSET)) == 1
    assert not (shop.folder / shown["id"]).exists()


async def test_cancelled_while_its_data_are_read_the_worker_never_begins_in_earnest(
    shop: Shop,
) -> None:
    jobs = await shop.open()
    shown, _ = await jobs.create(
        ASSET, IdentificationRequest(method="noa", budget=5_000_000), None, "x"
    )
    async with asyncio.timeout(10):
        for _ in iter(lambda: shop.row(shown["id"]).status, "running"):
            await asyncio.sleep(0)
    await jobs.cancel(ASSET, shown["id"])
    await until(lambda: not jobs.busy(ASSET), 10)
    assert shop.row(shown["id"]).status == "cancelled"


async def test_a_job_cancelled_at_the_very_end_takes_no_effect(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await asyncio.wait_for(held.computed.wait(), 60)
    await jobs.cancel(ASSET, shown["id"])
    held.let_go.set()
    job = await shop.ended(jobs, shown["id"])
    assert job.status == "cancelled"
    assert len(shop.store.model_versions(ASSET)) == 1
    assert shop.active() == (1, 1)


async def test_whoever_cancels_while_the_result_takes_effect_is_told_that_it_did(
    shop: Shop,
) -> None:
    """Whatever the moment: either it is cancelled and there is no version, or there is one."""
    for steps in (0, 4, 8, 16):
        held = HeldExecutor()
        jobs = await shop.open(held)
        before = len(shop.store.model_versions(ASSET))
        shown, _ = await jobs.create(ASSET, QUICK, None, "x")
        await asyncio.wait_for(held.computed.wait(), 60)
        held.let_go.set()
        for _ in range(steps):
            await asyncio.sleep(0.001)
        answer = await jobs.cancel(ASSET, shown["id"])
        assert answer is not None
        job = await shop.ended(jobs, shown["id"])
        assert answer["status"] == job.status
        added = len(shop.store.model_versions(ASSET)) - before
        assert added == (1 if job.status == "succeeded" else 0)
        assert shop.active()[0] == shop.active()[1]
        await jobs.stop()


async def test_a_queued_job_that_is_cancelled_never_runs(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    await jobs.create(ASSET, QUICK, None, "x")
    job, _ = shop.store.add_job("bench-2", {"windows": [], "windows_us": []} | WHO, 1)
    jobs._begin(job)  # the API would refuse it: this asset has no data
    await asyncio.wait_for(held.computed.wait(), 60)
    answer = await jobs.cancel("bench-2", job.id)
    assert answer is not None
    assert answer["status"] == "cancelled"
    held.let_go.set()
    await shop.ended(jobs, job.id)
    assert len(held.orders) == 1


async def test_a_job_that_has_ended_cannot_be_cancelled(shop: Shop) -> None:
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await shop.ended(jobs, shown["id"])
    answer = await jobs.cancel(ASSET, shown["id"])
    assert answer is not None
    assert answer["status"] == "succeeded"
    assert await jobs.cancel("bench-2", shown["id"]) is None
    assert await jobs.cancel(ASSET, "no such job") is None


# ---------------------------------------------------------------------- across restarts
WHO = {"method": "refine", "seed": 0, "budget": None, "who": "x"}


async def test_a_stopped_service_takes_its_job_up_again(shop: Shop) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await asyncio.wait_for(held.computed.wait(), 60)
    await jobs.stop()
    waiting = shop.row(shown["id"])
    assert (waiting.status, waiting.attempts) == ("queued", 0)
    again = await shop.open()
    job = await shop.ended(again, shown["id"])
    assert (job.status, job.model_version) == ("succeeded", 2)
    assert len(shop.store.model_versions(ASSET)) == 2


@pytest.mark.parametrize("activated", [False, True])
async def test_a_version_that_was_stored_before_a_crash_is_not_made_twice(
    shop: Shop, activated: bool
) -> None:
    """Killed between storing the version and ending the job."""
    jobs = await shop.open()
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    done = await shop.ended(jobs, shown["id"])
    version = shop.store.model_version(ASSET, 2)
    assert version is not None
    job, _ = shop.store.add_job(ASSET, done.request, shop.clock.us)
    shop.store.update_job(job.id, status="running", attempts=1)
    number = shop.store.add_model_version(
        ASSET, "candidate", "passed", version.document | {"job": job.id}, shop.clock.us
    )
    if activated:
        shop.store.activate(ASSET, number, "automatic", "passed", shop.clock.us)
    again = await shop.open()
    taken_up = await shop.ended(again, job.id)
    assert (taken_up.status, taken_up.model_version) == ("succeeded", 3)
    assert len(shop.store.model_versions(ASSET)) == 3
    assert [one.version for one in shop.store.activations(ASSET)] == [1, 2, 3]


async def test_a_job_that_kills_every_time_is_given_up(shop: Shop) -> None:
    request = {"windows": [], "windows_us": []} | WHO
    job, _ = shop.store.add_job(ASSET, request, shop.clock.us)
    shop.store.update_job(job.id, status="running", attempts=3)
    jobs = await shop.open()
    ended = await shop.ended(jobs, job.id)
    assert (ended.status, ended.error) == ("failed", "gave up after 3 attempts")


async def test_a_job_of_an_asset_that_is_no_longer_configured_is_left_alone(shop: Shop) -> None:
    job, _ = shop.store.add_job("gone", {"windows": [], "windows_us": []} | WHO, 1)
    await shop.open()
    left = shop.row(job.id)
    assert left.status == "queued"


async def test_a_start_clears_away_what_a_crash_left(shop: Shop) -> None:
    (shop.folder / "some job").mkdir(parents=True)
    await shop.open()
    assert not shop.folder.exists()


# ---------------------------------------------------------------------- what goes wrong
async def test_a_job_that_cannot_be_done_fails_with_the_reason(shop: Shop) -> None:
    gone = {"windows": [{"start": "", "end": ""}], "windows_us": [[60_000_000, 240_000_000]]}
    job, _ = shop.store.add_job(ASSET, gone | WHO, shop.clock.us)
    jobs = await shop.open()
    ended = await shop.ended(jobs, job.id)
    assert ended.status == "failed"
    assert (ended.error or "").startswith("ValueError: no data from 1970")
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    assert (await shop.ended(jobs, shown["id"])).status == "succeeded", "the next one may"


@pytest.mark.parametrize("table", ["jobs", "model_versions"])
async def test_a_job_waits_for_a_store_that_is_away(shop: Shop, tmp_path: Path, table: str) -> None:
    held = HeldExecutor()
    jobs = await shop.open(held)
    shown, _ = await jobs.create(ASSET, QUICK, None, "x")
    await asyncio.wait_for(held.computed.wait(), 60)
    with away(tmp_path, table):
        held.let_go.set()
        await asyncio.sleep(0.5)
        assert jobs.busy(ASSET)
    job = await shop.ended(jobs, shown["id"])
    assert job.status == "succeeded"
    assert shop.active() == (2, 2)


async def test_stopping_without_a_store_is_no_error(shop: Shop, tmp_path: Path) -> None:
    jobs = await shop.open(HeldExecutor())
    await jobs.create(ASSET, QUICK, None, "x")
    with away(tmp_path, "jobs"):
        await asyncio.wait_for(jobs.stop(), 10)


# ---------------------------------------------------------------------- activation
async def test_a_rejected_version_is_activated_only_by_force_with_a_comment(shop: Shop) -> None:
    jobs = await shop.open()
    document = first_model(shop.assets[ASSET].settings)
    shop.store.add_model_version(ASSET, "rejected", "worse than the active one", document, 2)
    for comment, force in ((None, False), ("try it", False), (None, True)):
        with pytest.raises(ActivationRefusedError, match="worse than the active one"):
            await jobs.activate(ASSET, 2, "engineer x", comment, force)
    assert shop.active() == (1, 1)
    shown = await jobs.activate(ASSET, 2, "engineer x", "try it", force=True)
    assert (shown["version"], shown["status"]) == (2, "active")
    assert shop.active() == (2, 2)
    await jobs.activate(ASSET, 1, "engineer x", "back again", force=False)
    assert shop.active() == (1, 1)
    entry = shop.store.activations(ASSET)[-1]
    assert (entry.version, entry.who, entry.comment) == (1, "engineer x", "back again")
    assert shop.outbox.flush(10)
    assert [
        (line.kind, line.who, line.comment)
        for line in shop.store.alarm_journal(JournalFilter(events=True)).items
    ] == [
        ("model rolled back", "engineer x", "back again"),
        ("model activated", "engineer x", "try it"),
    ]


async def test_an_unknown_version_is_not_activated(shop: Shop) -> None:
    jobs = await shop.open()
    with pytest.raises(KeyError):
        await jobs.activate(ASSET, 7, "x", None, force=False)


async def test_a_version_of_another_bearing_is_not_activated(
    shop: Shop, make_section: Callable[..., Any]
) -> None:
    """The configuration may have been changed since it was identified."""
    jobs = await shop.open()
    foreign = first_model(make_section(bearing="6016"))
    shop.store.add_model_version(ASSET, "candidate", "", foreign, 2)
    with pytest.raises(ActivationRefusedError, match=r"6016.*6311"):
        await jobs.activate(ASSET, 2, "x", "force", force=True)
    assert shop.active() == (1, 1)


async def test_two_activations_at_a_time_leave_store_and_twin_alike(shop: Shop) -> None:
    jobs = await shop.open()
    document = first_model(shop.assets[ASSET].settings)
    shop.store.add_model_version(ASSET, "candidate", "", document, 2)
    for _ in range(20):
        await asyncio.gather(
            *(jobs.activate(ASSET, version, "x", None, force=False) for version in (1, 2, 1, 2))
        )
        assert shop.active()[0] == shop.active()[1]


# ---------------------------------------------------------------------- by itself
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
        await until(lambda: shop.store.jobs(ASSET), 10)
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
