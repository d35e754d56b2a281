import json
from typing import Any

import pytest
from pydantic import TypeAdapter

from service.documents.assets import AssetDocument, AssetList, State
from service.documents.forecasts import LiveForecast, WholeRun
from service.documents.tags import Snapshot

SNAPSHOT = "/api/v1/assets/bench-1/snapshot"


async def test_assets_are_listed_and_shown(world: Any) -> None:
    client = world.client("viewer")
    listed = AssetList.model_validate((await client.get("/api/v1/assets")).json())
    assert [asset.id for asset in listed.items] == ["bench-1", "rig-2"]
    shown = (await client.get("/api/v1/assets/bench-1")).json()
    assert AssetDocument.model_validate(shown).bearing == "6311"
    assert shown["controller"] is None


async def test_snapshot_answers_304_until_something_changes(world: Any) -> None:
    client = world.client("viewer")
    first = await client.get(SNAPSHOT)
    assert TypeAdapter(Snapshot).validate_python(first.json()) == world.bench.snapshot()
    assert first.json()["tags"]["t_inner_ring_c"]["value"] == 60.0
    entity_tag = first.headers["etag"]
    for condition in (entity_tag, f"W/{entity_tag}", f'"other", {entity_tag}', "*"):
        again = await client.get(SNAPSHOT, headers={"If-None-Match": condition})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == entity_tag
    other = await client.get(SNAPSHOT, headers={"If-None-Match": '"other"'})
    assert other.status_code == 200
    world.bench.tags["t_inner_ring_c"]["value"] = 61.0
    changed = await client.get(SNAPSHOT, headers={"If-None-Match": entity_tag})
    assert changed.status_code == 200
    assert changed.headers["etag"] != entity_tag


@pytest.mark.parametrize("path", ["/api/v1/assets", "/api/v1/assets/bench-1"])
async def test_configuration_answers_304_until_something_changes(world: Any, path: str) -> None:
    client = world.client("gateway")
    entity_tag = {"If-None-Match": (await client.get(path)).headers["etag"]}
    assert (await client.get(path, headers=entity_tag)).status_code == 304
    world.bench.channels["load_n"] = "drive"
    assert (await client.get(path, headers=entity_tag)).status_code == 200


async def test_snapshot_never_asks_the_store(world: Any) -> None:
    client = world.client("viewer")
    await client.get(SNAPSHOT)  # the key is known now
    world.store.close()
    (world.data_dir / "bearing-twin.db").rename(world.data_dir / "gone.db")
    assert (await client.get(SNAPSHOT)).status_code == 200


async def test_what_is_not_a_number_is_null(world: Any) -> None:
    world.bench.tags["t_inner_ring_c"] |= {"value": float("nan"), "quality": 16}
    snapshot = await world.client("viewer").get(SNAPSHOT)
    assert json.loads(snapshot.text)["tags"]["t_inner_ring_c"]["value"] is None
    state = (await world.client("viewer").get("/api/v1/assets/bench-1/state")).json()
    assert State.model_validate(state).nodes["t_node_13_c"].std_c is None


async def test_forecast_is_missing_until_there_is_one(world: Any) -> None:
    client = world.client("viewer")
    waiting = await client.get("/api/v1/assets/bench-1/forecast")
    assert waiting.status_code == 503
    assert int(waiting.headers["Retry-After"]) > 0
    assert "waits for its first data" in waiting.json()["detail"]
    world.bench.live_forecast = LiveForecast(
        time_s=[0.0],
        nodes={},
        not_known={},
        limits={},
        time_to_limit={},
        labels=[],
        whole_run=WholeRun(level=0.9, factors={}),
        runaway_probability=0.0,
        model_version=1,
        profile=[],
        missing=[],
        made_at="2026-11-21T08:00:00.000Z",
        intervals_made_at="2026-11-21T08:00:00.000Z",
        planned=False,
    )
    answer = await client.get("/api/v1/assets/bench-1/forecast")
    assert LiveForecast.model_validate(answer.json()) == world.bench.live_forecast
    assert world.bench.looks > 0, "who asks looks at it"


async def test_what_if_passes_on_what_was_asked(world: Any) -> None:
    body = {
        "profile": [{"duration_s": 120, "speed_rpm": 6200, "load_n": 5500, "ambient_c": 24}],
        "step_s": 30,
        "nodes": ["t_inner_ring_c", "t_node_7_c"],
    }
    client = world.client("operator")
    answer = (await client.post("/api/v1/assets/bench-1/forecasts", json=body)).json()
    assert answer["time_s"] == [0, 30, 60, 90, 120]
    assert list(answer["nodes"]) == body["nodes"]
    whole = (
        await client.post("/api/v1/assets/bench-1/forecasts", json={"profile": body["profile"]})
    ).json()
    assert len(whole["nodes"]) == 15


async def test_what_if_before_the_first_data_is_to_be_tried_again(world: Any) -> None:
    world.bench.ready = False
    body = {"profile": [{"duration_s": 120, "speed_rpm": 6200, "load_n": 5500}]}
    response = await world.client("operator").post("/api/v1/assets/bench-1/forecasts", json=body)
    assert response.status_code == 503
    assert int(response.headers["retry-after"]) > 0
    assert "first good" in response.json()["detail"]


async def test_the_short_way_to_a_snapshot_refuses_and_answers_as_the_route_does(
    world: Any,
) -> None:
    gateway = await world.client("gateway").get(SNAPSHOT)
    assert gateway.status_code == 403
    assert gateway.headers["content-type"] == "application/problem+json"
    assert (await world.client().get(SNAPSHOT)).status_code == 401
    assert (await world.client("viewer").get(SNAPSHOT.replace("bench-1", "b-9"))).status_code == 404
    assert (await world.client("viewer").post(SNAPSHOT)).status_code == 405
    answer = await world.client("viewer").get(SNAPSHOT)
    assert answer.headers["cache-control"] == "private, no-cache"
    assert answer.headers["x-content-type-options"] == "nosniff"
    world.bench.tags["speed_rpm"]["value"] = 61.0
    again = await world.client("viewer").get(
        SNAPSHOT, headers={"If-None-Match": answer.headers["etag"]}
    )
    assert again.status_code == 200
    assert again.json()["tags"]["speed_rpm"]["value"] == 61.0


async def test_assets_come_in_pages_where_that_is_asked_for(world: Any) -> None:
    client = world.client("viewer")
    for number in range(5):
        world.context.assets[f"axle-{number}"] = world.context.assets["rig-2"]
    address: str | None = "/api/v1/assets?limit=3"
    sizes, cursor = [], ""
    while address:
        answer = await client.get(address)
        page = AssetList.model_validate(answer.json())
        sizes.append(len(page.items))
        again = await client.get(address, headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == 304
        if sizes == [3]:
            cursor = page.next or ""
            # What the page ended with is removed: the next one goes on after it all the same.
            del world.context.assets["axle-2"]
        address = answer.headers["link"][1:].partition(">")[0] if page.next else None
    assert sizes == [3, 3, 1]
    assert (await client.get("/api/v1/assets")).json()["next"] is None
    for wrong in ({"cursor": cursor}, {"limit": 3, "cursor": "x"}, {"limit": 0}, {"limit": 1001}):
        refused = await client.get("/api/v1/assets", params=wrong)
        assert refused.status_code == 422, wrong
