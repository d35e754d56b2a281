"""Lists of assets by REST: taken or removed in one transaction, or refused whole."""

import asyncio
from typing import Any

import pytest
from patience import patience

from service.domain.errors import CellUnavailableError

from .provisioned import (
    ASSETS,
    AXLE,
    CSV,
    IMPORT,
    REMOVE,
    Cell,
    audit,
)


async def test_many_are_removed_in_one_transaction_or_none(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    names = [f"axle-{n}" for n in range(30)]
    revision = world.store.assets.change(dict.fromkeys(names, AXLE), 1)
    wrong = await admin.post(REMOVE, json={"ids": ["axle-1", "bench-1", "axle-x"]})
    assert wrong.status_code == 422
    assert {one["pointer"]: one["detail"] for one in wrong.json()["errors"]} == {
        "/ids/1": "bench-1: stands in the configuration file; expected a change there",
        "/ids/2": "axle-x: no such asset is provisioned",
    }
    for refused in ({"ids": []}, {"ids": [1]}, {}):
        assert (await admin.post(REMOVE, json=refused)).status_code == 422
    assert (len(world.store.assets.present()), cell.asked) == (30, 0)

    done = await admin.post(REMOVE, json={"ids": [*names[:25], "axle-1"]})
    assert (done.status_code, done.json()) == (200, {"removed": 25})
    assert [one.id for one in world.store.assets.present()] == sorted(names[25:])
    assert len({one.revision for one in world.store.assets.changed_since(revision)}) == 1
    (line,) = audit(world)
    assert (line.action, cell.asked) == ("assets.remove", 1)
    assert line.detail.startswith("removed: 25; assets: axle-0, axle-1, ")
    assert line.detail.endswith(" and 5 more")
    # A whole fleet in one request.
    fleet = [f"a-fleet-of-many-axles-{n}" for n in range(20_000)]
    assert (await admin.post(REMOVE, json={"ids": fleet})).status_code == 422
    cell.away = CellUnavailableError("it is being started")
    later = await admin.post(REMOVE, json={"ids": names[25:]})
    assert (later.status_code, later.json()) == (202, {"removed": 5})


# RFC 7396, appendix A.
async def test_a_list_is_taken_in_one_transaction_with_one_line(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    world.store.assets.change({"axle-1": AXLE, "axle-2": AXLE}, 1)
    listed = [
        {"id": "axle-1"} | AXLE,
        {"id": "axle-2"} | AXLE | {"name": "two"},
        {"id": "axle-3", "template": "axle", "values": {"unit": 13}},
    ]
    done = await admin.post(IMPORT, json={"assets": listed})
    assert done.status_code == 200, done.text
    assert done.json() == {
        "created": 1,
        "changed": 1,
        "unchanged": 1,
        "rejected": [],
        "not_running": {},
    }
    (line,) = audit(world)
    assert line.action == "assets.import"
    assert line.detail == "created: 1; changed: 1; assets: axle-3, axle-2"
    assert len({one.revision for one in world.store.assets.changed_since(1)}) == 1
    again = await admin.post(IMPORT, json={"assets": listed})
    assert again.json()["unchanged"] == 3
    assert (len(audit(world)), cell.asked) == (1, 1)


WRONG_CSV = b"""\
id;template;name;unit
axle-1;axle;Car 1;1
axle-2;axle;Car 2;eleven
axle-3;axle;Car 3;
axle-4;axle;Car 4;4
bench-1;axle;Bench;5
"""


async def test_one_wrong_row_refuses_all_or_is_left_out(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    for query in ("", "?dry_run=true"):
        refused = await admin.post(IMPORT + query, content=WRONG_CSV, headers=CSV)
        assert refused.status_code == 422
        problem = refused.json()
        assert problem["detail"].startswith("3 rows are wrong, nothing is changed; row 3 (axle-2)")
        assert [error["pointer"] for error in problem["errors"]] == [
            "/assets/1/channels/t_outer_ring_c/unit_id",
            "/assets/2/values/unit",
            "/assets/4",
        ]
        assert "'eleven'" in problem["errors"][0]["detail"]
    assert (world.store.assets.present(), audit(world), cell.asked) == ([], [], 0)

    tried = await admin.post(IMPORT + "?partial=true&dry_run=true", content=WRONG_CSV, headers=CSV)
    assert (tried.status_code, tried.json()["created"]) == (200, 2)
    assert (world.store.assets.present(), audit(world), cell.asked) == ([], [], 0)

    taken = await admin.post(IMPORT + "?partial=true", content=WRONG_CSV, headers=CSV)
    assert taken.status_code == 200
    assert taken.json()["created"] == 2
    assert [(one["row"], one["id"]) for one in taken.json()["rejected"]] == [
        (3, "axle-2"),
        (4, "axle-3"),
        (6, "bench-1"),
    ]
    assert all(one["detail"] and one["errors"] for one in taken.json()["rejected"])
    assert [one.id for one in world.store.assets.present()] == ["axle-1", "axle-4"]
    assert world.store.assets.get("axle-4").table == {
        "template": "axle",
        "name": "Car 4",
        "values": {"unit": 4},
    }


@pytest.mark.parametrize(
    ("content", "kind", "status"),
    [
        (b"", "text/csv", 422),
        (b"name\nx\n", "text/csv", 422),
        (b"{}", "application/json", 422),
        (b"{", "application/json", 422),
        (b"[" * 50_000, "application/json", 422),
        (b"id\nx\n", "text/plain", 415),
        (b"id\n" + b"x" * 9_000_000, "text/csv", 413),
    ],
)
async def test_what_is_no_list_is_refused(
    world: Any, cell: Cell, content: bytes, kind: str, status: int
) -> None:
    refused = await world.client("admin").post(
        IMPORT, content=content, headers={"Content-Type": kind}
    )
    assert refused.status_code == status
    assert refused.json()["detail"]


async def test_csv_is_for_lists_of_assets_only(world: Any, cell: Cell) -> None:
    refused = await world.client("admin").put(f"{ASSETS}/axle-1", content=b"id\n", headers=CSV)
    assert refused.status_code == 415
    assert refused.headers["accept-post"] == "application/json"


async def test_one_of_thousands_that_is_not_there_is_said_in_few_words(world: Any) -> None:
    for number in range(5000):
        world.context.assets[f"axle-{number}"] = world.context.assets["rig-2"]
    missing = await world.client("viewer").get(f"{ASSETS}/axle-x")
    assert missing.status_code == 404
    assert missing.json()["detail"].endswith("axle-16, axle-17 and 4982 more")


async def test_thousands_are_taken_at_once_while_others_are_answered(
    world: Any, cell: Cell
) -> None:
    """The list is judged in a thread: whoever asks meanwhile is answered before it is done."""
    listed = [{"id": f"axle-{n}", "template": "axle", "values": {"unit": 7}} for n in range(4000)]
    importing = asyncio.create_task(
        world.client("admin").post(IMPORT, json={"assets": listed}, timeout=patience(600))
    )
    answered = 0
    while not importing.done():
        assert (await world.client("viewer").get("/livez")).status_code == 200
        answered += 1
        await asyncio.sleep(0.01)
    done = await importing
    assert done.json()["created"] == 4000
    assert answered > 5
    assert len(world.store.assets.present()) == 4000
