from typing import Any

import httpx2
import pytest
from patience import patience

from service.documents.access import SessionDocument
from service.security.keys import revoke_key

SESSION = "/api/v1/session"
ACKNOWLEDGE = "/api/v1/alarms/none/acknowledge"
PAGE = {"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}


async def logged_in(world: Any, role: str = "operator", **options: Any) -> httpx2.AsyncClient:
    client: httpx2.AsyncClient = world.client(timeout=patience(7), **options)
    response = await client.post(SESSION, json={"key": world.keys[role]}, headers=PAGE)
    assert response.status_code == 200, response.text
    return client


async def test_log_in_sets_a_cookie_that_scripts_cannot_read(world: Any) -> None:
    client = world.client()
    response = await client.post(SESSION, json={"key": world.keys["operator"]})
    document = SessionDocument.model_validate(response.json())
    assert (document.role, document.session) == ("operator", True)
    cookie = response.headers["set-cookie"]
    assert cookie.startswith("bearing_twin_8080=")
    for attribute in ("HttpOnly", "SameSite=strict", "Path=/"):
        assert attribute in cookie
    assert "Secure" not in cookie
    assert world.keys["operator"] not in cookie + response.text


async def test_cookie_is_secure_over_https(world: Any) -> None:
    client = world.client(base_url="https://bench.example")
    response = await client.post(SESSION, json={"key": world.keys["viewer"]})
    assert "Secure" in response.headers["set-cookie"]
    assert response.headers["set-cookie"].startswith("__Host-bearing_twin_443=")
    assert (await client.get(SESSION)).status_code == 200
    ended = (await client.delete(SESSION, headers=PAGE)).headers["set-cookie"]
    assert ended.startswith("__Host-bearing_twin_443=")
    assert "Secure" in ended


async def test_session_opens_what_its_key_opens(world: Any) -> None:
    client = await logged_in(world)
    assert (await client.get(SESSION)).json()["role"] == "operator"
    assert (await client.get("/api/v1/assets")).status_code == 200
    assert (await client.get("/api/v1/assets/bench-1/models")).status_code == 403


async def test_log_out_ends_the_session_at_once(world: Any) -> None:
    client = await logged_in(world)
    cookie = dict(client.cookies)
    assert (await client.delete(SESSION, headers=PAGE)).status_code == 204
    assert not client.cookies
    kept = "; ".join(f"{name}={value}" for name, value in cookie.items())
    assert (await client.get("/api/v1/assets", headers={"Cookie": kept})).status_code == 401


async def test_revoking_the_key_ends_its_sessions(world: Any) -> None:
    client = await logged_in(world)
    revoke_key(world.store, world.keys["operator"][:11])
    world.app.state.authenticator._memory.clear()  # as a second later
    assert (await client.get("/api/v1/assets")).status_code == 401


@pytest.mark.parametrize("key", ["", "bt_00000000_" + "A" * 43, "bt_", "x" * 200])
async def test_wrong_key_opens_no_session(world: Any, key: str) -> None:
    response = await world.client().post(SESSION, json={"key": key})
    assert response.status_code == 401
    assert "set-cookie" not in response.headers


async def test_gateway_opens_no_session(world: Any) -> None:
    response = await world.client().post(SESSION, json={"key": world.keys["gateway"]})
    assert response.status_code == 403


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({"Sec-Fetch-Site": "same-origin"}, True),
        ({"Sec-Fetch-Site": "same-site"}, False),
        ({"Sec-Fetch-Site": "cross-site"}, False),
        ({"Sec-Fetch-Site": "none"}, False),
        ({"Origin": "http://bench.example:8080"}, True),
        ({"Origin": "http://bench.example:8081"}, False),
        ({"Origin": "http://evil.example"}, False),
        ({"Origin": "null"}, False),
        ({}, False),
    ],
)
async def test_session_changes_things_from_our_own_page_only(
    world: Any, headers: dict[str, str], allowed: bool
) -> None:
    client = await logged_in(world)
    response = await client.post(ACKNOWLEDGE, headers=headers)
    assert response.status_code == (404 if allowed else 403)
    reading = await client.get("/api/v1/assets", headers=headers)
    assert reading.status_code == 200


@pytest.mark.parametrize(
    "headers",
    [{"Sec-Fetch-Site": "cross-site"}, {"Origin": "http://["}, {"Origin": "http://a:b"}],
)
async def test_another_site_cannot_log_a_browser_in(world: Any, headers: dict[str, str]) -> None:
    response = await world.client().post(
        SESSION, json={"key": world.keys["viewer"]}, headers=headers
    )
    assert response.status_code == 403


async def test_key_in_a_header_needs_no_origin(world: Any) -> None:
    response = await world.client("operator").post(ACKNOWLEDGE)
    assert response.status_code == 404


async def test_sessions_of_two_ports_do_not_disturb_each_other(world: Any) -> None:
    first = await logged_in(world)
    cookie = "; ".join(f"{name}={value}" for name, value in first.cookies.items())
    other_port = world.client(base_url="http://bench.example:9090")
    response = await other_port.get("/api/v1/assets", headers={"Cookie": cookie})
    assert response.status_code == 401
