"""Envelope and advice over HTTP: what is passed on, and what is answered when there is none."""

from typing import Any

import pytest

ENVELOPE = "/api/v1/assets/bench-1/envelope"
ADVICE = "/api/v1/assets/bench-1/advice"


async def test_envelope_is_the_twins_and_infinities_are_null(world: Any) -> None:
    answer = await world.client("viewer").get(ENVELOPE)
    assert answer.status_code == 200
    assert answer.json()["runaway"]["probability"] == [[None]]
    assert answer.json()["labels"] == []


async def test_envelope_before_the_first_data_is_to_be_tried_again(world: Any) -> None:
    world.bench.ready = False
    answer = await world.client("viewer").get(ENVELOPE)
    assert answer.status_code == 503
    assert int(answer.headers["retry-after"]) > 0
    assert "first good" in answer.json()["detail"]


async def test_advice_is_asked_for_the_point_of_the_query(world: Any) -> None:
    client = world.client("engineer")
    answer = await client.get(ADVICE, params={"speed_rpm": 6200, "load_n": 5500})
    asked = {"speed_rpm": 6200, "load_n": 5500, "duration_s": 7200}
    assert answer.json()["target"].items() >= asked.items()
    longer = {"speed_rpm": 6200, "load_n": 0, "duration_s": 600.5}
    answer = await client.get(ADVICE, params=longer)
    assert answer.json()["target"].items() >= longer.items()


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
    ],
)
async def test_a_wrong_point_is_named(world: Any, query: str, parameter: str) -> None:
    answer = await world.client("engineer").get(f"{ADVICE}?{query}")
    assert answer.status_code == 422
    assert [error["parameter"] for error in answer.json()["errors"]] == [parameter]


@pytest.mark.parametrize("path", [ENVELOPE, f"{ADVICE}?speed_rpm=6200&load_n=5500"])
async def test_an_unknown_asset_is_named(world: Any, path: str) -> None:
    answer = await world.client("admin").get(path.replace("bench-1", "bench-9"))
    assert answer.status_code == 404
    assert "bench-9" in answer.json()["detail"]


async def test_openapi_describes_both_with_units_and_examples(world: Any) -> None:
    schema = (await world.client().get("/openapi.json")).json()
    paths, schemas = schema["paths"], schema["components"]["schemas"]
    advice = paths["/api/v1/assets/{asset_id}/advice"]["get"]
    described = {one["name"]: one for one in advice["parameters"]}
    assert "revolutions per minute" in described["speed_rpm"]["description"]
    assert "newtons" in described["load_n"]["description"]
    assert {"404", "409", "422", "503"} <= advice["responses"].keys()
    envelope = schemas["EnvelopeDocument"]["properties"]
    assert envelope["horizon_s"]["examples"] == [28800]
    assert "half_width_k" in schemas["AdvisedStep"]["properties"]
