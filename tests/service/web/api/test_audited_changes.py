"""A change and its line in the audit trail stand or fall together, whichever route makes it."""

import asyncio
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts
from patience import patience
from processes import wait_until
from structlog.testing import capture_logs

from service.store import AuditEntry
from service.store.outbox import Outbox
from service.web.api.access import AUDIT
from service.web.api.trail import change_line

from .test_models_api import DOCUMENT

JOBS = "/api/v1/assets/bench-1/identifications"
# Calls that write into the store by themselves: their answer says whether the change was made.
REFUSED_AT_ONCE = (
    "activation",
    "job",
    "cancelled job",
    "key",
    "revoked key",
    "session",
    "grease",
    "asset",
)
# An alarm changes in memory; the store gets change and line from the queue on the disk.
ALARM_ACTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "acknowledge": ("operator", {}),
    "comment": ("operator", {"comment": "seen"}),
    "out-of-service": ("engineer", {"comment": "broken sensor"}),
    "shelve": ("operator", {"duration_s": 600}),
}


def depends_on_line(dependant: Dependant) -> bool:
    return dependant.call is change_line or any(map(depends_on_line, dependant.dependencies))


def test_every_audited_call_takes_its_line_with_it(world: Any) -> None:
    without = {
        (method, route.path)
        for route in iter_route_contexts(world.app.routes)
        if isinstance(route.original_route, APIRoute)
        for method in route.methods - {"GET", "HEAD"}
        if (route.openapi_extra or {}).get(AUDIT, "") is not None
        and not depends_on_line(route.original_route.dependant)
    }
    assert without == set()


@contextmanager
def no_lines(world: Any, outbox: Outbox | None = None) -> Iterator[None]:
    """The database refuses every line of the audit trail meanwhile.

    It takes them again between two tries of ``outbox``: one that is refused, and finds the
    database mended a moment later, is noted as refused and not tried again.
    """
    with closing(
        sqlite3.connect(world.data_dir / "bearing-twin.db", timeout=patience(30))
    ) as other:
        other.execute(
            "CREATE TRIGGER no_lines BEFORE INSERT ON audit "
            "BEGIN SELECT RAISE(ABORT, 'no line today'); END"
        )
        other.commit()
        yield
        if outbox is not None:
            other.execute("BEGIN IMMEDIATE")
            wait_until(lambda: outbox.problem is not None, 30, "a try that finds the store busy")
        other.execute("DROP TRIGGER no_lines")
        other.commit()


def actions(world: Any) -> list[str]:
    items: list[AuditEntry] = world.store.audit.page(100).items
    return [line.action for line in items if line.who != "service"]


