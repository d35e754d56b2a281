"""Re-identification on a running site: by itself, by request, through kills and restarts.

One site for the whole file: the bench runs its low-risk stages until the twin has re-identified by
itself; then the bench is switched off, so that no new data start jobs among those of the tests.
"""

import os
import signal
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx2
import pytest
from processes import Site, wait_until

from service.clock import ProcessClock, from_rfc3339
from service.demo.configuration import ASSET
from service.site.settings import load_settings
from service.store import Store

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]

RATE = 100.0
PATIENCE_S = 240.0
ENDLESS = {"method": "noa", "budget": 5_000_000}
LONG = {"budget": 40_000}
LONGEST_GAP_US = 1800 * 1_000_000
QUICK = {"method": "refine"}
MODELS = f"/api/v1/assets/{ASSET}/models"
JOBS = f"/api/v1/assets/{ASSET}/identifications"
WINDOWS = f"/api/v1/assets/{ASSET}/windows"
STATE = f"/api/v1/assets/{ASSET}/state"
WIDE_REGION, NARROW_REGION = "speed_rpm_max = 4300", "speed_rpm_max = 2000"


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site whose twin has identified by itself, on the running bench."""
    with Site(tmp_path_factory.mktemp("site"), "demo", RATE) as site:
        site.start_bench()
        site.start_service()
        wait_until(lambda: site.tag("model.version") > 1, 400, "a re-identification by itself")
        yield site


@pytest.fixture(scope="module")
def quiet(live: Site) -> Site:
    """The same site with the bench switched off and no job under way."""
    assert live.bench is not None
    live.bench.kill()
    wait_until(lambda: jobs_under_way(live) == [], PATIENCE_S, "the last job by itself")
    return live


def jobs(site: Site) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = site.get(JOBS)["items"]
    return found


def jobs_under_way(site: Site) -> list[dict[str, Any]]:
    return [job for job in jobs(site) if job["status"] in ("queued", "running")]


def versions(site: Site) -> dict[int, str]:
    return {model["version"]: model["status"] for model in site.get(MODELS)["items"]}


def post(site: Site, path: str, body: dict[str, Any], **headers: str) -> httpx2.Response:
    return site.client.post(path, json=body, headers=headers)


def configure(site: Site, *changes: tuple[str, str]) -> None:
    """Change the site's configuration file, for its next start."""
    text = site.configuration.read_text()
    for before, after in changes:
        text = text.replace(before, after)
    site.configuration.write_text(text)


def start(site: Site, body: dict[str, Any]) -> str:
    """Ask for a job; on a busy machine the windows that it needs may still be on their way."""

    def accepted() -> httpx2.Response | None:
        answer = post(site, JOBS, body)
        return None if answer.status_code == httpx2.codes.UNPROCESSABLE_CONTENT else answer

    answer = wait_until(accepted, PATIENCE_S, f"low-risk windows for {body}")
    assert answer.status_code == httpx2.codes.ACCEPTED, answer.text
    return str(answer.json()["id"])


def job(site: Site, job_id: str) -> dict[str, Any]:
    found: dict[str, Any] = site.get(f"{JOBS}/{job_id}")
    return found


def ended(site: Site, job_id: str) -> dict[str, Any]:
    return wait_until(
        lambda: (found := job(site, job_id))["ended_at"] and found, PATIENCE_S, f"end of {job_id}"
    )


def node_c(state: dict[str, Any]) -> float:
    return float(state["nodes"]["t_node_7_c"]["mean_c"])


def spread_k(state: dict[str, Any]) -> float:
    return float(state["nodes"]["t_node_7_c"]["std_c"])


def seconds(earlier: dict[str, Any], later: dict[str, Any]) -> float:
    """Process seconds between two states."""
    return (from_rfc3339(later["time"]) - from_rfc3339(earlier["time"])) / 1e6


def running(site: Site, job_id: str) -> dict[str, Any]:
    """Wait until the worker is in the middle of it."""
    return wait_until(
        lambda: (found := job(site, job_id))["progress"] > 0 and found, PATIENCE_S, "progress"
    )


def worker_of(site: Site) -> int:
    """Process id of the service's background worker."""
    assert site.service is not None
    of_service = {site.service.process.pid}

    def busy() -> int | None:
        parents = {}
        for folder in Path("/proc").iterdir():
            if not folder.name.isdigit():
                continue
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                parents[int(folder.name)] = parent, (folder / "cmdline").read_text()
            except OSError:
                continue  # it has ended meanwhile
        while (
            more := {child for child, (parent, _) in parents.items() if parent in of_service}
            - of_service
        ):
            of_service.update(more)
        # The processes of the what-ifs are children, too; nobody asks them anything here.
        workers = (
            process
            for process in of_service & set(parents)
            if "spawn_main" in parents[process][1] and not is_at_rest(process)
        )
        return next(workers, None)

    return wait_until(busy, PATIENCE_S, "a worker that computes")


