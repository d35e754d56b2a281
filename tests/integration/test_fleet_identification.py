"""A fleet identified in one night, by processes and by a Dask cluster, whoever is killed."""

import contextlib
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trustme
from patience import patience
from processes import free_port, wait_until

from adapters.samples import Quality, Sample
from service.store import ModelVersion, Store
from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile, simulate

pytestmark = [pytest.mark.wires, pytest.mark.endurance]

MACHINES = 12
MINUTE_US = 60_000_000
SITE = """
[jobs]
workers = 2
[fleet]
scheduler_ca = "ca.pem"
scheduler_certificate = "fleet.pem"
scheduler_key = "fleet.key"
[[templates]]
name = "axle"
bearing = "6311"
family = "{family}"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
identification = { ladder = "{ladder}" }
channels.speed_rpm = { source = "push" }
channels.load_n = { source = "push" }
channels.ambient_c = { source = "push" }
channels.t_inner_ring_c = { source = "push" }
channels.t_outer_ring_c = { source = "push" }
"""
# Minutes at each speed: two operating points, so that there is something to predict.
RUN = ((0.0, 5), (1500.0, 40), (3300.0, 40))
EVERY_S = 20.0


def run_of(asset: str, number: int, start_us: int) -> list[Sample]:
    """What the sensors of a machine read that is like no other."""
    model = build_model("default", bearing=bearing("6311"))
    rng = np.random.default_rng(number)
    z = rng.normal(0.0, 0.5, model.parameters.size)
    speeds = np.concatenate([np.full(round(m * 60 / EVERY_S), speed) for speed, m in RUN])
    time_s, full = EVERY_S * np.arange(speeds.size), np.ones(speeds.size)
    found = simulate(
        model,
        model.parameters.values_from_z(z),
        OperatingProfile(time_s, speeds, 2650.0 * full, 23.0 * full),
        np.full(13, 23.0),
    )
    columns = {"speed_rpm": speeds, "load_n": 2650.0 * full, "ambient_c": 23.0 * full}
    for name in model.sensor_names:
        noise = rng.normal(0.0, 0.05, speeds.size)
        columns[name] = found.temperatures_c @ model.sensor_row(name) + noise
    return [
        Sample(asset, channel, start_us + round(at * 1e6), value, Quality.GOOD, start_us)
        for channel, values in columns.items()
        for at, value in zip(time_s.tolist(), values.tolist(), strict=True)
    ]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site with machines that ran until ten minutes ago; one asset has no data."""
    folder = tmp_path_factory.mktemp("fleet")
    minutes = sum(m for _, m in RUN)
    start_us = (round(time.time()) // 60 - minutes - 10) * MINUTE_US
    assets = [
        f'[[assets]]\nid = "axle-{k}"\ntemplate = "axle"\n'
        f'values = {{ family = "{"old" if k < 4 else "new"}", '
        f'ladder = "{"suggest" if k == 0 else "apply"}" }}\n'
        for k in range(MACHINES + 1)
    ]
    (folder / "site.toml").write_text(SITE + "".join(assets))
    with Store.open("", folder / "var") as store:
        for k in range(MACHINES):
            store.samples.write(run_of(f"axle-{k}", k, start_us))
    authority = trustme.CA()
    authority.cert_pem.write_to_path(folder / "ca.pem")
    certificate = authority.issue_cert("127.0.0.1")
    certificate.cert_chain_pems[0].write_to_path(folder / "fleet.pem")
    certificate.private_key_pem.write_to_path(folder / "fleet.key")
    return folder


@pytest.fixture
def site(fleet: Path, tmp_path: Path) -> Path:
    """The same site, of one's own."""
    shutil.copytree(fleet, tmp_path, dirs_exist_ok=True)
    return tmp_path


def command(site: Path, *arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "service", "fleet", "identify", "-c", "site.toml", *arguments],
        cwd=site,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def identify(site: Path, *arguments: str) -> dict[str, Any]:
    process = command(site, "--json", *arguments)
    output, errors = process.communicate(timeout=patience(600))
    assert process.returncode == 0, errors[-3000:]
    document: dict[str, Any] = json.loads(output)
    return document


