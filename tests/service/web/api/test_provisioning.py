"""Assets that are made, changed and removed by REST: kept whole, audited, and taken up at once."""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jsonschema_rs
import pytest

from service.domain.errors import CellUnavailableError
from service.site.settings import Settings
from service.store import AuditEntry, StoreUnavailableError
from service.web.api import create_app
from service.web.api.routes.provisioning import merge_patch

CONFIGURATION = {
    "sources": [
        {"name": "gateway-1", "driver": "modbus-tcp", "host": "127.0.0.1", "port": 5020},
    ],
    "templates": [
        {
            "name": "axle",
            "bearing": "6311",
            "low_risk": {"speed_rpm_max": 900, "load_n_max": 4000},
            "values": {"gateway": "gateway-1"},
            "channels": {
                "t_outer_ring_c": {
                    "source": "{gateway}",
                    "unit_id": "{unit}",
                    "register": 0,
                    "kind": "input",
                },
                "ambient_c": {"source": "push"},
                "speed_rpm": {"source": "push"},
                "load_n": {"source": "push"},
            },
        }
    ],
    "assets": [{"id": "bench-1", "template": "axle", "values": {"unit": 1}}],
}
AXLE = {"template": "axle", "values": {"unit": 11}}
ASSETS = "/api/v1/assets"
IMPORT = "/api/v1/assets:import"
REMOVE = "/api/v1/assets:remove"
ONLY_NEW = {"If-None-Match": "*"}
CSV = {"Content-Type": "text/csv; charset=utf-8"}


class Cell:
    """The boundary to the cell: counts how often it was to take up, or is away."""

    def __init__(self) -> None:
        self.asked = 0
        self.away: Exception | None = None
        self.wrong: Mapping[str, str] = {}

    async def apply(self) -> Mapping[str, str]:
        self.asked += 1
        if self.away is not None:
            raise self.away
        return self.wrong


@pytest.fixture
def cell(world: Any) -> Cell:
    """Give the application templates, and a cell that says what it was asked."""
    cell = Cell()
    world.context = replace(
        world.context, settings=Settings(**CONFIGURATION), apply_assets=cell.apply
    )
    world.app = create_app(world.context)
    return cell


def audit(world: Any) -> list[AuditEntry]:
    lines: list[AuditEntry] = world.store.audit.page(100).items
    return [line for line in lines if line.action.startswith("asset")]


