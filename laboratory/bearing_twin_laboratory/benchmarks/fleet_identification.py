"""Identification of a fleet: store, batches in worker processes, store again."""

import asyncio
import dataclasses
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adapters.samples import Quality, Sample
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from service.clock import MINUTE_US, wall_us
from service.features.nights.account import FleetIdentification
from service.features.nights.batch_executors import ProcessBatches
from service.features.nights.identification import identify_fleet
from service.features.nights.night import Night
from service.site.asset_section import AssetSection
from service.store import AuditEntry, Store
from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile, simulate

MACHINES = 48
#: Two batches for each of two workers, which compile or load their kernels with them.
WARM_UP = 8
WORKERS = 2
#: Minutes at each speed; 4.5 hours of data as in `identify_default_model`.
STAGES = ((0.0, 5), (1500.0, 90), (2400.0, 90), (3300.0, 90))
EVERY_S = 10.0
LOAD_N, AMBIENT_C, NOISE_K = 2650.0, 23.0, 0.05
#: The last part of the data comes between the two nights.
NEW_MINUTES = 60


@dataclasses.dataclass(slots=True)
class _Clock:
    """Stands still: nothing depends on how long a night takes."""

    us: int
    rate: float = 1.0

    def now_us(self) -> int:
        return self.us

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(process_seconds)


def identify_fleet_warm(progress: Progress) -> Measurement:
    """A night of a fleet with a warm start on two workers, beside one without on one worker."""
    with tempfile.TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        return asyncio.run(_measured(store, progress))


async def _measured(store: Store, progress: Progress) -> Measurement:
    clock = _Clock(wall_us() // MINUTE_US * MINUTE_US)
    start_us = clock.us - (sum(minutes for _, minutes in STAGES) + 10) * MINUTE_US
    assets = [_asset(f"machine-{number}") for number in range(MACHINES + WARM_UP)]
    for number, asset in enumerate(assets):
        progress(0.1 * number / len(assets), "machines run")
        store.samples.write(run_of_machine(asset.id, number, start_us))
    first, measured = assets[:WARM_UP], assets[WARM_UP:]
    one, two = ProcessBatches(1), ProcessBatches(WORKERS)

    async def night(
        name: str, chosen: Sequence[AssetSection], executor: ProcessBatches, begun: float
    ) -> FleetIdentification:
        def reported(fraction: float, text: str) -> None:
            progress(begun + 0.25 * fraction, f"night {name}, {text}")

        what = Night(name, store, clock, "benchmark", _no_audit)
        found = await identify_fleet(what, chosen, executor, reported, {})
        if found.machines < len(chosen):
            raise BenchmarkError(f"night {name}: {found.machines} of {len(chosen)} identified")
        return found

    try:
        await night("0", first, one, 0.1)
        clock.us -= NEW_MINUTES * MINUTE_US
        await night("1", measured, one, 0.2)
        clock.us += NEW_MINUTES * MINUTE_US
        await night("2", first, two, 0.4)
        warm = await night("3", measured, two, 0.5)
        searched = _fitness(store, measured)
        _forget(store, measured)
        cold = await night("4", measured, one, 0.75)
    finally:
        one.end()
        two.end()
    excess = [
        ours / theirs - 1.0
        for ours, theirs in zip(searched, _fitness(store, measured), strict=True)
    ]
    busy_s = sum(item.seconds or 0.0 for item in warm.items)
    return Measurement(
        warm.seconds / warm.machines,
        "s",
        cold.seconds / cold.machines,
        "the same machines on one worker, each with a full search",
        {
            "machines": warm.machines,
            "workers": WORKERS,
            "cores": os.cpu_count(),
            "warm_starts": warm.warm_starts,
            "processor_seconds_per_machine": warm.processor_seconds / warm.machines,
            "reference_processor_seconds_per_machine": cold.processor_seconds / cold.machines,
            "workers_busy": busy_s / warm.seconds,
            "largest_excess_of_fitness": max(excess),
        },
    )


def _asset(name: str) -> AssetSection:
    channels = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
    return AssetSection.model_validate(
        {
            "id": name,
            "bearing": "6311",
            "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3400},
            "channels": {channel: {"source": "push"} for channel in channels},
            "identification": {"ladder": "apply"},
        }
    )


def run_of_machine(asset: str, number: int, start_us: int) -> list[Sample]:
    """What the sensors of a machine of the model's family read; each has other parameters."""
    model = build_model("default", bearing=bearing("6311"))
    rng = np.random.default_rng(number)
    z = rng.normal(0.0, 0.5, model.parameters.size)
    speeds = np.concatenate([np.full(round(m * 60 / EVERY_S), speed) for speed, m in STAGES])
    time_s, full = EVERY_S * np.arange(speeds.size), np.ones(speeds.size)
    machine = simulate(
        model,
        model.parameters.values_from_z(z),
        OperatingProfile(time_s.astype(np.float64), speeds, LOAD_N * full, AMBIENT_C * full),
        np.full(len(model.node_names), AMBIENT_C),
    )
    columns = {"speed_rpm": speeds, "load_n": LOAD_N * full, "ambient_c": AMBIENT_C * full}
    for name in model.sensor_names:
        noise = rng.normal(0.0, NOISE_K, speeds.size)
        columns[name] = machine.temperatures_c @ model.sensor_row(name) + noise
    return [
        Sample(asset, channel, start_us + round(at * 1e6), value, Quality.GOOD, start_us)
        for channel, values in columns.items()
        for at, value in zip(time_s.tolist(), values.tolist(), strict=True)
    ]


def _fitness(store: Store, assets: Sequence[AssetSection]) -> list[float]:
    """Sum of squared residuals of the newest version of each asset."""
    newest = (store.models.versions(asset.id)[-1] for asset in assets)
    return [one.document["convergence"][-1][1] for one in newest]


def _forget(store: Store, assets: Sequence[AssetSection]) -> None:
    """Make the priors active again: nothing to start from."""
    from service.jobs.models import first_model

    for asset in assets:
        number = store.models.add(asset.id, "candidate", "priors", first_model(asset), 0)
        store.models.activate(asset.id, number, "benchmark", "priors", 0)


def _no_audit(action: str, target: str, detail: str) -> AuditEntry:
    return AuditEntry(wall_us(), "benchmark", "", action, target, detail)
