"""Advice over HTTP: what is passed on, and what is answered when there is none."""

from typing import Any

import pytest

ADVICE = "/api/v1/assets/bench-1/advice"


async def test_advice_is_asked_for_the_point_of_the_query(world: Any) -> None:
    client = world.client("engineer")
    answer = await client.get(ADVICE, params={"speed_rpm": 6200, "load_n": 5500})
    asked = {"speed_rpm": 6200, "load_n": 5500, "duration_s": 7200}
    assert answer.json()["target"].items() >= asked.items()
    assert answer.json()["next_step"]["asked_half_width_k"] is None
    longer = {"speed_rpm": 6200, "load_n": 0, "duration_s": 600.5}
    answer = await client.get(ADVICE, params=longer | {"half_width_k": 4.5})
    assert answer.json()["target"].items() >= longer.items()
    assert answer.json()["next_step"]["asked_half_width_k"] == 4.5


async def test_advice_without_an_identified_model_is_a_conflict(world: Any) -> None:
    world.bench.identified = False
    answer = await world.client("engineer").get(ADVICE, params={"speed_rpm": 6200, "load_n": 5500})
    assert answer.status_code == 409
    assert answer.headers["content-type"] == "application/problem+json"
    assert "no identified model yet" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("query", "parameter"),
    [
        ("load_n=5500", "speed_rpm"),
        ("speed_rpm=6200", "load_n"),
        ("speed_rpm=0&load_n=5500", "speed_rpm"),
        ("speed_rpm=20001&load_n=5500", "speed_rpm"),
        ("speed_rpm=fast&load_n=5500", "speed_rpm"),
        ("speed_rpm=nan&load_n=5500", "speed_rpm"),
        ("speed_rpm=6200&load_n=-1", "load_n"),
        ("speed_rpm=6200&load_n=inf", "load_n"),
        ("speed_rpm=6200&load_n=5500&duration_s=0", "duration_s"),
        ("speed_rpm=6200&load_n=5500&duration_s=172801", "duration_s"),
        ("speed_rpm=6200&load_n=5500&half_width_k=0", "half_width_k"),
        ("speed_rpm=6200&load_n=5500&half_width_k=nan", "half_width_k"),
    ],
)
async def test_a_wrong_point_is_named(world: Any, query: str, parameter: str) -> None:
    answer = await world.client("engineer").get(f"{ADVICE}?{query}")
    assert answer.status_code == 422
    assert [error["parameter"] for error in answer.json()["errors"]] == [parameter]


async def test_an_unknown_asset_is_named(world: Any) -> None:
    path = ADVICE.replace("bench-1", "bench-9")
    answer = await world.client("admin").get(path, params={"speed_rpm": 6200, "load_n": 5500})
    assert answer.status_code == 404
    assert "bench-9" in answer.json()["detail"]


async def test_openapi_describes_it_with_units(world: Any) -> None:
    schema = (await world.client().get("/openapi.json")).json()
    advice = schema["paths"]["/api/v1/assets/{asset_id}/advice"]["get"]
    described = {one["name"]: one for one in advice["parameters"]}
    assert "revolutions per minute" in described["speed_rpm"]["description"]
    assert "newtons" in described["load_n"]["description"]
    assert {"404", "409", "422", "503"} <= advice["responses"].keys()
    assert "half_width_k" in schema["components"]["schemas"]["AdvisedStep"]["properties"]
