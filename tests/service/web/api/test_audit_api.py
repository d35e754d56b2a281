"""Every change leaves a line, whichever route makes it."""

import asyncio
import functools
from typing import Any

import pytest
from fastapi.routing import APIRoute, iter_route_contexts
from patience import patience
from processes import wait_until

from service.security.keys import create_key, revoke_key
from service.store import StoreUnavailableError
from service.web.api.access import AUDIT

AUDIT_PATH = "/api/v1/audit"
PAGE = {"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}
# Calls that change nothing that anybody would ask about, or that write their line themselves.
SILENT = {
    *(
        (method, f"/api/v1/commissioning/{work}")  # see test_commissioning_routes.py
        for method, work in [
            ("POST", "units"),
            ("POST", "registers"),
            ("POST", "dbc"),
            ("POST", "signals"),
            ("POST", "check"),
            ("PUT", "configuration"),
            ("POST", "versions/{number}/restore"),
        ]
    ),
    ("POST", "/api/v1/assets/{asset_id}/forecasts"),
    ("POST", "/api/v1/assets/{asset_id}/measurements"),
    ("POST", "/api/v1/measurements"),
    ("POST", "/api/v1/write"),
    ("POST", "/api/v1/session"),
    ("POST", "/api/v1/keys"),
    ("DELETE", "/api/v1/keys/{key_id}"),
}


async def lines(world: Any) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = (await world.client("admin").get(AUDIT_PATH)).json()["items"]
    return [line for line in items if line["who"] != "service"]  # the keys of the fixture


def test_every_call_that_may_change_something_is_audited(world: Any) -> None:
    silent = {
        (method, route.path)
        for route in iter_route_contexts(world.app.routes)
        if isinstance(route.original_route, APIRoute)
        for method in route.methods - {"GET", "HEAD"}
        if (route.openapi_extra or {}).get(AUDIT, "") is None
    }
    assert silent == SILENT


async def test_an_alarm_action_tells_who_when_what_and_from_where(world: Any) -> None:
    alarm = world.raise_alarm()
    key = create_key(world.store, "operator", label="control room")
    operator = world.client(headers={"X-API-Key": key.text})
    path = f"/api/v1/alarms/{alarm}/acknowledge"
    assert (await operator.post(path, json={"comment": "load is reduced"})).status_code == 200
    (line,) = await lines(world)
    assert line["who"] == f"operator {key.record.prefix} (control room)"
    assert line["address"] == "203.0.113.9"
    assert line["action"] == "alarm.acknowledge"
    assert line["target"] == f"alarm {alarm}"
    assert line["detail"] == "comment: load is reduced"
    assert line["time"].endswith("Z")


async def test_what_failed_or_changed_nothing_leaves_no_line(world: Any) -> None:
    assert (await world.client("operator").post("/api/v1/alarms/none/acknowledge")).is_error
    what_if = {"profile": [{"duration_s": 60, "speed_rpm": 1500, "load_n": 2650}]}
    forecasts = "/api/v1/assets/bench-1/forecasts"
    assert (await world.client("operator").post(forecasts, json=what_if)).is_success
    assert (await world.client("viewer").post(forecasts, json=what_if)).status_code == 403
    assert await lines(world) == []


async def test_jobs_keys_and_sessions_leave_lines(world: Any) -> None:
    engineer, jobs = world.client("engineer"), "/api/v1/assets/bench-1/identifications"
    for _ in range(2):  # sent again, it starts nothing
        started = await engineer.post(jobs, json={}, headers={"Idempotency-Key": "k"})
    job = started.json()["id"]
    await engineer.delete(f"{jobs}/{job}")
    made = (await world.client("admin").post("/api/v1/keys", json={"role": "viewer"})).json()
    browser = world.client(timeout=patience(3))
    await browser.post("/api/v1/session", json={"key": made["key"]}, headers=PAGE)
    await browser.delete("/api/v1/session", headers=PAGE)
    await browser.post("/api/v1/session", json={"key": "secret nonsense"}, headers=PAGE)
    await world.client("admin").delete(f"/api/v1/keys/{made['id']}")
    await browser.post("/api/v1/session", json={"key": made["key"]}, headers=PAGE)
    found = [(line["action"], line["target"], line["detail"]) for line in await lines(world)]
    key = f"key {made['prefix']}"
    assert found[::-1] == [
        ("identification.start", f"asset bench-1, made {job}", ""),
        ("identification.cancel", f"asset bench-1, job {job}", ""),
        ("key.create", key, "role viewer"),
        ("session.begin", "", ""),
        ("session.end", "", ""),
        ("session.refuse", "", "no key of this service"),
        ("key.revoke", key, "role viewer"),
    ]  # a second refusal from there within a minute is counted
    world.app.state.trail.settle()
    last = (await lines(world))[0]
    detail = f"1 more within 60 s, the last: a wrong key ({made['prefix']})"
    assert (last["action"], last["detail"]) == ("session.refuse", detail)
    text = (await world.client("admin").get(AUDIT_PATH)).text
    assert made["key"] not in text
    assert "nonsense" not in text


async def test_keys_of_the_command_line_are_in_the_trail_too(world: Any) -> None:
    key = create_key(world.store, "viewer", label="wall")
    revoke_key(world.store, key.record.id)
    items = (await world.client("admin").get(AUDIT_PATH)).json()["items"]
    assert [(line["action"], line["detail"]) for line in items[:2]] == [
        ("key.revoke", "role viewer"),
        ("key.create", "role viewer, wall"),
    ]


async def test_the_trail_comes_in_pages(world: Any) -> None:
    path, seen = f"{AUDIT_PATH}?limit=2", []
    while path:
        response = await world.client("admin").get(path)
        seen += [line["target"] for line in response.json()["items"]]
        path = response.links["next"]["url"] if response.json()["next"] else ""
    assert seen == [f"key {key.prefix}" for key in reversed(world.store.access.list_keys())]


async def test_what_the_store_cannot_take_now_is_written_later(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    alarm, write = world.raise_alarm(), world.store.alarms.save

    def refuse(*_: Any) -> None:
        raise StoreUnavailableError("away")

    monkeypatch.setattr(world.store.alarms, "save", refuse)
    acknowledged = await world.client("operator").post(f"/api/v1/alarms/{alarm}/acknowledge")
    assert acknowledged.status_code == 200
    monkeypatch.setattr(world.store.alarms, "save", write)
    written = functools.partial(world.context.outbox.flush, 30)
    await asyncio.to_thread(wait_until, written, 30, "the store has the line")
    (line,) = await lines(world)
    assert line["action"] == "alarm.acknowledge"