def is_at_rest(process_id: int) -> bool:
    """Return whether a process uses no processor, over a third of a second."""

    def ticks() -> int:
        fields = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
        return int(fields[11]) + int(fields[12])

    before = ticks()
    time.sleep(0.3)
    return ticks() == before


# ---------------------------------------------------------------------- by itself
@pytest.mark.thorough
def test_it_identifies_by_itself_after_two_low_risk_points(live: Site) -> None:
    by_itself = [one for one in jobs(live) if one["status"] == "succeeded"][-1]
    assert by_itself["requested_by"] == "automatic"
    assert by_itself["progress"] == 1.0
    assert by_itself["model_version"] == 2
    assert by_itself["created_at"] <= by_itself["started_at"] < by_itself["ended_at"]
    model = live.get(f"{MODELS}/2")
    (window,) = model["windows"]
    # A slow machine looks when the bench is at the next point already.
    assert 2330 < window["speed_rpm_max"] <= 4300
    assert window["load_n_max"] < 3400
    shown = live.get(WINDOWS)["items"][0]
    assert shown["start"] == window["start"], "it is the window that is shown"
    assert {round(point["speed_rpm"], -2) for point in shown["operating_points"]} >= {1500, 2400}


@pytest.mark.thorough
def test_a_version_tells_parameters_scores_and_gates(live: Site) -> None:
    model = live.get(f"{MODELS}/2")
    assert model["status"] in ("active", "retired")
    assert len(model["parameters"]) > 15
    for row in model["parameters"].values():
        assert row["low"] < row["value"] < row["high"]
        assert row["verdict"] in ("informed", "weak", "prior only")
        assert "unit" in row
    # Two speeds tell combinations of parameters, hardly one by itself.
    assert {row["verdict"] for row in model["parameters"].values()} & {"informed", "weak"}
    told = model["identifiability"]
    assert told["informed"] >= 2
    assert told["informed"] + told["weak"] + told["prior_only"] == len(model["parameters"])
    assert [one["verdict"] for one in told["combinations"]].count("informed") == told["informed"]
    assert set(model["scores"]["train_rms_k"]) == {"t_inner_ring_c", "t_outer_ring_c"}
    assert max(model["scores"]["train_rms_k"].values()) < 0.5
    assert set(model["naive"]["extrapolation"]) >= {"persistence", "static_linear", "arx"}
    checks = {check["name"]: check for check in model["gates"]["checks"]}
    assert set(checks) >= {"fit", "ranges", "residuals", "extrapolation"}
    assert all(check["passed"] for check in checks.values())
    assert model["gates"]["accepted"] is True
    first = live.get(f"{MODELS}/1")
    assert {row["verdict"] for row in first["parameters"].values()} == {"prior only"}


def minutes_between(one: dict[str, Any], other: dict[str, Any]) -> float:
    return (from_rfc3339(other["time"]) - from_rfc3339(one["time"])) / 60e6


@pytest.mark.thorough
def test_versions_are_activated_and_rolled_back_without_a_gap(live: Site) -> None:
    began = live.tags()["t_node_7_c.twin"]["time"]
    newest = max(versions(live))
    for version in (1, newest, 1, newest):
        before = live.tags()["t_node_7_c.twin"]
        spread_c = spread_k(live.get(STATE))
        answer = post(live, f"{MODELS}/{version}/activate", {"comment": "a test"})
        assert answer.status_code == 200, answer.text
        assert (answer.json()["version"], answer.json()["status"]) == (version, "active")
        tags = live.tags()
        assert tags["model.version"]["value"] == version
        # It goes on from where it was; from then on it follows the other parameters, which may
        # have another opinion of what nobody measures.
        after = tags["t_node_7_c.twin"]
        may_c = spread_c + 2.0 * max(minutes_between(before, after), 1.0)
        assert after["value"] == pytest.approx(before["value"], abs=may_c)
        assert after["quality"] >= 64, "usable: the grease of a hot machine is not known well"
        assert tags["t_inner_ring_c.twin"]["quality"] >= 192
        statuses = versions(live)
        assert [one for one, status in statuses.items() if status == "active"] == [version]
    wait_until(
        lambda: live.get(f"/api/v1/assets/{ASSET}/forecast")["model_version"] == newest,
        PATIENCE_S,
        "a forecast of the active version",
    )

    def stored_since() -> list[dict[str, Any]] | None:
        answer = live.get(
            f"/api/v1/assets/{ASSET}/measurements", channel="t_inner_ring_c.twin", start=began
        )
        rows: list[dict[str, Any]] = answer["items"]
        return rows if len(rows) > 3 else None

    # The twin is stored once a process minute: the four switches may well take less.
    stored = wait_until(stored_since, PATIENCE_S, "stored values of the twin")
    # A cold machine itself warms by a kelvin a minute.
    for before, after in pairwise(stored):
        may_c = 2.0 * max(minutes_between(before, after), 1.0)
        assert abs(after["value"] - before["value"]) < may_c, "the live twin made no jump"


