"""Silences are planned, listed, ended and audited."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from service.features.silences.documents import EndedSilences, SilenceDocument, SilenceList
from service.features.silences.tables import MOST_SILENCES, Silence, Silences

SILENCES = "/api/v1/silences"
WHY = "bearing is being regreased"
STANDING = Silence("", ("bench-1",), 0, 4_000_000_000_000_000, "eva", WHY)


def soon(**span: float) -> str:
    return (datetime.now(UTC) + timedelta(**span)).isoformat()


async def test_a_silence_is_planned_listed_and_ended_with_who_and_why(world: Any) -> None:
    operator, viewer = world.client("operator"), world.client("viewer")
    body = {"assets": ["bench-1"], "ends_at": soon(hours=2), "comment": WHY}
    made = await operator.post(SILENCES, json=body)
    assert made.status_code == 201
    now = SilenceDocument.model_validate(made.json())
    assert (now.in_force, now.comment, now.weekly) == (True, WHY, None)
    assert now.who == f"operator {world.keys['operator'][:11]}"
    weekly = {"days": ["sun", "sat"], "begins": "22:00", "ends": "06:00", "time_zone": "Asia/Tokyo"}
    later = body | {"assets": [], "begins_at": soon(days=1), "ends_at": soon(days=90)}
    planned = (
        await world.client("engineer").post(SILENCES, json=later | {"weekly": weekly})
    ).json()
    assert planned["weekly"] == weekly | {"days": ["sat", "sun"]}
    assert not planned["in_force"]

    answer = await viewer.get(SILENCES, params={"limit": 1})
    page = SilenceList.model_validate(answer.json())
    assert ([one.id for one in page.items], page.next is None) == ([now.id], False)
    assert (await operator.delete(f"{SILENCES}/{now.id}")).status_code == 204
    assert (await operator.delete(f"{SILENCES}/{now.id}")).status_code == 404
    left = (await viewer.get(SILENCES)).json()["items"]
    assert [one["id"] for one in left] == [planned["id"]]
    lines = [(line.action, line.target) for line in world.store.audit.page(3).items]
    assert lines == [
        ("silence.end", f"silence {now.id}"), ("silence.begin", ""), ("silence.begin", "")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "pointer"),
    [
        ({"assets": ["nobody"]}, "/assets"),
        ({"ends_at": "2020-01-01T00:00:00Z"}, "/ends_at"),
        ({"ends_at": soon(days=400)}, "/ends_at"),
        ({"begins_at": soon(hours=3)}, "/ends_at"),
        ({"comment": ""}, "/comment"),
        ({"weekly": {"begins": "06:00", "ends": "06:00"}}, "/weekly"),
        ({"weekly": {"begins": "6", "ends": "07:00"}}, "/weekly/begins"),
        ({"weekly": {"begins": "06:00", "ends": "07:00", "time_zone": "Mars/A"}}, "/weekly"),
        ({"weekly": {"begins": "06:00", "ends": "07:00", "time_zone": "../etc"}}, "/weekly"),
    ],
)
async def test_what_cannot_be_planned_is_refused_with_its_field(
    world: Any, wrong: dict[str, Any], pointer: str
) -> None:
    body = {"assets": ["bench-1"], "ends_at": soon(hours=2), "comment": WHY}
    refused = await world.client("operator").post(SILENCES, json=body | wrong)
    assert refused.status_code == 422
    assert [one["pointer"] for one in refused.json()["errors"]] == [pointer]
    assert not world.store.part(Silences).load(0)


async def test_there_are_so_many_silences_and_no_more(world: Any) -> None:
    operator = world.client("operator")
    body = {"assets": ["bench-1"], "ends_at": soon(hours=2), "comment": WHY}
    for number in range(MOST_SILENCES - 1):
        world.store.part(Silences).add(replace(STANDING, id=f"{number}"), 0)
    last = await operator.post(SILENCES, json=body)
    assert last.status_code == 201
    refused = await operator.post(SILENCES, json=body)
    assert refused.status_code == 409
    assert "expected at most 200" in refused.json()["detail"]
    ids = [f"{number}" for number in range(MOST_SILENCES)]
    ended = (await operator.post(f"{SILENCES}/end", json={"ids": ids})).json()
    assert EndedSilences.model_validate(ended).unknown == ids[-1:]
    listed = (await operator.get(SILENCES)).json()["items"]
    assert [one["id"] for one in listed] == [last.json()["id"]]
    assert (await operator.post(SILENCES, json=body)).status_code == 201
    assert (await operator.post(f"{SILENCES}/end", json={"ids": ids})).status_code == 404
    lines = [line.action for line in world.store.audit.page(3).items]
    assert lines == ["silence.begin", "silence.end", "silence.begin"]


@pytest.mark.parametrize("assets", [[], ["rig-2", "bench-1"]])
async def test_who_silences_all_machines_for_longer_than_a_day_is_an_engineer(
    world: Any, assets: list[str]
) -> None:
    operator, engineer = world.client("operator"), world.client("engineer")
    begins_at = soon(hours=1)
    day = {"assets": assets, "begins_at": begins_at, "ends_at": soon(hours=24), "comment": WHY}
    assert (await operator.post(SILENCES, json=day)).status_code == 201
    longer = day | {"ends_at": soon(hours=26)}
    refused = await operator.post(SILENCES, json=longer)
    assert refused.status_code == 403
    assert "priority 1" in refused.json()["detail"]
    weekly = {"days": ["sun"], "begins": "22:00", "ends": "06:00"}
    planned = longer | {"weekly": weekly}
    assert (await operator.post(SILENCES, json=planned)).status_code == 403
    assert (await operator.post(SILENCES, json=longer | {"assets": ["rig-2"]})).status_code == 201
    assert (await engineer.post(SILENCES, json=planned)).status_code == 201
