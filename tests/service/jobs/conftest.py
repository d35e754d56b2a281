"""A store with two hours of a real run in it: simulated, sampled, with sensor noise."""

import shutil
from collections.abc import AsyncIterator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from job_shop import ASSET, Shop
from jumping import jumping_in, seen_threads
from site_files import asset_section

from adapters.samples import Quality, Sample
from service.alarms import AlarmBook
from service.bus.stream import LiveMessages
from service.jobs.history import AssetHistory
from service.jobs.models import active_model, first_model
from service.kernels import compile_kernels
from service.live.asset import AssetRuntime
from service.site.asset_section import AssetSection
from service.store import Outbox, Store
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile, simulate

__all__ = ["seen_threads"]

pytest_asyncio_loop_factories = jumping_in("test_automatic.py")

MINUTE_US = 60_000_000
START_US = 29_395_000 * MINUTE_US
EVERY_S = 10.0
AMBIENT_C = 23.0
LOAD_N = 2650.0
# Minutes at each speed, one after the other.
RUN = ((0.0, 5), (1500.0, 45), (2400.0, 45), (4200.0, 45))
RUN_MINUTES = sum(minutes for _, minutes in RUN)


class HandClock:
    """Process time that a test sets by hand."""

    rate = 60.0

    def __init__(self, us: int) -> None:
        self.us = us

    def now_us(self) -> int:
        return self.us

    async def sleep(self, process_seconds: float) -> None:
        self.us += round(process_seconds * 1e6)


def good(channel: str, time_us: int, value: float, quality: int = Quality.GOOD) -> Sample:
    return Sample(ASSET, channel, time_us, value, quality, time_us)


def run_samples() -> list[Sample]:
    """What the sensors of a machine, not quite the priors', read during the run."""
    model = build_model("default", bearing=bearing("6311"))
    z = prior_posterior(model).z
    z = z + np.random.default_rng(5).normal(0.0, 0.5, z.size)
    speeds = np.concatenate([np.full(int(m * 60 / EVERY_S), speed) for speed, m in RUN])
    time_s = EVERY_S * np.arange(speeds.size)
    full = np.ones(speeds.size)
    machine = simulate(
        model,
        model.parameters.values_from_z(z),
        OperatingProfile(time_s, speeds, LOAD_N * full, AMBIENT_C * full),
        np.full(13, AMBIENT_C),
    )
    columns = {"speed_rpm": speeds, "load_n": LOAD_N * full, "ambient_c": AMBIENT_C * full} | {
        name: machine.temperatures_c @ model.sensor_row(name) for name in model.sensor_names
    }
    rng = np.random.default_rng(1)
    samples = []
    for channel, values in columns.items():
        noise = rng.normal(0.0, 0.05, values.size) if channel.startswith("t_") else 0.0 * values
        for time, value in zip(time_s.tolist(), (values + noise).tolist(), strict=True):
            samples.append(good(channel, START_US + round(time * 1e6), value))
    return samples


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    """The first computation of all takes a minute, on a slow machine many: no test waits for it."""
    compile_kernels()


@pytest.fixture(scope="session")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    with Store.open("", folder) as store:
        store.samples.write(run_samples())
    return folder / "bearing-twin.db"


@pytest.fixture
def run_store(run_file: Path, tmp_path: Path) -> Iterator[Store]:
    """A store of one's own with the run."""
    shutil.copy(run_file, tmp_path)
    with Store.open("", tmp_path) as store:
        yield store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store.open("", tmp_path) as store:
        yield store


@pytest.fixture
def clock() -> HandClock:
    """Ten minutes after the run."""
    return HandClock(START_US + (RUN_MINUTES + 10) * MINUTE_US)


@asynccontextmanager
async def opened_shop(
    store: Store, clock: Any, folder: Path, sections: Sequence[AssetSection]
) -> AsyncIterator[Shop]:
    """A shop for these assets, each with its priors as the active version."""
    bus = LiveMessages(clock)
    outbox = Outbox.open(folder, store)
    alarms = AlarmBook(outbox, clock, lambda _: None)
    assets, histories = {}, {}
    with ThreadPoolExecutor(1) as executor:
        for settings in sections:
            number = store.models.add(settings.id, "candidate", "", first_model(settings), 1)
            first = store.models.activate(settings.id, number, "service", "first", 1)

            async def nothing(*_: Any) -> list[Any]:
                return []

            assets[settings.id] = AssetRuntime(
                settings,
                {},
                active_model(settings, first),
                clock=clock,
                bus=bus,
                alarms=alarms,
                executor=executor,
                store_samples=lambda _: None,
                save_state=nothing,  # type: ignore[arg-type]
            )
            histories[settings.id] = AssetHistory(settings, store, clock)
        shop = Shop(store, outbox, clock, folder / "jobs", assets, histories, bus, alarms)
        yield shop
        for jobs in shop.managers:
            await jobs.stop()
    outbox.close()


@pytest.fixture
async def shop(run_store: Store, clock: Any, tmp_path: Path) -> AsyncIterator[Shop]:
    sections = [asset_section(id=asset_id) for asset_id in (ASSET, "bench-2")]
    async with opened_shop(run_store, clock, tmp_path, sections) as shop:
        yield shop
