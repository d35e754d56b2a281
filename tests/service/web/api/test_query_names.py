"""What is asked for and does not exist is an error, and never the answer to another question."""

import re
from dataclasses import replace
from typing import Any

import pytest
from fastapi.routing import APIRoute, iter_route_contexts

from adapters.samples import Sample
from service.web.api.routes import stream

VALUES = {"asset_id": "bench-1", "version": "1"}


def calls(world: Any) -> list[tuple[str, str]]:
    return [
        (method, re.sub(r"{(\w+)}", lambda match: VALUES.get(match[1], "none"), route.path))
        for route in iter_route_contexts(world.app.routes)
        if isinstance(route.original_route, APIRoute) and route.path.startswith("/api/")
        for method in route.methods
        if (method, route.path) != ("POST", "/api/v1/session")  # it has no key yet
    ]


async def test_every_call_refuses_a_parameter_that_it_does_not_have(world: Any) -> None:
    client = world.client("admin")
    asked = calls(world)
    assert len(asked) > 80
    for method, path in asked:
        body = {"json": {}} if method in ("POST", "PUT", "PATCH") else {}
        answer = await client.request(method, f"{path}?misspelt=1", **body)
        assert answer.status_code == 422, (method, path, answer.text)
        assert answer.json()["errors"][0]["parameter"] == "misspelt", (method, path)


@pytest.mark.parametrize(
    ("query", "parameter", "detail"),
    [
        ("from=2026-01-01T00:00:00Z", "from", "no such parameter; expected "),
        ("Start=2026-01-01T00:00:00Z", "Start", "no such parameter; expected start"),
        ("channels=t_inner_ring_c", "channels", "no such parameter; expected channel"),
        ("limit=5&limit=6", "limit", "expected once"),
        ("%01=1", "\x01", "no such parameter; expected "),
    ],
)
async def test_what_would_be_right_is_said(
    world: Any, query: str, parameter: str, detail: str
) -> None:
    path = f"/api/v1/assets/bench-1/measurements?{query}"
    answer = await world.client("viewer").get(path)
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["parameter"] == parameter
    assert error["detail"].startswith(detail)
    if detail.endswith("expected "):
        assert "start" in error["detail"]


async def test_a_list_may_come_several_times(world: Any) -> None:
    answer = await world.client("viewer").get("/api/v1/alarms?state=UNACK&state=ACKED&limit=5")
    assert answer.status_code == 200


@pytest.mark.parametrize("path", ["alarms", "alarms/journal", "alarms/statistics"])
async def test_an_asset_that_does_not_exist_has_no_answer(world: Any, path: str) -> None:
    world.raise_alarm()
    client = world.client("viewer")
    for name in ("bench-l", "BENCH-1", ""):
        answer = await client.get(f"/api/v1/{path}", params={"asset": name})
        assert answer.status_code == 422, name
        (error,) = answer.json()["errors"]
        assert error["parameter"] == "asset"
        assert error["detail"] == f"no asset {name!r}; there is: bench-1, rig-2"
    assert (await client.get(f"/api/v1/{path}?asset=bench-1")).status_code == 200


async def test_the_journal_of_an_asset_that_was_removed_can_be_read(world: Any) -> None:
    client = world.client("viewer")
    assert (await client.get("/api/v1/alarms/journal?asset=gone")).status_code == 422
    world.store.samples.write([Sample("gone", "load_n", 1_800_000_000_000_000, 1.0, 192, 0)])
    assert (await client.get("/api/v1/alarms/journal?asset=gone")).status_code == 200


async def test_no_cell_that_follows_an_asset_is_not_no_alarms(world: Any) -> None:
    context = replace(world.context, is_known=lambda name: name == "far-1")
    world.app.state.context = context
    answer = await world.client("viewer").get("/api/v1/alarms?asset=far-1")
    assert answer.status_code == 503


async def test_the_stream_has_the_parameters_that_the_description_names(world: Any) -> None:
    description = (await world.client().get("/openapi.json")).json()
    parameters = description["paths"]["/api/v1/stream"]["get"]["parameters"]
    assert tuple(one["name"] for one in parameters) == stream.PARAMETERS