# ---------------------------------------------------------------------- by request
def test_a_job_is_accepted_once_and_seen_at_its_location(quiet: Site) -> None:
    before = len(jobs(quiet))
    answer = post(quiet, JOBS, ENDLESS, **{"Idempotency-Key": "one-shift"})
    assert answer.status_code == 202
    job_id = answer.json()["id"]
    assert answer.headers["location"] == f"{JOBS}/{job_id}"
    assert quiet.get(answer.headers["location"])["status"] in ("queued", "running")
    again = post(quiet, JOBS, ENDLESS, **{"Idempotency-Key": "one-shift"})
    assert (again.status_code, again.json()["id"]) == (202, job_id)
    other = post(quiet, JOBS, ENDLESS)
    assert other.status_code == 409
    assert other.json()["job"]["id"] == job_id
    assert len(jobs(quiet)) == before + 1

    # Progress is visible and rises.
    seen = [running(quiet, job_id)]
    while len(seen) < 4:
        now = wait_until(
            lambda: (found := job(quiet, job_id))["progress"] > seen[-1]["progress"] and found,
            PATIENCE_S,
            "more progress",
        )
        seen.append(now)
    assert all(0.0 < one["progress"] < 1.0 for one in seen)
    assert all(a["evaluations"] < b["evaluations"] for a, b in pairwise(seen))
    assert all(a["best_fitness"] >= b["best_fitness"] for a, b in pairwise(seen))

    # Cancelled it ends at once and takes no effect, and the worker is free for the next job.
    known, active = versions(quiet), quiet.tag("model.version")
    worker = worker_of(quiet)
    deleted = quiet.client.delete(f"{JOBS}/{job_id}")
    assert deleted.status_code == 200
    assert deleted.json()["status"] == "cancelled"
    wait_until(lambda: is_at_rest(worker), PATIENCE_S, "rest of the worker", every_s=0.0)
    next_job = start(quiet, ENDLESS)
    running(quiet, next_job)
    quiet.client.delete(f"{JOBS}/{next_job}")
    for cancelled in (job(quiet, job_id), job(quiet, next_job)):
        assert (cancelled["status"], cancelled["model_version"]) == ("cancelled", None)
    assert versions(quiet) == known
    assert quiet.tag("model.version") == active
    repeated = post(quiet, JOBS, ENDLESS, **{"Idempotency-Key": "one-shift"})
    assert repeated.json()["status"] == "cancelled", "the key stands for that job for good"


def test_given_windows_are_used(quiet: Site) -> None:
    (window, *_) = quiet.get(WINDOWS)["items"]
    given = [{"start": window["start"], "end": window["end"]}]
    done = ended(quiet, start(quiet, QUICK | {"windows": given}))
    assert done["status"] == "succeeded", done["error"]
    used = quiet.get(f"{MODELS}/{done['model_version']}")["windows"]
    assert [{"start": one["start"], "end": one["end"]} for one in used] == given


@pytest.mark.parametrize(
    "window",
    [
        {"start": "2020-01-01T00:00:00Z", "end": "2020-01-01T02:00:00Z"},
        {"start": "2020-01-01T02:00:00Z", "end": "2020-01-01T00:00:00Z"},
    ],
)
def test_windows_that_cannot_be_used_are_refused(quiet: Site, window: dict[str, str]) -> None:
    answer = post(quiet, JOBS, {"windows": [window]})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    (error,) = answer.json()["errors"]
    assert error["pointer"].startswith("/windows/0")


def test_a_rejected_version_needs_force_and_a_comment(quiet: Site) -> None:
    # A search that is over before it has begun finds nothing as good as the active model.
    done = ended(quiet, start(quiet, {"method": "noa", "budget": 100}))
    assert done["status"] == "succeeded"
    version = done["model_version"]
    model = quiet.get(f"{MODELS}/{version}")
    assert model["status"] == "rejected"
    failed = [one["name"] for one in model["gates"]["checks"] if not one["passed"]]
    assert failed
    assert all(name in model["reason"] for name in failed)
    active = quiet.tag("model.version")
    path = f"{MODELS}/{version}/activate"
    for body in ({}, {"comment": "why not"}, {"force": True}):
        refusal = post(quiet, path, body)
        assert refusal.status_code == 409
        assert model["reason"] in refusal.json()["detail"]
    assert quiet.tag("model.version") == active
    assert post(quiet, path, {"force": True, "comment": "to see"}).status_code == 200
    assert quiet.tag("model.version") == version
    assert post(quiet, f"{MODELS}/{active}/activate", {}).status_code == 200
    assert quiet.tag("model.version") == active


