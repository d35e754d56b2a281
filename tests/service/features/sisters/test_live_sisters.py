"""Machines of a family teach each other while the service runs: random benches, a real store."""

import asyncio
import shutil
from collections.abc import AsyncIterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from job_shop import QUICK, Shop, until
from numpy.testing import assert_array_equal
from site_files import asset_section

from adapters.samples import Quality, Sample
from adapters.virtual_bench.families import random_bench
from bearing_twin_laboratory.studies.bench_runs import RINGS, Stage, run_bench
from service.documents.models import SistersDocument
from service.features.nights.account import ExecutorName
from service.features.nights.batches import MachineOrder, identify_machine, run_batch
from service.features.nights.identification import identify_fleet
from service.features.nights.night import Night
from service.features.sisters.part import Teaching
from service.jobs.automatic import identify_automatically
from service.jobs.comparison import comparable_versions, earlier_versions
from service.jobs.family import relatives_of
from service.jobs.models import machine_of
from service.site.asset_section import AssetSection
from service.store import AuditEntry, Store
from service.store.opening import FILE_NAME
from tests.service.jobs.conftest import MINUTE_US, START_US, HandClock, opened_shop
from twin_core.bearings import bearing
from twin_core.filtering import begin, run_filter
from twin_core.forecasting import Forecast, forecast
from twin_core.identification.posterior import Posterior
from twin_core.identification.problem import first_measurements, profile_of
from twin_core.models import build_model
from twin_core.sisters import learning
from twin_core.windows import MinuteData

pytestmark = pytest.mark.wires

FAMILY = "6016 grease-L front"
TARGET = "axle-0"
SISTERS = [f"axle-{number}" for number in range(1, 6)]
LIGHT_MIN, HEAVY_MIN = 90, 60
PLAN = (
    Stage(5, 0.0, 2650.0),
    Stage(LIGHT_MIN, 5800.0, 2650.0),
    Stage(HEAVY_MIN, 5800.0, 5500.0),
)
HEAVY_FROM = 5 + LIGHT_MIN
NOW_US = START_US + (HEAVY_FROM + HEAVY_MIN + 10) * MINUTE_US


def axle(asset: str, **changes: Any) -> AssetSection:
    low_risk = {"speed_rpm_max": 6000, "load_n_max": 3400}
    return asset_section(asset, **{"bearing": "6016", "low_risk": low_risk} | changes)


def samples(asset: str, seed: int, first: int, end: int) -> list[Sample]:
    """Rows of a bench's run as the sensors give them: each minute one sample of each."""
    rows = run_bench(random_bench(seed, "6016"), PLAN, seed).minutes.take(slice(first, end))
    found = []
    columns = {name: getattr(rows, name) for name in ("speed_rpm", "load_n", "ambient_c")}
    for channel, values in (columns | {name: rows.temperatures_c[name] for name in RINGS}).items():
        late_us = 30_000_000 if channel in columns else 0
        for minute, value in zip(range(first, end), values.tolist(), strict=True):
            at_us = START_US + minute * MINUTE_US + late_us
            found.append(Sample(asset, channel, at_us, value, Quality.GOOD, at_us))
    return found


@pytest.fixture
def clock() -> HandClock:
    return HandClock(NOW_US)


def family() -> list[AssetSection]:
    return [axle(asset, family=FAMILY) for asset in (TARGET, *SISTERS)]


