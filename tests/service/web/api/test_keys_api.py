from typing import Any

import pytest
from patience import patience

from service.documents.access import KeyDocument, NewKeyDocument
from service.security.keys import create_key

KEYS = "/api/v1/keys"


async def test_a_key_is_made_shown_once_and_opens_what_its_role_may(world: Any) -> None:
    admin = world.client("admin")
    asked = {"role": "operator", "expires_in_days": 90, "label": "control room"}
    response = await admin.post(KEYS, json=asked)
    assert response.status_code == 201
    made = NewKeyDocument.model_validate(response.json())
    assert (made.role, made.label, made.revoked_at) == ("operator", "control room", None)
    assert made.key.startswith(made.prefix + "_")
    assert made.expires_at is not None
    assert response.headers["location"] == f"{KEYS}/{made.id}"

    mine = {"X-API-Key": made.key}
    session = (await world.client().get("/api/v1/session", headers=mine)).json()
    assert (session["key_id"], session["label"]) == (made.id, "control room")
    assert (await world.client().get(KEYS, headers=mine)).status_code == 403

    listed = await admin.get(KEYS)
    assert made.key not in listed.text
    newest = KeyDocument.model_validate(listed.json()["items"][0])
    assert newest.model_dump() == made.model_dump(exclude={"key"})


@pytest.mark.parametrize("by", ["id", "prefix"])
async def test_a_revoked_key_opens_nothing_from_the_next_call_on(world: Any, by: str) -> None:
    key = create_key(world.store, "viewer")
    mine = {"X-API-Key": key.text}
    browser = world.client(timeout=patience(3))
    assert (await browser.post("/api/v1/session", json={"key": key.text})).status_code == 200
    assert (await browser.get("/api/v1/assets")).status_code == 200
    assert (await world.client().get("/api/v1/assets", headers=mine)).status_code == 200

    name = key.record.id if by == "id" else key.record.prefix
    for _ in range(2):  # the second time changes nothing
        response = await world.client("admin").delete(f"{KEYS}/{name}")
        assert response.status_code == 200
        assert response.json()["revoked_at"] is not None
    assert (await world.client().get("/api/v1/assets", headers=mine)).status_code == 401
    assert (await browser.get("/api/v1/assets")).status_code == 401


async def test_nobody_locks_himself_out(world: Any) -> None:
    admin = world.client("admin")
    mine = (await admin.get("/api/v1/session")).json()
    for name in (mine["key_id"], mine["prefix"]):
        assert (await admin.delete(f"{KEYS}/{name}")).status_code == 409
    assert (await admin.get(KEYS)).status_code == 200


async def test_revoking_what_there_is_not_says_so(world: Any) -> None:
    response = await world.client("admin").delete(f"{KEYS}/none")
    assert response.status_code == 404
    assert response.json()["errors"][0]["parameter"] == "key_id"


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({}, "/role"),
        ({"role": "root"}, "/role"),
        ({"role": "viewer", "expires_in_days": 0}, "/expires_in_days"),
        ({"role": "viewer", "expires_in_days": 1e9}, "/expires_in_days"),
        ({"role": "viewer", "label": "x" * 101}, "/label"),
        ({"role": "viewer", "label": "two\nlines"}, "/label"),
    ],
)
async def test_a_wrong_request_is_named(world: Any, body: Any, pointer: str) -> None:
    response = await world.client("admin").post(KEYS, json=body)
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == pointer


async def test_keys_come_in_pages(world: Any) -> None:
    admin, seen, path = world.client("admin"), [], f"{KEYS}?limit=2"
    while path:
        response = await admin.get(path)
        document = response.json()
        assert 1 <= len(document["items"]) <= 2
        seen += [key["id"] for key in document["items"]]
        path = response.links["next"]["url"] if document["next"] else ""
    assert seen == [key.id for key in reversed(world.store.access.list_keys())]
    assert (await admin.get(f"{KEYS}?cursor=abc")).status_code == 422