async def test_an_asset_is_made_changed_and_removed(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    made = await admin.put(f"{ASSETS}/axle-1", json=AXLE)
    assert (made.status_code, made.headers["location"]) == (201, f"{ASSETS}/axle-1")
    document = made.json()
    assert document["table"] == AXLE
    assert (document["origin"], document["template"]) == ("provisioned", "axle")
    assert document["not_running"] is None
    assert cell.asked == 1
    same = await admin.put(f"{ASSETS}/axle-1", json=AXLE | {"id": "axle-1"})
    assert (same.status_code, same.json()["revision"]) == (202, document["revision"])
    assert same.json()["not_running"], "the boundary to the cell follows nothing"
    assert (cell.asked, len(audit(world))) == (1, 1), "nothing was changed"
    other = await admin.put(f"{ASSETS}/axle-1", json=AXLE | {"name": "Axle"})
    assert (other.status_code, "location" in other.headers) == (200, False)
    assert other.json()["revision"] > document["revision"]

    patch = {"name": None, "values": {"unit": 12}, "limits": {"t_inner_ring_c": None}}
    patched = await admin.patch(
        f"{ASSETS}/axle-1", json=patch, headers={"Content-Type": "application/merge-patch+json"}
    )
    assert patched.status_code == 200, patched.text
    assert patched.json()["table"] == {"template": "axle", "values": {"unit": 12}, "limits": {}}
    read = await world.client("engineer").get(f"{ASSETS}/axle-1/configuration")
    assert read.json()["table"] == patched.json()["table"]

    assert (await admin.delete(f"{ASSETS}/axle-1")).status_code == 204
    for refused in (
        await admin.delete(f"{ASSETS}/axle-1"),
        await admin.patch(f"{ASSETS}/axle-1", json={}),
        await admin.get(f"{ASSETS}/axle-1/configuration"),
    ):
        assert refused.status_code == 404
        assert refused.json()["errors"][0]["parameter"] == "asset_id"
    assert [line.action for line in audit(world)] == [
        "asset.delete",
        "asset.patch",
        "asset.put",
        "asset.put",
    ]
    assert {line.target for line in audit(world)} == {"asset axle-1"}
    assert audit(world)[0].who.startswith("admin ")


async def test_an_asset_of_the_file_is_changed_there_only(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    for refused in (
        await admin.put(f"{ASSETS}/bench-1", json=AXLE),
        await admin.patch(f"{ASSETS}/bench-1", json={"name": "other"}),
        await admin.delete(f"{ASSETS}/bench-1"),
    ):
        assert refused.status_code == 409
        assert "configuration file" in refused.json()["detail"]
    assert (audit(world), cell.asked) == ([], 0)
    read = (await admin.get(f"{ASSETS}/bench-1/configuration")).json()
    assert read == {
        "id": "bench-1",
        "origin": "file",
        "template": "axle",
        "revision": None,
        "changed_at": None,
        "table": None,
        "not_running": None,
    }


async def test_one_that_came_into_the_file_later_can_be_removed(world: Any, cell: Cell) -> None:
    world.store.assets.change({"bench-1": AXLE}, 1)
    assert (await world.client("admin").delete(f"{ASSETS}/bench-1")).status_code == 204
    assert world.store.assets.get("bench-1") is None


@pytest.mark.parametrize(
    ("table", "pointers"),
    [
        ({"template": "axel"}, ["/template"]),
        ({"template": "axle"}, ["/values/unit"]),
        ({"template": "axle", "values": {"unit": "x"}}, ["/channels/t_outer_ring_c/unit_id"]),
        ({"template": "axle", "values": {"unit": 300}}, ["/channels/t_outer_ring_c/unit_id"]),
        (AXLE | {"colour": "red", "group": 7}, ["/group", "/colour"]),
        (AXLE | {"id": "axle-2"}, ["/id"]),
        (AXLE | {"channels": {"load_n": {"source": "drive"}}}, ["/channels/load_n/source"]),
        ({}, ["/low_risk", "/channels", "/bearing"]),
        (AXLE | {"name": "a\0b"}, [""]),
    ],
)
async def test_every_wrong_key_is_named(
    world: Any, cell: Cell, table: dict[str, Any], pointers: list[str]
) -> None:
    refused = await world.client("admin").put(f"{ASSETS}/axle-1", json=table)
    assert refused.status_code == 422
    errors = refused.json()["errors"]
    assert sorted(error["pointer"] for error in errors) == sorted(pointers)
    assert all(error["detail"] for error in errors)
    assert (audit(world), cell.asked) == ([], 0)
    assert world.store.assets.present() == []


@pytest.mark.parametrize(
    "body", [b"", b"[]", b"3", b"null", b"{", b'{"a": ' * 5000, b'{"gain": 1e999}', b'{"n": NaN}']
)
async def test_what_is_no_table_is_refused(world: Any, cell: Cell, body: bytes) -> None:
    json_body = {"Content-Type": "application/json"}
    for method in ("PUT", "PATCH"):
        world.store.assets.change({"axle-1": AXLE}, 1)
        refused = await world.client("admin").request(
            method, f"{ASSETS}/axle-1", content=body, headers=json_body
        )
        assert refused.status_code in (400, 422), refused.text
        assert refused.json()["detail"]
    assert world.store.assets.get("axle-1").table == AXLE


async def test_an_id_that_is_none_is_refused(world: Any, cell: Cell) -> None:
    for name in ("-x", "a b", "ä", "x" * 65):
        refused = await world.client("admin").put(f"{ASSETS}/{name}", json=AXLE)
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["parameter"] == "asset_id"


@pytest.mark.parametrize(
    "away",
    [CellUnavailableError("it is being started"), StoreUnavailableError("the cell's disk is full")],
)
async def test_a_cell_that_is_away_takes_a_change_up_later(
    world: Any, cell: Cell, away: Exception
) -> None:
    cell.away = away
    admin = world.client("admin")
    kept = await admin.put(f"{ASSETS}/axle-1", json=AXLE)
    assert kept.status_code == 202
    assert kept.json()["table"] == AXLE
    assert "cell" in kept.json()["not_running"]
    assert world.store.assets.get("axle-1").table == AXLE
    listed = await admin.post(IMPORT, json={"assets": [{"id": "axle-2"} | AXLE]})
    assert (listed.status_code, listed.json()["created"]) == (202, 1)
    assert (await admin.delete(f"{ASSETS}/axle-1")).status_code == 202
    assert world.store.assets.get("axle-1") is None


async def test_what_the_cell_cannot_follow_is_said(world: Any, cell: Cell) -> None:
    cell.wrong = {"axle-1": "its model is damaged", "another": "of before"}
    admin = world.client("admin")
    kept = await admin.put(f"{ASSETS}/axle-1", json=AXLE)
    assert (kept.status_code, kept.json()["not_running"]) == (202, "its model is damaged")
    other = AXLE | {"name": "Axle"}
    listed = await admin.post(IMPORT, json={"assets": [{"id": "axle-1"} | other]})
    assert listed.json()["not_running"] == {"axle-1": "its model is damaged"}


async def test_two_who_merge_at_once_lose_nothing(world: Any, cell: Cell) -> None:
    """A merge is made of what is there when it is written, or made again."""
    world.store.assets.change({"axle-1": AXLE}, 1)
    found = world.store.assets.get("axle-1")
    read = asyncio.Event()
    store, get = world.store.assets, world.store.assets.get
    others = iter(["group"])

    def get_and_be_overtaken(asset_id: str) -> Any:
        before = get(asset_id)
        for key in others:
            read.set()
            store.change({asset_id: before.table | {key: "North"}}, 2)
        return before

    store.get = get_and_be_overtaken
    try:
        patched = await world.client("admin").patch(f"{ASSETS}/axle-1", json={"name": "Axle"})
    finally:
        del store.get
    assert read.is_set()
    assert patched.status_code == 200
    assert get("axle-1").table == AXLE | {"group": "North", "name": "Axle"}
    assert get("axle-1").revision > found.revision + 1


async def test_who_only_adds_overwrites_nothing(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    # It is kept, and does not run: the boundary to the cell follows nothing.
    world.store.assets.change({"axle-1": AXLE | {"name": "kept"}}, 1)
    for table in (AXLE, AXLE | {"name": "kept"}):
        refused = await admin.put(f"{ASSETS}/axle-1", json=table, headers=ONLY_NEW)
        assert refused.status_code == 412
        assert refused.json()["errors"][0]["parameter"] == "asset_id"
    assert world.store.assets.get("axle-1").table["name"] == "kept"
    assert (audit(world), cell.asked) == ([], 0)
    other = {"If-None-Match": '"7"'}
    assert (await admin.put(f"{ASSETS}/axle-1", json=AXLE, headers=other)).status_code == 422
    # One that was removed is no more in the way.
    world.store.assets.change({"axle-1": None}, 2)
    made = await admin.put(f"{ASSETS}/axle-1", json=AXLE, headers=ONLY_NEW)
    assert made.status_code == 201


async def test_of_two_who_add_the_same_at_once_one_is_told(world: Any, cell: Cell) -> None:
    store, get = world.store.assets, world.store.assets.get

    def get_and_be_overtaken(asset_id: str) -> Any:
        before = get(asset_id)
        store.change({asset_id: AXLE | {"name": "first"}}, 2)
        return before

    store.get = get_and_be_overtaken
    try:
        late = await world.client("admin").put(f"{ASSETS}/axle-1", json=AXLE, headers=ONLY_NEW)
    finally:
        del store.get
    assert late.status_code == 412
    assert get("axle-1").table["name"] == "first"


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
@pytest.mark.parametrize(
    ("target", "patch", "result"),
    [
        ({"a": "b"}, {"a": "c"}, {"a": "c"}),
        ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
        ({"a": "b"}, {"a": None}, {}),
        ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
        ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
        ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
        ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
        ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
        (["a", "b"], ["c", "d"], ["c", "d"]),
        ({"a": "b"}, ["c"], ["c"]),
        ({"a": "foo"}, None, None),
        ({"a": "foo"}, "bar", "bar"),
        ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
        ([1, 2], {"a": "b", "c": None}, {"a": "b"}),
        ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
    ],
)
def test_a_patch_merges_as_the_standard_says(target: Any, patch: Any, result: Any) -> None:
    assert merge_patch(target, patch) == result


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


async def test_templates_and_assets_are_listed_in_pages(world: Any, cell: Cell) -> None:
    world.store.assets.change({f"axle-{n}": AXLE for n in range(5)}, 1)
    found: list[str] = []
    address: str | None = "/api/v1/provisioning?limit=2"
    client = world.client("engineer")
    while address:
        answer = await client.get(address)
        page = answer.json()
        assert page["templates"] == [
            {
                "name": "axle",
                "asks_for": ["gateway", "unit"],
                "values": {"gateway": "gateway-1"},
            }
        ]
        found += [item["id"] for item in page["items"]]
        address = answer.headers["link"][1:].partition(">")[0] if page["next"] else None
    assert found == [f"axle-{n}" for n in range(5)]


async def test_every_answer_is_as_published(world: Any, cell: Cell) -> None:
    description = (await world.client().get("/openapi.json")).json()
    admin = world.client("admin")
    mixed = {"assets": [{"id": "b"} | AXLE, {"id": "c"}]}
    calls = [
        ("put", "/assets/{asset_id}", await admin.put(f"{ASSETS}/axle-1", json=AXLE)),
        ("patch", "/assets/{asset_id}", await admin.patch(f"{ASSETS}/axle-1", json={"name": "A"})),
        ("post", "/assets:import", await admin.post(f"{IMPORT}?partial=true", json=mixed)),
        ("post", "/assets:remove", await admin.post(REMOVE, json={"ids": ["axle-1"]})),
        ("get", "/assets/{asset_id}/configuration", await admin.get(f"{ASSETS}/b/configuration")),
        ("get", "/provisioning", await admin.get("/api/v1/provisioning")),
    ]
    for method, path, answer in calls:
        operation = description["paths"][f"/api/v1{path}"][method]
        assert answer.is_success, answer.text
        content = operation["responses"][str(answer.status_code)]["content"]
        schema = content["application/json"]["schema"] | {"components": description["components"]}
        assert [str(error) for error in jsonschema_rs.iter_errors(schema, answer.json())] == []


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
        world.client("admin").post(IMPORT, json={"assets": listed}, timeout=600)
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