# ---------------------------------------------------------------------- kills and restarts
@pytest.mark.endurance
def test_a_killed_worker_costs_only_time(quiet: Site) -> None:
    before = len(versions(quiet))
    job_id = start(quiet, LONG)
    running(quiet, job_id)
    os.kill(worker_of(quiet), signal.SIGKILL)
    wait_until(lambda: job(quiet, job_id)["attempts"] == 2, PATIENCE_S, "the second attempt")
    done = ended(quiet, job_id)
    assert (done["status"], done["attempts"]) == ("succeeded", 2)
    assert len(versions(quiet)) == before + 1
    assert quiet.get("/readyz")["status"] in ("ready", "degraded")


@pytest.mark.endurance
def test_a_stopped_service_goes_on_where_it_was(quiet: Site) -> None:
    """Its job is taken up and ends once, under the rules of the new configuration."""
    before, active = versions(quiet), quiet.tag("model.version")
    job_id = start(quiet, LONG)
    running(quiet, job_id)
    before_it = quiet.get(STATE)
    last = wait_until(
        lambda: (now := quiet.get(STATE)) and seconds(before_it, now) > 60.0 and now,
        PATIENCE_S,
        "a later state",
    )
    looked_s = seconds(before_it, last)
    node_k_per_s = abs(node_c(last) - node_c(before_it)) / looked_s
    spread_k_per_s = abs(spread_k(last) - spread_k(before_it)) / looked_s
    assert quiet.service is not None
    assert quiet.service.terminate() == 0, quiet.service.log.read_text()[-2000:]
    with quiet.open_store() as store:
        waiting = store.jobs.get(job_id)
        assert waiting is not None
        assert waiting.status == "queued"

    configure(quiet, ('ladder = "apply"', 'ladder = "suggest"'), (WIDE_REGION, NARROW_REGION))
    quiet.start_service()
    assert quiet.tag("model.version") == active
    now_us = ProcessClock.resume(RATE, load_settings(quiet.configuration).data_dir).now_us()
    # After half an hour away, a third of a minute of the wall clock, the twin begins anew; that it
    # cannot here, as no temperature comes.
    if now_us - from_rfc3339(last["time"]) < LONGEST_GAP_US:
        wait_until(lambda: quiet.tag("t_node_7_c.twin"), PATIENCE_S, "the twin's estimate")
        later = quiet.get(STATE)
        away_s = seconds(last, later)
        # The machine cools on, ever slower.
        assert abs(node_c(later) - node_c(last)) < 1.0 + 1.5 * node_k_per_s * away_s, "no jump"
        # Less is known the longer no temperature comes, whether it was stopped or not.
        grown_k = abs(spread_k(later) - spread_k(last))
        assert grown_k < 0.3 + 1.5 * spread_k_per_s * away_s

    done = ended(quiet, job_id)
    assert (done["status"], done["attempts"]) == ("succeeded", 1)
    assert set(versions(quiet)) - set(before) == {done["model_version"]}, "once"
    assert versions(quiet)[done["model_version"]] in ("candidate", "rejected"), "suggested only"
    assert quiet.tag("model.version") == active

    # The region is smaller now: the second stage lies outside.
    first = done["windows"][0]
    refusal = post(quiet, JOBS, {"windows": [{"start": first["start"], "end": first["end"]}]})
    assert refusal.status_code == 422
    (error,) = refusal.json()["errors"]
    assert error["pointer"] == "/windows/0"
    assert "outside the low-risk region (2000 rpm" in error["detail"]


@pytest.mark.endurance
def test_a_service_killed_in_mid_job_takes_it_up_again(quiet: Site) -> None:
    assert quiet.service is not None
    assert quiet.service.terminate() == 0
    # What a busy machine recorded in the narrow region may have gaps, and give no window.
    configure(quiet, (NARROW_REGION, WIDE_REGION))
    quiet.start_service()
    before, active = versions(quiet), quiet.tag("model.version")
    job_id = start(quiet, LONG)
    running(quiet, job_id)
    worker = worker_of(quiet)
    quiet.service.kill()
    wait_until(
        lambda: not Path(f"/proc/{worker}").exists(), PATIENCE_S, "no worker outlives its service"
    )
    quiet.start_service()
    done = ended(quiet, job_id)
    assert (done["status"], done["attempts"]) == ("succeeded", 2)
    assert set(versions(quiet)) - set(before) == {done["model_version"]}
    assert quiet.tag("model.version") == active
    assert quiet.service.terminate() == 0
    with quiet.open_store() as store:
        assert_one_active(store)


def assert_one_active(store: Store) -> None:
    active = [one for one in store.models.versions(ASSET) if one.status == "active"]
    assert len(active) == 1