def versions(site: Path) -> dict[str, list[ModelVersion]]:
    with Store.open("", site / "var") as store:
        return {f"axle-{k}": store.models.versions(f"axle-{k}") for k in range(MACHINES + 1)}


def stored(site: Path) -> int:
    return sum(len(of_one) for of_one in versions(site).values())


def has_begun(site: Path) -> bool:
    """Whether a version is stored; quick, as the night may end while a store is opened."""
    store = f"file:{site / 'var' / 'bearing-twin.db'}?mode=ro"
    with contextlib.closing(sqlite3.connect(store, uri=True)) as connection:
        (count,) = connection.execute("SELECT count(*) FROM model_versions").fetchone()
    return bool(count)


def findings(site: Path) -> dict[str, str]:
    """All that was found of each machine, to the last bit; what names the run is left out."""
    found = {}
    for asset, of_one in versions(site).items():
        if asset == f"axle-{MACHINES}":
            assert of_one == []
            continue
        (version,) = of_one
        found[asset] = json.dumps(version.document | {"job": ""})
    return found


def traces(site: Path) -> list[str]:
    """Everything that a run writes."""
    with Store.open("", site / "var") as store, store._database.reading() as connection:
        return [
            str(connection.exec_driver_sql(f"SELECT * FROM {table}").all())
            for table in ("jobs", "model_versions", "model_activations", "alarm_journal", "audit")
        ]


