from typing import Any

import pytest

from service.documents.models import ActivationList, ModelDocument, ModelList

MODELS = "/api/v1/assets/bench-1/models"
PAPER_VIEW = {"f2": {"value": 0.7, "low": 0.5, "high": 0.9}}
DOCUMENT = {
    "model": "default",
    "parameters": {
        "k1": {
            "value": 1.0,
            "unit": "W/K",
            "low": 0.5,
            "high": 2.0,
            "verdict": "informed",
            "at_bound": None,
            "informed_share": 0.8,
            "description": "contact conductance",
        }
    },
    "windows": [],
    "scores": {"train_rms_k": {"t_inner_ring_c": 0.4}},
    "naive": {"extrapolation": {"persistence": {"t_inner_ring_c": 3.0}}},
    "gates": None,
    "job": None,
    "identified": True,
}


@pytest.fixture
def models(world: Any) -> Any:
    """Version 1 active, 2 a candidate, 3 rejected."""
    for status, reason in (("candidate", ""), ("candidate", ""), ("rejected", "loses")):
        world.store.models.add("bench-1", status, reason, DOCUMENT, world.clock.now_us())
    world.store.models.activate("bench-1", 1, "service", "first", world.clock.now_us())
    return world


async def activate(world: Any, version: int | str, body: Any = None) -> Any:
    options = {} if body is None else {"json": body}
    return await world.client("engineer").post(f"{MODELS}/{version}/activate", **options)


async def test_versions_are_listed_newest_first(models: Any) -> None:
    document = (await models.client("engineer").get(MODELS)).json()
    items = ModelList.model_validate(document).items
    assert [(item.version, item.status) for item in items] == [
        (3, "rejected"),
        (2, "candidate"),
        (1, "active"),
    ]


async def test_one_version_is_shown(models: Any) -> None:
    document = (await models.client("engineer").get(f"{MODELS}/2")).json()
    assert ModelDocument.model_validate(document).version == 2
    for name in ("parameters", "scores", "naive"):
        assert document[name] == DOCUMENT[name]
    assert (await models.client("engineer").get(f"{MODELS}/4")).status_code == 404
    assert (await models.client("engineer").get(f"{MODELS}/0")).status_code == 422
    assert (await models.client("engineer").get(f"{MODELS}/{2**40}")).status_code == 422


async def test_what_the_data_inform_is_counted_in_the_list_and_spelled_out_for_one(
    world: Any,
) -> None:
    told = {
        "rank": 2,
        "condition": 30.0,
        "informed": 1,
        "weak": 1,
        "prior_only": 0,
        "combinations": [
            {
                "combination": "0.80 k1 + 0.60 k2",
                "weights": {"k1": 0.8, "k2": 0.6},
                "strength": 20.0,
                "std_over_prior": 0.05,
                "verdict": "informed",
            }
        ],
    }
    extra = {"identifiability": told, "paper_view": PAPER_VIEW}
    world.store.models.add("bench-1", "candidate", "", DOCUMENT | extra, 1)
    client = world.client("engineer")
    version = (await client.get(MODELS)).json()["items"][0]["version"]
    whole = (await client.get(f"{MODELS}/{version}")).json()
    assert whole["identifiability"] == told
    assert whole["paper_view"] == PAPER_VIEW
    (listed,) = [
        item for item in (await client.get(MODELS)).json()["items"] if item["version"] == version
    ]
    del told["combinations"]
    assert listed["identifiability"] == told


async def test_versions_of_older_releases_say_nothing_about_it(models: Any) -> None:
    for path in (f"{MODELS}/2", MODELS):
        document = (await models.client("engineer").get(path)).json()
        shown = document["items"][0] if "items" in document else document
        assert shown["identifiability"] is None
        assert shown["paper_view"] is None


async def test_activating_and_rolling_back_are_journaled(models: Any) -> None:
    response = await activate(models, 2)
    assert ModelDocument.model_validate(response.json()).status == "active"
    await activate(models, 1, {"comment": "back again"})
    who = f"engineer {models.keys['engineer'][:11]}"
    assert [(a.version, a.who, a.comment) for a in models.store.models.activations("bench-1")][
        1:
    ] == [
        (2, who, ""),
        (1, who, "back again"),
    ]
    journal = (await models.client("engineer").get(f"{MODELS}/activations")).json()
    ActivationList.model_validate(journal)
    assert [(line["version"], line["who"], line["comment"]) for line in journal["items"]] == [
        (1, who, "back again"),
        (2, who, ""),
        (1, "service", "first"),
    ]


@pytest.mark.parametrize("body", [None, {}, {"force": False}, {"force": True}])
async def test_rejected_version_needs_force_and_comment(models: Any, body: Any) -> None:
    response = await activate(models, 3, body)
    assert response.status_code == 409
    assert "loses" in response.json()["detail"]
    assert models.store.models.active("bench-1").version == 1


async def test_rejected_version_can_be_forced(models: Any) -> None:
    response = await activate(models, 3, {"force": True, "comment": "known better"})
    assert response.status_code == 200
    assert models.store.models.active("bench-1").version == 3


async def test_unknown_version_is_not_found(models: Any) -> None:
    assert (await activate(models, 9)).status_code == 404
    assert (await activate(models, "x")).status_code == 422
