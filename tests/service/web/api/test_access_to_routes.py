"""Every route with every role, and without a key."""

import re
from typing import Any

import httpx2
import pytest
from fastapi.routing import APIRoute, APIWebSocketRoute, iter_route_contexts
from patience import patience

from service.security.keys import create_key, revoke_key

UNLISTED = {
    ("HEAD", "/livez"),
    ("HEAD", "/readyz"),
    ("GET", "/docs"),
    ("GET", "/asyncapi.json"),
}
PUBLIC = UNLISTED | {
    ("GET", "/livez"),
    ("GET", "/readyz"),
    ("POST", "/api/v1/session"),
}
CHAIN = ("viewer", "operator", "engineer", "admin")
# Least role of the chain for each call, as the contract has it.
LEAST = {
    ("GET", "/api/v1/assets"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}"): "viewer",
    ("PUT", "/api/v1/assets/{asset_id}"): "admin",
    ("PATCH", "/api/v1/assets/{asset_id}"): "admin",
    ("DELETE", "/api/v1/assets/{asset_id}"): "admin",
    ("POST", "/api/v1/assets:import"): "admin",
    ("POST", "/api/v1/assets:remove"): "admin",
    ("GET", "/api/v1/assets/{asset_id}/configuration"): "engineer",
    ("GET", "/api/v1/provisioning"): "engineer",
    ("GET", "/api/v1/provisioning/removed"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/snapshot"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/state"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/verdict"): "viewer",
    ("POST", "/api/v1/assets/{asset_id}/grease-renewed"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/measurements"): "viewer",
    ("POST", "/api/v1/assets/{asset_id}/measurements"): "admin",
    ("POST", "/api/v1/measurements"): "admin",
    ("POST", "/api/v1/write"): "admin",
    ("GET", "/api/v1/assets/{asset_id}/forecast"): "viewer",
    ("POST", "/api/v1/assets/{asset_id}/forecasts"): "operator",
    ("GET", "/api/v1/assets/{asset_id}/forecasts"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/forecast-performance"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/envelope"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/advice"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/windows"): "engineer",
    ("POST", "/api/v1/assets/{asset_id}/identifications"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/identifications"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/identifications/{job_id}"): "engineer",
    ("DELETE", "/api/v1/assets/{asset_id}/identifications/{job_id}"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/models"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/models/{version}"): "engineer",
    ("POST", "/api/v1/assets/{asset_id}/models/{version}/activate"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/models/activations"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/drift"): "engineer",
    ("GET", "/api/v1/assets/{asset_id}/sisters"): "engineer",
    ("GET", "/api/v1/commissioning"): "admin",
    ("POST", "/api/v1/commissioning/units"): "admin",
    ("POST", "/api/v1/commissioning/registers"): "admin",
    ("POST", "/api/v1/commissioning/dbc"): "admin",
    ("POST", "/api/v1/commissioning/signals"): "admin",
    ("POST", "/api/v1/commissioning/check"): "admin",
    ("PUT", "/api/v1/commissioning/configuration"): "admin",
    ("GET", "/api/v1/commissioning/versions"): "admin",
    ("POST", "/api/v1/commissioning/versions/{number}/restore"): "admin",
    ("GET", "/api/v1/assets/{asset_id}/runs"): "viewer",
    ("GET", "/api/v1/assets/{asset_id}/runs/{run_id}"): "viewer",
    ("PATCH", "/api/v1/assets/{asset_id}/runs/{run_id}"): "operator",
    ("GET", "/api/v1/assets/{asset_id}/runs/{run_id}/report"): "viewer",
    ("POST", "/api/v1/assets/{asset_id}/runs/{run_id}/annotations"): "operator",
    ("DELETE", "/api/v1/assets/{asset_id}/runs/{run_id}/annotations/{annotation_id}"): "operator",
    ("GET", "/api/v1/fleet"): "viewer",
    ("GET", "/api/v1/fleet/map"): "viewer",
    ("GET", "/api/v1/fleet/nights"): "engineer",
    ("GET", "/api/v1/alarms"): "viewer",
    ("GET", "/api/v1/alarms/journal"): "viewer",
    ("GET", "/api/v1/alarms/statistics"): "viewer",
    ("POST", "/api/v1/alarms/acknowledge"): "operator",
    ("POST", "/api/v1/alarms/{alarm_id}/acknowledge"): "operator",
    ("GET", "/api/v1/keys"): "admin",
    ("POST", "/api/v1/keys"): "admin",
    ("DELETE", "/api/v1/keys/{key_id}"): "admin",
    ("GET", "/api/v1/audit"): "admin",
    ("POST", "/api/v1/alarms/{alarm_id}/shelve"): "operator",
    ("POST", "/api/v1/alarms/{alarm_id}/unshelve"): "operator",
    ("POST", "/api/v1/alarms/{alarm_id}/reset"): "operator",
    ("POST", "/api/v1/alarms/{alarm_id}/comment"): "operator",
    ("POST", "/api/v1/alarms/{alarm_id}/out-of-service"): "engineer",
    ("POST", "/api/v1/alarms/{alarm_id}/return-to-service"): "engineer",
    ("GET", "/api/v1/notifications"): "viewer",
    ("POST", "/api/v1/notifications/{notification_id}:test"): "engineer",
    ("GET", "/api/v1/alarm-settings"): "viewer",
    ("PATCH", "/api/v1/alarm-settings"): "engineer",
    ("POST", "/api/v1/alarm-settings/import"): "engineer",
    ("GET", "/api/v1/alarm-settings/history"): "viewer",
    ("GET", "/api/v1/silences"): "viewer",
    ("POST", "/api/v1/silences"): "operator",
    ("POST", "/api/v1/silences/end"): "operator",
    ("DELETE", "/api/v1/silences/{silence_id}"): "operator",
    ("GET", "/api/v1/session"): "viewer",
    ("DELETE", "/api/v1/session"): "viewer",
    ("GET", "/api/v1/stream"): "viewer",
    ("GET", "/metrics"): "viewer",
}
GATEWAY = {
    ("GET", "/api/v1/assets"),
    ("GET", "/api/v1/assets/{asset_id}"),
    ("POST", "/api/v1/assets/{asset_id}/measurements"),
    ("POST", "/api/v1/measurements"),
    ("POST", "/api/v1/write"),
}
REFUSED = (401, 403)


def calls(app: Any) -> set[tuple[str, str]]:
    return {
        (method, route.path)
        for route in iter_route_contexts(app.routes)
        if isinstance(route.original_route, APIRoute)
        for method in route.methods
    }


async def call(
    client: httpx2.AsyncClient, method: str, path: str, headers: dict[str, str] | None = None
) -> httpx2.Response:
    values = {"asset_id": "bench-1", "version": "1"}
    address = re.sub(r"{(\w+)}", lambda match: values.get(match[1], "none"), path)
    body = {"json": {}} if method == "POST" else {}
    return await client.request(method, address, headers=headers, **body)


def test_table_names_every_call_and_only_those(world: Any) -> None:
    assert calls(world.app) == PUBLIC | LEAST.keys()


def test_the_only_websocket_is_the_stream(world: Any) -> None:
    paths = [
        route.path
        for route in iter_route_contexts(world.app.routes)
        if isinstance(route.original_route, APIWebSocketRoute)
    ]
    assert paths == ["/api/v1/stream"]


async def test_without_a_key_only_public_calls_are_answered(world: Any) -> None:
    for method, path in calls(world.app):
        response = await call(world.client(), method, path)
        if (method, path) in PUBLIC:
            assert response.status_code not in REFUSED, (method, path)
        else:
            assert response.status_code == 401, (method, path)
            assert response.headers["content-type"] == "application/problem+json"
            assert response.headers["www-authenticate"].startswith("Basic")


@pytest.mark.parametrize("role", CHAIN)
async def test_role_of_the_chain_may_do_what_is_in_the_table(world: Any, role: str) -> None:
    for (method, path), least in LEAST.items():
        response = await call(world.client(role), method, path)
        allowed = CHAIN.index(role) >= CHAIN.index(least)
        assert (response.status_code not in REFUSED) == allowed, (method, path, response.text)
        if not allowed:
            assert response.status_code == 403
            assert f"role {role}" in response.json()["detail"]


@pytest.mark.parametrize("ended", ["revoked", "expired"])
async def test_a_key_that_has_ended_opens_nothing(world: Any, ended: str) -> None:
    key = create_key(world.store, "admin", expires_in_days=1e-9 if ended == "expired" else None)
    if ended == "revoked":
        revoke_key(world.store, key.record.id)
    for method, path in LEAST:
        response = await call(world.client(), method, path, {"X-API-Key": key.text})
        assert response.status_code == 401, (method, path)


async def test_gateway_pushes_and_reads_assets_and_nothing_else(world: Any) -> None:
    for method, path in LEAST:
        response = await call(world.client("gateway"), method, path)
        allowed = (method, path) in GATEWAY
        assert (response.status_code not in REFUSED) == allowed, (method, path)


async def test_unknown_path_of_the_api_tells_nothing_without_a_key(world: Any) -> None:
    assert (await world.client().get("/api/v1/secrets")).status_code == 401
    assert (await world.client("viewer").get("/api/v1/secrets")).status_code == 404


async def test_body_is_not_even_read_without_a_key(world: Any) -> None:
    response = await world.client().post(
        "/api/v1/assets/bench-1/forecasts",
        content=b"{not json",
        headers={"Content-Type": "application/json"},
    )
    assert response.status_code == 401


@pytest.mark.parametrize("user", ["", "anyone"])
async def test_basic_password_is_as_good_as_the_header(world: Any, user: str) -> None:
    client = world.client(auth=(user, world.keys["viewer"]))
    assert (await client.get("/api/v1/assets")).status_code == 200
    assert (await client.post("/api/v1/alarms/x/acknowledge")).status_code == 403


@pytest.mark.parametrize(
    "authorization", ["Basic", "Basic %%%", "Basic YQ==", "Bearer x", "Basic /w=="]
)
async def test_malformed_credentials_are_no_credentials(world: Any, authorization: str) -> None:
    response = await world.client().get("/api/v1/assets", headers={"Authorization": authorization})
    assert response.status_code == 401


async def test_a_wrong_key_is_not_saved_by_a_good_session(world: Any) -> None:
    client = world.client(timeout=patience(5))
    await client.post("/api/v1/session", json={"key": world.keys["viewer"]})
    assert (await client.get("/api/v1/assets")).status_code == 200
    wrong = {"X-API-Key": world.keys["viewer"][:-1] + "!"}
    assert (await client.get("/api/v1/assets", headers=wrong)).status_code == 401


async def test_scripts_of_a_page_get_no_password_prompt(world: Any) -> None:
    response = await world.client().get("/api/v1/assets", headers={"Sec-Fetch-Mode": "cors"})
    assert response.headers["www-authenticate"].startswith("ApiKey")


async def test_openapi_lists_every_call_with_its_security(world: Any) -> None:
    schema = (await world.client().get("/openapi.json")).json()
    listed = {
        (method.upper(), path): operation
        for path, item in schema["paths"].items()
        for method, operation in item.items()
    }
    assert listed.keys() == (PUBLIC | LEAST.keys()) - UNLISTED
    for name, operation in listed.items():
        schemes = {scheme for one in operation["security"] for scheme in one}
        assert schemes == (set() if name in PUBLIC else {"key", "basic", "session"}), name
        if name not in PUBLIC:
            least = set(CHAIN[CHAIN.index(LEAST[name]) :])
            expected = least | ({"gateway"} if name in GATEWAY else set())
            assert set(operation["x-roles"]) == expected, name
    assert set(schema["components"]["securitySchemes"]) == {"key", "basic", "session"}
    assert "HTTPValidationError" not in schema["components"]["schemas"]