@pytest.fixture(scope="module")
def undisturbed(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site after a night in which nothing happened."""
    site = tmp_path_factory.mktemp("undisturbed")
    shutil.copytree(fleet, site, dirs_exist_ok=True)
    document = identify(site, "--all")
    assert (document["machines"], document["skipped"], document["failed"]) == (MACHINES, 1, 0)
    return site


def test_each_machine_gets_one_version_as_its_ladder_allows(undisturbed: Path) -> None:
    with Store.open("", undisturbed / "var") as store:
        first, *others = (store.models.versions(f"axle-{k}")[0] for k in range(MACHINES))
        assert first.status in ("candidate", "rejected"), "its ladder is suggest"
        for version in others:
            accepted = version.document["gates"]["accepted"]
            assert version.status == ("active" if accepted else "rejected")
            (job,) = store.jobs.of_asset(version.asset)
            assert (job.status, job.model_version) == ("succeeded", 1)
            assert version.document["job"] == job.id
        assert {one.status for one in others} >= {"active"}
        actions = [line.action for line in store.audit.page().items]
        active = sum(one.status == "active" for one in others)
        assert sorted(actions) == ["fleet.identify", *["model.activate"] * active]


def test_a_second_run_of_the_night_changes_nothing(undisturbed: Path) -> None:
    before = traces(undisturbed)
    document = identify(undisturbed, "--all")
    assert (document["machines"], document["done_before"]) == (0, MACHINES)
    assert identify(undisturbed, "--family", "old")["done_before"] == 4
    assert traces(undisturbed) == before


def test_a_killed_run_goes_on_and_takes_other_workers_for_those_that_die(
    site: Path, undisturbed: Path
) -> None:
    process = command(site, "--all")
    wait_until(lambda: has_begun(site), 300, "the first results", every_s=0.02)
    process.kill()
    process.communicate()
    kept = stored(site)
    assert 0 < kept < MACHINES
    process = command(site, "--all", "--json")
    # A process is only begun for a batch.
    for worker in wait_until(lambda: children(process.pid) or None, 300, "the workers"):
        os.kill(worker, signal.SIGKILL)
    output, errors = process.communicate(timeout=patience(600))
    assert process.returncode == 0, errors[-3000:]
    document = json.loads(output)
    assert document["workers_lost"] >= 1
    assert document["done_before"] >= kept
    assert document["done_before"] + document["machines"] == MACHINES
    assert findings(site) == findings(undisturbed)


def test_a_warm_start_ends_where_the_search_ends(site: Path, undisturbed: Path) -> None:
    shutil.copytree(undisturbed / "var", site / "var", dirs_exist_ok=True)
    with Store.open("", site / "var") as store, store._database.writing() as connection:
        connection.exec_driver_sql("UPDATE jobs SET idempotency_key = 'the night before'")
    document = identify(site, "--family", "new")
    assert document["machines"] == MACHINES - 4
    warm = [one["asset"] for one in document["items"] if one["warm_start"]]
    assert document["warm_starts"] == len(warm) > 0
    for asset in warm:
        before, after = (one.document for one in versions(site)[asset])
        assert after["method"] == "refine"
        # A fit stops where a step gains less than 1e-5 of the cost.
        assert after["convergence"][-1][1] <= before["convergence"][-1][1] * (1 + 1e-4)


def children(parent: int) -> set[int]:
    """Processes that a process has spawned to compute."""
    found = set()
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            above = re.search(r"PPid:\s*(\d+)", (path / "status").read_text())
            computes = "spawn_main" in (path / "cmdline").read_text()
            if computes and above is not None and int(above[1]) == parent:
                found.add(int(path.name))
    return found


# ---------------------------------------------------------------------------------- Dask
@contextlib.contextmanager
def cluster(site: Path) -> Iterator[tuple[str, int, Callable[[], set[int]]]]:
    """A scheduler with two workers over TLS: its address, its process, and those of the workers."""
    port = free_port()
    address = f"tls://127.0.0.1:{port}"
    files = ("--tls-ca-file", "ca.pem", "--tls-cert", "fleet.pem", "--tls-key", "fleet.key")
    environment = os.environ | {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "True"}
    environment.pop("OPENBLAS_NUM_THREADS", None)
    with contextlib.ExitStack() as stack:
        log = site / "cluster.log"
        output = stack.enter_context(log.open("w"))

        def start(*arguments: str) -> int:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, *files],
                cwd=site,
                env=environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
            stack.callback(process.wait)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
            return process.pid

        host = ("--host", "tls://127.0.0.1", "--no-dashboard")
        scheduler = start("scheduler", *host, "--port", str(port))
        nannies = start(
            *("worker", address, *host, "--nworkers", "2", "--nthreads", "1"),
            *("--memory-limit", "0", "--local-directory", str(site)),
        )
        wait_until(lambda: log.read_text().count("Registered to:") == 2, 120, "both workers")
        yield address, scheduler, lambda: children(nannies)


def test_a_cluster_that_loses_a_worker_finds_the_same_bits(site: Path, undisturbed: Path) -> None:
    with cluster(site) as (address, _, workers):
        process = command(site, "--all", "--json", "--scheduler", address)
        wait_until(lambda: has_begun(site), 300, "the first results", every_s=0.02)
        victim = min(workers())
        os.kill(victim, signal.SIGKILL)
        output, errors = process.communicate(timeout=patience(600))
    assert process.returncode == 0, errors[-3000:]
    document = json.loads(output)
    assert (document["executor"], document["workers"]) == ("dask", 2)
    assert document["machines"] == MACHINES
    assert document["workers_lost"] >= 1
    assert findings(site) == findings(undisturbed)


def test_a_cluster_that_loses_its_scheduler_leaves_a_document_all_the_same(site: Path) -> None:
    """A line for each night: what was done until then, and what ended it."""
    with cluster(site) as (address, scheduler, _):
        process = command(site, "--all", "--json", "--scheduler", address)
        wait_until(lambda: has_begun(site), 300, "the first results", every_s=0.02)
        os.kill(scheduler, signal.SIGKILL)
        output, errors = process.communicate(timeout=patience(600))
    assert process.returncode == os.EX_TEMPFAIL, errors[-3000:]
    document = json.loads(output)
    assert "scheduler" in document["ended_by"]
    assert document["machines"] == stored(site) < MACHINES
    # Nothing is there any more: the next call of the night says so, too.
    process = command(site, "--all", "--json", "--scheduler", address)
    output, errors = process.communicate(timeout=patience(600))
    assert process.returncode == os.EX_TEMPFAIL, errors[-3000:]
    document = json.loads(output)
    assert (document["machines"], document["items"]) == (0, [])
    assert "does not answer" in document["ended_by"]
