"""Whose word on the caller's address is taken: that of named proxies, and only an address."""

from typing import Any

import httpx2
import pytest
from starlette.requests import Request
from starlette.responses import JSONResponse

from service.site.settings import ServiceSection
from service.web.api.proxies import KnownProxies

PROXY = "192.0.2.1"
WRONG = "bt_00000000_" + "A" * 41


@pytest.mark.parametrize(
    ("peer", "headers", "seen"),
    [
        (PROXY, {"X-Forwarded-For": "203.0.113.9"}, ("203.0.113.9", "http")),
        (PROXY, {"X-Forwarded-For": "203.0.113.9", "X-Forwarded-Proto": "https"},
         ("203.0.113.9", "https")),
        (PROXY, {"X-Forwarded-For": "198.51.100.1, 203.0.113.9"}, ("203.0.113.9", "http")),
        (PROXY, {"X-Forwarded-For": "203.0.113.9, 10.1.2.3"}, ("203.0.113.9", "http")),
        (PROXY, {"X-Forwarded-For": "2001:DB8:0::9"}, ("2001:db8::9", "http")),
        (PROXY, {"X-Forwarded-For": "=cmd|' /C calc'!A0"}, (PROXY, "http")),
        (PROXY, {"X-Forwarded-For": "<script>"}, (PROXY, "http")),
        (PROXY, {"X-Forwarded-For": ""}, (PROXY, "http")),
        (PROXY, {}, (PROXY, "http")),
        ("127.0.0.1", {"X-Forwarded-For": "203.0.113.9", "X-Forwarded-Proto": "https"},
         ("127.0.0.1", "http")),
        ("203.0.113.9", {"X-Forwarded-For": "127.0.0.1"}, ("203.0.113.9", "http")),
    ],
)  # fmt: skip
async def test_only_named_proxies_are_believed(
    peer: str, headers: dict[str, str], seen: tuple[str, str]
) -> None:
    async def show(scope: Any, receive: Any, send: Any) -> None:
        request = Request(scope)
        assert request.client is not None
        answer = JSONResponse([request.client.host, request.url.scheme])
        await answer(scope, receive, send)

    app = KnownProxies(show, [PROXY, "10.0.0.0/8"])
    transport = httpx2.ASGITransport(app, client=(peer, 1))  # type: ignore[arg-type]
    async with httpx2.AsyncClient(transport=transport, base_url="http://bench.example") as client:
        assert tuple((await client.get("/", headers=headers)).json()) == seen


async def test_forged_addresses_do_not_pass_the_limit_nor_reach_the_audit_trail(world: Any) -> None:
    client = world.client(address=("127.0.0.1", 40_000))
    answers = []
    for number in range(40):
        headers = {
            "X-Forwarded-For": f"203.0.113.{number}, =cmd|' /C calc'!A{number}",
            "X-API-Key": f"{WRONG}{number:02d}",
        }
        answers.append((await client.get("/api/v1/assets", headers=headers)).status_code)
    assert answers == [401] * 10 + [429] * 30
    audit = (await world.client("admin").get("/api/v1/audit?limit=500")).json()["items"]
    refused = [line for line in audit if line["action"] == "key.refuse"]
    assert [line["address"] for line in refused] == ["127.0.0.1"]


def test_a_proxy_is_an_address_or_a_network() -> None:
    assert ServiceSection(trusted_proxies=("::1", "10.0.0.0/24")).trusted_proxies
    with pytest.raises(ValueError, match=r"an address such as 127\.0\.0\.1"):
        ServiceSection(trusted_proxies=("proxy.example",))
    with pytest.raises(ValueError, match="a network such as"):
        ServiceSection(trusted_proxies=("10.0.0.1/24",))