async def made_ready(world: Any, change: str) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """A call, and how to see what it has changed."""
    store, client = world.store, world.client
    if change == "activation":
        for _ in range(2):
            store.models.add("bench-1", "candidate", "", DOCUMENT, 1)
        store.models.activate("bench-1", 1, "service", "", 1)
        path = "/api/v1/assets/bench-1/models/2/activate"
        return (
            lambda: client("engineer").post(path, json={}),
            lambda: [one.status for one in store.models.versions("bench-1")],
        )
    if change == "job":
        return (
            lambda: client("engineer").post(JOBS, json={}),
            lambda: len(store.jobs.of_asset("bench-1")),
        )
    if change == "cancelled job":
        job = (await client("engineer").post(JOBS, json={})).json()["id"]
        return (
            lambda: client("engineer").delete(f"{JOBS}/{job}"),
            lambda: store.jobs.get(job).status,
        )
    if change == "key":
        return (
            lambda: client("admin").post("/api/v1/keys", json={"role": "viewer"}),
            lambda: len(store.access.list_keys()),
        )
    if change == "revoked key":
        key = store.access.list_keys()[0]
        return (
            lambda: client("admin").delete(f"/api/v1/keys/{key.id}"),
            lambda: store.access.list_keys()[0].revoked_us is None,
        )
    if change == "grease":
        return (
            lambda: client("engineer").post("/api/v1/assets/bench-1/grease-renewed", json={}),
            lambda: store.states.load("bench-1"),
        )
    if change == "asset":
        pushed = {name: {"source": "push"} for name in ("speed_rpm", "load_n", "t_inner_ring_c")}
        low_risk = {"speed_rpm_max": 900, "load_n_max": 4000}
        table = {"bearing": "6311", "low_risk": low_risk, "channels": pushed}
        return (
            lambda: client("admin").put("/api/v1/assets/axle-1", json=table),
            lambda: store.assets.get("axle-1"),
        )
    browser = client(timeout=patience(30))
    page = {"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}
    begun = await browser.post("/api/v1/session", json={"key": world.keys["viewer"]}, headers=page)
    assert begun.is_success
    with closing(sqlite3.connect(world.data_dir / "bearing-twin.db")) as other:
        sessions = other.execute("SELECT sha256 FROM browser_sessions").fetchall()
    return (
        lambda: browser.delete("/api/v1/session", headers=page),
        lambda: [store.access.find_session(sha256) is not None for (sha256,) in sessions],
    )


@pytest.mark.parametrize("change", REFUSED_AT_ONCE)
async def test_without_its_line_nothing_is_changed(world: Any, change: str) -> None:
    call, look = await made_ready(world, change)
    before, lines = look(), actions(world)
    with no_lines(world):
        refused = await call()
        assert refused.is_error
        assert look() == before
    assert actions(world) == lines
    done = await call()
    assert done.is_success, done.text
    assert look() != before
    assert len(actions(world)) == len(lines) + 1


@pytest.mark.parametrize("action", ALARM_ACTIONS)
async def test_an_alarm_changes_in_the_store_with_its_line_only(world: Any, action: str) -> None:
    role, body = ALARM_ACTIONS[action]
    alarm = world.raise_alarm()
    assert await asyncio.to_thread(world.context.outbox.flush, 30)
    path = f"/api/v1/alarms/{alarm}/{action}"

    def kept() -> tuple[str, str | None, int]:
        (row,) = world.store.alarms.load()
        return row.state, row.comment, len(world.store.alarms.journal().items)

    before = kept()
    outbox = world.alarm_answers.outbox
    with capture_logs() as logs, no_lines(world, outbox):
        assert (await world.client(role).post(path, json=body)).status_code == 200
        # Not even that it is refused can be noted: it waits, with its line.
        await asyncio.to_thread(
            wait_until,
            lambda: [one for one in logs if one["event"] == "outbox_failed"],
            30,
            "a try",
        )
        assert (kept(), outbox.waiting) == (before, 1)
        assert actions(world) == []
    await asyncio.to_thread(wait_until, lambda: not outbox.waiting, 30, "the store has all")
    assert kept() != before
    assert len(actions(world)) == 1


async def test_change_and_line_of_an_alarm_wait_for_the_store_as_one(world: Any) -> None:
    """What a killed service leaves on the disk has both, or none."""
    alarm = world.raise_alarm()
    assert await asyncio.to_thread(world.context.outbox.flush, 30)
    with closing(
        sqlite3.connect(world.data_dir / "bearing-twin.db", timeout=patience(30))
    ) as other:
        other.execute("BEGIN EXCLUSIVE")
        outbox = world.alarm_answers.outbox
        world.alarms.acknowledge(
            alarm, "operator x", "", AuditEntry(1, "operator x", "", "alarm.acknowledge")
        )
        await asyncio.to_thread(wait_until, lambda: not outbox.unkept, 30, "it is on the disk")
        with closing(sqlite3.connect(world.data_dir / "outbox.db")) as queue:
            (document,) = (text for (text,) in queue.execute("SELECT document FROM changes"))
        assert '"state": "ACKED"' in document
        assert '"action": "alarm.acknowledge"' in document
    assert await asyncio.to_thread(outbox.flush, 60)
    assert [one.state for one in world.store.alarms.load()] == ["ACKED"]
    assert actions(world) == ["alarm.acknowledge"]


async def test_several_alarms_acknowledged_at_once_leave_one_line(world: Any) -> None:
    ids = [world.raise_alarm(channel) for channel in ("t_inner_ring_c", "t_outer_ring_c")]
    path = "/api/v1/alarms/acknowledge"
    done = await world.client("operator").post(path, json={"ids": ["none", *ids]})
    assert len(done.json()["items"]) == 2
    assert actions(world) == ["alarm.acknowledge"]
    again = await world.client("operator").post(path, json={"ids": ids})
    assert (len(again.json()["failed"]), len(actions(world))) == (2, 1), "nothing was changed"
