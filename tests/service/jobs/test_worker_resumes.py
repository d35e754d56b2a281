"""A worker that is killed leaves a checkpoint, and the next one goes on from there."""

import asyncio
import json
import multiprocessing
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from patience import patience

from service.jobs.history import AssetHistory
from service.jobs.worker import JobOrder, JobResult, run_identification
from service.jobs.workspace import JobFolder
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from service.store import Store
from twin_core.bearings import bearing
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model

from .conftest import START_US, asset_section

pytestmark = pytest.mark.wires

BUDGET = 32_000
"""Evaluations of NOA alone: some seconds."""


@pytest.fixture
def order(run_store: Store, clock: Any, tmp_path: Path) -> JobOrder:
    section = asset_section(id="bench-1")
    history = AssetHistory(section, run_store, clock)
    data = asyncio.run(history.identification_data([(START_US, START_US + 4_000_000_000)]))
    folder = JobFolder(tmp_path / "jobs" / "one")
    folder.make()
    return JobOrder(
        folder=folder,
        machine=Machine("default", named_bearing("6311", {}), None),
        data=data,
        active=prior_posterior(build_model("default", bearing=bearing("6311"))),
        method="noa",
        seed=1,
        budget=BUDGET,
    )


def in_folder(order: JobOrder, name: str) -> JobOrder:
    folder = JobFolder(order.folder.path.parent / name)
    folder.make()
    return replace(order, folder=folder)


def found_by(order: JobOrder) -> JobResult:
    result = run_identification(order)
    assert result is not None
    return result


def assert_same(one: JobResult, other: JobResult) -> None:
    assert one.posterior.to_dict() == other.posterior.to_dict()
    assert (one.best_fitness, one.evaluations) == (other.best_fitness, other.evaluations)
    assert one.gates == other.gates


def test_a_killed_worker_is_followed_by_one_that_goes_on_and_ends_the_same(order: JobOrder) -> None:
    worker = multiprocessing.get_context("spawn").Process(target=run_identification, args=(order,))
    worker.start()
    try:
        deadline = time.monotonic() + patience(120.0)
        while order.folder.read_checkpoint() is None:
            assert worker.is_alive(), "the worker ended before its first checkpoint"
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
        worker.join()
    checkpoint = order.folder.read_checkpoint()
    assert checkpoint is not None
    assert 0 < checkpoint["search"]["evaluations"] < BUDGET
    order.folder.make()
    assert_same(found_by(order), found_by(in_folder(order, "uninterrupted")))


def test_the_checkpoint_is_what_the_next_worker_begins_with(order: JobOrder) -> None:
    """A search that is already over is not repeated: what it counted is carried on."""
    short = replace(order, budget=200)
    whole = found_by(short)
    again = in_folder(short, "again")
    moved = _checkpoint_of(short)
    moved["evaluations"] += 1_000_000
    again.folder.write_checkpoint(moved)
    assert found_by(again).evaluations == whole.evaluations + 1_000_000


@pytest.mark.parametrize("change", [{"seed": 2}, {"budget": 201}])
def test_a_checkpoint_of_another_order_is_left_aside(
    order: JobOrder, change: dict[str, int]
) -> None:
    short = replace(order, budget=200)
    checkpoint = json.loads(json.dumps(_checkpoint_of(short)))
    other = replace(in_folder(short, "other"), **change)  # type: ignore[arg-type]
    fresh = found_by(other)
    other.folder.write_checkpoint(checkpoint)
    assert_same(found_by(other), fresh)


def _checkpoint_of(order: JobOrder) -> dict[str, Any]:
    """The last checkpoint of an order's identification."""
    kept: list[dict[str, Any]] = []
    identify(
        order.machine.build(),
        order.data,
        FitSettings(method=order.method, budget=order.budget or 0, seed=order.seed, samples=0),
        save=lambda state: kept.append(state()),
    )
    return kept[-1]
