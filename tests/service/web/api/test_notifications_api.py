"""Silences are planned, listed, ended and audited; notifications are listed as they are."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from service.documents.notifications import SilenceDocument, SilenceList

SILENCES = "/api/v1/silences"
WHY = "bearing is being regreased"


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
    planned = (await operator.post(SILENCES, json=later | {"weekly": weekly})).json()
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
    assert not world.store.silences.load(0)


async def test_a_site_without_notifications_has_none_to_list_or_test(world: Any) -> None:
    listed = await world.client("viewer").get("/api/v1/notifications")
    assert listed.json() == {"items": [], "next": None}
    tried = await world.client("engineer").post("/api/v1/notifications/nobody:test")
    assert tried.status_code == 404