@pytest.fixture(scope="module")
def taught_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five machines that have run light and heavy, one that has run light only; all have taught."""
    folder = tmp_path_factory.mktemp("family")

    async def teach(store: Store) -> None:
        clock = HandClock(NOW_US)
        async with opened_shop(store, clock, folder, family()) as shop:
            teaching = Teaching((await shop.open()), clock)
            for asset in (TARGET, *SISTERS):
                assert await teaching.look(asset)

    with Store.open("", folder) as store:
        for seed, asset in enumerate([TARGET, *SISTERS], start=110):
            end = HEAVY_FROM if asset == TARGET else HEAVY_FROM + HEAVY_MIN
            store.samples.write(samples(asset, seed, 0, end))
        asyncio.run(teach(store))
    return folder / FILE_NAME


@pytest.fixture
async def axles(taught_file: Path, clock: HandClock, tmp_path: Path) -> AsyncIterator[Shop]:
    shutil.copy(taught_file, tmp_path)
    with Store.open("", tmp_path) as store:
        async with opened_shop(store, clock, tmp_path, family()) as shop:
            yield shop


def heavy_forecast(posterior: Posterior, seed: int) -> tuple[Forecast, MinuteData]:
    """What a model says at the end of the light load, and what the machine did then."""
    rows = run_bench(random_bench(seed, "6016"), PLAN, seed).minutes
    model = build_model("default", bearing=bearing("6016"))
    profile = profile_of(rows)
    observer = begin(
        model,
        model.parameters.values_from_z(posterior.z),
        first_measurements(rows),
        profile.point(0),
        True,
    )
    now = HEAVY_FROM - 1
    run_filter(observer, profile.rows(slice(now + 1)), [rows.readings(k) for k in range(now + 1)])
    ahead = profile.rows(slice(now, profile.size))
    state = replace(
        observer.state(profile.point(now).ambient_c), operating_point=profile.point(now)
    )
    return forecast(model, posterior, state, ahead), rows.take(slice(now, rows.size))


async def test_a_machine_learns_of_the_heavy_load_from_sisters_that_have_seen_it(
    axles: Shop,
) -> None:
    jobs = await axles.open()
    # On its own first: its band of the heavy load rests on the literature.
    records = axles.store.sisters.of_family(FAMILY, TARGET)
    for asset in SISTERS:
        axles.store.sisters.remove(asset)
    alone = await axles.ended(jobs, (await jobs.create(TARGET, QUICK, None, "x"))[0].id)
    document = axles.store.models.version(TARGET, alone.model_version or 0)
    assert document is not None
    assert document.document["sisters"] is None
    before = axles.assets[TARGET].active.posterior
    assert await jobs.new_sisters(TARGET) == frozenset()

    for record in records:
        axles.store.sisters.put(record)
    # The service sees by itself that this is worth another identification, and no third one.
    assert {name for name, *_ in await jobs.new_sisters(TARGET)} == set(SISTERS)
    looking = asyncio.ensure_future(identify_automatically(jobs, axles.histories, axles.clock))
    await until(lambda: axles.assets[TARGET].active.version > (alone.model_version or 0), 120)
    looking.cancel()
    assert await jobs.new_sisters(TARGET) == frozenset()
    # Sisters that have been farther since are news again, if they are many.
    for number, record in enumerate(records[:2], start=1):
        axles.store.sisters.put(replace(record, load_n_max=7000.0))
        assert bool(await jobs.new_sisters(TARGET)) is (number == 2)
    version = axles.store.models.active(TARGET)
    assert version is not None
    told = SistersDocument.read(version.document["sisters"])
    assert told is not None
    assert (told.accepted, set(told.names), told.calibrated_runs) == (True, set(SISTERS), 5)
    assert min(told.loads_n) > 5000.0
    # What each parameter would be without them is told, and a drift is one of the machine's data.
    assert set(told.without_them) == set(version.document["parameters"])
    assert not version.document["drift"]["changed"]
    # The next version is compared with the machine's own data, not with what sisters know.
    (earlier,) = [
        one
        for one in earlier_versions(comparable_versions(axles.store, TARGET))
        if one.version == version.version
    ]
    assert_array_equal(earlier.posterior.z, version.document["own"]["z"])

    after = Posterior.from_dict(version.document["posterior"])
    heavy, came = heavy_forecast(after, 110)
    assert "load law from 5 sisters" in heavy.labels
    literature, _ = heavy_forecast(before, 110)
    assert "load law from prior only" in literature.labels
    for ring in RINGS:
        low, _, _, _, high = heavy.quantile(ring)
        wide = np.ptp(literature.quantile(ring)[[0, -1], -1])
        assert high[-1] - low[-1] < 0.7 * wide
        readings = came.temperatures_c[ring]
        assert np.mean((readings >= low) & (readings <= high)) > 0.9


async def test_a_record_is_made_again_when_it_has_something_new_to_tell(
    axles: Shop, clock: HandClock
) -> None:
    jobs = await axles.open()
    first = axles.store.sisters.of([TARGET])[TARGET]
    assert (first.minutes, first.family) == (5 + LIGHT_MIN, FAMILY)
    # What was made before a restart is not made again.
    again = Teaching(jobs, clock)
    assert not await again.look(TARGET)
    # Ten minutes of the heavy load are not enough, forty are: it had never been there.
    for minutes, made in ((10, False), (40, True)):
        end = HEAVY_FROM + minutes
        axles.store.samples.write(samples(TARGET, 110, HEAVY_FROM, end))
        assert await again.look(TARGET) is made
    record = axles.store.sisters.of([TARGET])[TARGET]
    assert record.load_n_max > 5000.0 > first.load_n_max
    assert record.until_us > first.until_us
    # Whoever leaves the family teaches it nothing any more.
    axles.assets[TARGET].settings = axle(TARGET)
    assert not await again.look(TARGET)
    assert axles.store.sisters.of([TARGET]) == {}


async def test_who_is_no_sister_is_left_out_with_the_reason(axles: Shop) -> None:
    jobs = await axles.open()
    other, damaged, copy, elsewhere = SISTERS[:4]
    records = {one.asset: one for one in axles.store.sisters.of_family(FAMILY, TARGET)}
    own = axles.store.sisters.of_family(FAMILY, SISTERS[0])
    (mine,) = [one for one in own if one.asset == TARGET]
    put = axles.store.sisters.put
    put(replace(records[other], machine=dict(machine_of(asset_section()).to_dict())))
    put(replace(records[damaged], document=records[damaged].document | {"rows": [{"x": "y"}]}))
    put(replace(records[copy], document=mine.document))
    put(replace(records[elsewhere], family="another one"))
    job, _ = await jobs.create(TARGET, QUICK, None, "x")
    ended = await axles.ended(jobs, job.id)
    version = axles.store.models.version(TARGET, ended.model_version or 0)
    assert version is not None
    told = SistersDocument.read(version.document["sisters"])
    assert told is not None
    assert told.names == SISTERS[4:]
    assert told.accepted is False
    assert told.reason == "1 of 1 sisters left, expected at least 2"
    assert set(told.set_aside) == {other, damaged, copy}
    assert told.set_aside[other] == "bearing '6311', expected bearing '6016'"
    assert "minute rows are damaged" in told.set_aside[damaged]
    assert "a machine is no sister of itself" in told.set_aside[copy]
    # And the version is the one that the machine's own data give.
    assert Posterior.from_dict(version.document["posterior"]).sisters is None
    assert (version.status, told.without_them) == ("active", {})


async def test_a_worker_that_dies_of_teaching_takes_nothing_with_it(axles: Shop) -> None:
    pools = iter([_Dying(), ThreadPoolExecutor(1)])
    for asset in (TARGET, SISTERS[0]):
        axles.store.sisters.remove(asset)
    jobs = await axles.open(make_executor=lambda: next(pools))
    teaching = Teaching(jobs, axles.clock)
    assert not await teaching.look(TARGET)
    # The same data are not tried again; a job has a new worker.
    assert not await teaching.look(TARGET)
    job, _ = await jobs.create(TARGET, QUICK, None, "x")
    assert (await axles.ended(jobs, job.id)).status == "succeeded"
    assert await teaching.look(SISTERS[0])


class _Dying(ThreadPoolExecutor):
    """Breaks like a pool whose process is killed."""

    def __init__(self) -> None:
        super().__init__(1)

    def submit(self, *_: Any, **__: Any) -> "Future[Any]":  # type: ignore[override]
        broken: Future[Any] = Future()
        broken.set_exception(BrokenProcessPool("killed"))
        return broken


async def test_a_night_learns_from_sisters_and_calibrates_once(axles: Shop) -> None:
    async def night(name: str) -> SistersDocument:
        audit = AuditEntry(1, "night", "", "fleet.identify", "", "")
        shift = Night(name, axles.store, axles.clock, "night", lambda *_: audit)
        found = await identify_fleet(
            shift, [axles.assets[TARGET].settings], Here(), lambda *_: None, {}
        )
        assert found.machines == 1
        version = axles.store.models.active(TARGET)
        assert version is not None
        told = SistersDocument.read(version.document["sisters"])
        assert told is not None
        return told

    first = await night("2026-11-22")
    assert (first.accepted, first.used, first.calibrated_runs) == (True, 5, 5)
    axles.store.samples.write(samples(TARGET, 110, HEAVY_FROM, HEAVY_FROM + 1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "calibration_runs", lambda *_, **__: pytest.fail("made again"))
        active = axles.store.models.active(TARGET)
        assert active is not None
        settings = axles.assets[TARGET].settings
        data = await axles.histories[TARGET].identification_data(
            [(START_US, START_US + HEAVY_FROM * MINUTE_US)]
        )
        order = MachineOrder(
            TARGET,
            machine_of(settings),
            data,
            Posterior.from_dict(active.document["posterior"]),
            [],
            relatives=relatives_of(axles.store, settings),
        )
        again, _ = identify_machine(order)
    assert again.sisters is not None
    assert again.sisters.calibrated_runs == 5


class Here:
    """Computes the batches in this process."""

    name: ExecutorName = "process"
    worker_count = 1
    workers_lost = 0

    async def compute(self, content: bytes) -> bytes:
        return run_batch(content)
