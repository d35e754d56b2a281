"""What another site has a browser send is refused, whatever the credential."""

from typing import Any

import httpx2
import pytest
from patience import patience

ACKNOWLEDGE = "/api/v1/alarms/none/acknowledge"
SESSION = "/api/v1/session"
REFUSED, DONE = 403, 404  # there is no such alarm

CASES = [
    ({}, True),
    ({"Sec-Fetch-Site": "same-origin"}, True),
    ({"Sec-Fetch-Site": "none"}, True),
    ({"Sec-Fetch-Site": "same-site"}, False),
    ({"Sec-Fetch-Site": "cross-site"}, False),
    ({"Origin": "http://bench.example:8080"}, True),
    ({"Origin": "http://bench.example:8081"}, False),
    ({"Origin": "https://evil.example"}, False),
    ({"Origin": "null"}, False),
]


@pytest.mark.parametrize(("headers", "allowed"), CASES)
@pytest.mark.parametrize("by", ["header", "basic"])
async def test_a_change_from_another_site_is_refused(
    world: Any, by: str, headers: dict[str, str], allowed: bool
) -> None:
    key = world.keys["operator"]
    options = {"auth": ("any", key)} if by == "basic" else {"headers": {"X-API-Key": key}}
    client: httpx2.AsyncClient = world.client(timeout=patience(11), **options)
    answer = await client.post(ACKNOWLEDGE, headers=headers)
    assert answer.status_code == (DONE if allowed else REFUSED)
    assert (await client.get("/api/v1/assets", headers=headers)).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Mode": "navigate"},
        {"Sec-Fetch-Mode": "cors"},
        {"Sec-Fetch-Mode": "no-cors"},
        {"Origin": "http://evil.example"},
    ],
)
async def test_a_browser_is_not_asked_for_a_password_that_it_would_send_everywhere(
    world: Any, headers: dict[str, str]
) -> None:
    answer = await world.client().get("/api/v1/assets", headers=headers)
    assert answer.status_code == 401
    assert "Basic" not in answer.headers["www-authenticate"]
    program = await world.client().get("/api/v1/assets")
    assert program.headers["www-authenticate"].startswith("Basic ")


async def test_log_ins_of_an_address_and_of_a_key_are_counted(world: Any) -> None:
    world.limit("logins", 5)
    body = {"key": world.keys["viewer"]}
    client = world.client(timeout=patience(12))
    answers = [await client.post(SESSION, json=body) for _ in range(5)]
    assert {answer.status_code for answer in answers} == {200}
    assert (await client.post(SESSION, json=body)).status_code == 429  # this address
    other = world.client(address=("203.0.113.77", 1))
    assert (await other.post(SESSION, json=body)).status_code == 429  # this key
    assert (await other.post(SESSION, json={"key": world.keys["admin"]})).status_code == 200
    audit = (await world.client("admin").get("/api/v1/audit?limit=500")).json()["items"]
    began = [line for line in audit if line["action"] == "session.begin"]
    assert len(began) == 2  # one for each key and address; more are counted


async def test_a_gateway_that_logs_in_on_and_on_does_not_fill_the_audit_trail(world: Any) -> None:
    client = world.client(timeout=patience(13))
    for _ in range(60):
        answer = await client.post(SESSION, json={"key": world.keys["gateway"]})
        assert answer.status_code == 403
    audit = (await world.client("admin").get("/api/v1/audit?limit=500")).json()["items"]
    assert len([line for line in audit if line["action"] == "session.refuse"]) == 1


async def test_unknown_sessions_of_an_address_are_counted(world: Any) -> None:
    limit = int(world.app.state.authenticator.strangers.per_minute)
    client, path = world.client(timeout=patience(14)), "/api/v1/assets"
    name = "bearing_twin_8080"

    async def status(cookie: str, client: Any = client) -> int:
        answer = await client.get(path, headers={"Cookie": f"{name}={cookie}"})
        return int(answer.status_code)

    for number in range(limit):
        assert await status(f"{number:043d}") == 401
    assert await status(f"{limit:043d}") == 429
    # What was looked up already, or cannot be a session, costs nothing and is told as ever.
    assert await status(f"{0:043d}") == 401
    assert await status("nonsense") == 401
    assert await status(f"{limit:043d}", world.client(address=("203.0.113.78", 1))) == 401
