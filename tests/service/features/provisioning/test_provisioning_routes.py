"""Assets that are made, changed and removed by REST: kept whole, audited, and taken up at once."""

import asyncio
from typing import Any

import jsonschema_rs
import pytest

from adapters.samples import Sample
from service.alarms.records import event_line
from service.clock import rfc3339
from service.domain.errors import CellUnavailableError
from service.features.provisioning.asset_routes import merge_patch
from service.store import StoreUnavailableError

from .provisioned import (
    ASSETS,
    AXLE,
    IMPORT,
    ONLY_NEW,
    PROVISIONING,
    REMOVE,
    Cell,
    audit,
)


@pytest.mark.parametrize("char", ["\n", "\x1b", "\u202e"])
async def test_a_name_is_one_line_of_visible_characters(world: Any, cell: Cell, char: str) -> None:
    admin = world.client("admin")
    answer = await admin.put(f"{ASSETS}/axle-1", json=AXLE | {"name": f"a{char}b"})
    assert answer.status_code == 422
    expected = "expected one line of text, without control characters"
    assert answer.json()["detail"] == f"name = {f'a{char}b'!r}: {expected}"
    # What was stored before is served, and can get another name.
    world.store.assets.change({"axle-1": AXLE | {"name": f"a{char}b"}}, 1)
    read = await world.client("engineer").get(f"{ASSETS}/axle-1/configuration")
    assert read.json()["table"]["name"] == f"a{char}b"
    assert (await admin.put(f"{ASSETS}/axle-1", json=AXLE | {"name": "ab"})).status_code == 200


async def test_half_of_a_surrogate_pair_as_an_id_is_answered(world: Any, cell: Cell) -> None:
    answer = await world.client("admin").post(
        IMPORT,
        content=b'{"assets": [{"id": "\\ud800"}]}',
        headers={"Content-Type": "application/json"},
    )
    assert answer.status_code == 422
    assert "not valid JSON" in answer.json()["detail"]


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
        (AXLE | {"name": "a\0b"}, ["/name"]),
        (AXLE | {"colour": "a\0b"}, ["/colour"]),
        (AXLE | {"channels": {"load_n": {"source": "a\0b"}}}, [""]),
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


async def test_the_history_of_a_removed_asset_can_be_read(world: Any, cell: Cell) -> None:
    admin, viewer = world.client("admin"), world.client("viewer")
    store, now_us = world.store, world.clock.now_us()
    assert (await admin.put(f"{ASSETS}/axle-1", json=AXLE)).is_success
    for name in ("axle-1", "of-an-older-file"):
        store.samples.write([Sample(name, "load_n", now_us - 1_000_000, 7.0, 192, now_us)])
    store.alarms.save(None, [event_line("axle-1", "asset not followed", "gone", now_us, "service")])
    removed = f"{PROVISIONING}/removed"
    assert [one["id"] for one in (await viewer.get(removed)).json()["items"]] == [
        "of-an-older-file"
    ]
    assert (await admin.delete(f"{ASSETS}/axle-1")).status_code == 204
    items = (await viewer.get(removed)).json()["items"]
    assert [one["id"] for one in items] == ["axle-1", "of-an-older-file"]
    assert items[0]["removed_at"] == rfc3339(store.assets.once_removed()[0].removed_us)
    assert items[1]["removed_at"] is None

    for name in ("axle-1", "of-an-older-file"):
        history = await viewer.get(f"{ASSETS}/{name}/measurements")
        assert [one["value"] for one in history.json()["items"]] == [7.0], history.text
        csv = await viewer.get(f"{ASSETS}/{name}/measurements", params={"format": "csv"})
        assert f'filename="{name}-measurements.csv"' in csv.headers["content-disposition"]
        for part in ("runs", "forecasts", "forecast-performance"):
            assert (await viewer.get(f"{ASSETS}/{name}/{part}")).status_code == 200
        engineer = world.client("engineer")
        assert (await engineer.get(f"{ASSETS}/{name}/models")).json()["items"] == []
        # What is of the present machine is not there.
        assert (await viewer.get(f"{ASSETS}/{name}/snapshot")).status_code == 404
        pushed = {"samples": [{"channel": "load_n", "time": rfc3339(now_us), "value": 1.0}]}
        gateway = world.client("gateway")
        answer = await gateway.post(f"{ASSETS}/{name}/measurements", json=pushed)
        assert answer.status_code == 404
    journal = await viewer.get("/api/v1/alarms/journal", params={"asset": "axle-1"})
    assert [one["message"] for one in journal.json()["items"]] == ["gone"]
    wrong = await viewer.get(f"{ASSETS}/axle-1/measurements", params={"channel": "speed_rpm"})
    assert wrong.status_code == 422
    assert "expected one of load_n" in wrong.json()["detail"]
    assert (await viewer.get(f"{ASSETS}/never-there/measurements")).status_code == 404


async def test_a_name_with_a_line_break_is_refused(world: Any, cell: Cell) -> None:
    admin = world.client("admin")
    put = await admin.put(f"{ASSETS}/axle-1", json=AXLE | {"name": "two\nlines"})
    assert (put.status_code, put.json()["errors"][0]["pointer"]) == (422, "/name")
    assert (await admin.put(f"{ASSETS}/axle-1", json=AXLE)).status_code == 201
    patch = await admin.patch(f"{ASSETS}/axle-1", json={"group": "two\nlines"})
    assert (patch.status_code, patch.json()["errors"][0]["pointer"]) == (422, "/group")
