"""What HTTP lets callers write in more than one way."""

import json
from typing import Any
from urllib.parse import unquote

import pytest

from service.web.api.http_forms import HttpForms, takes_gzip

EXPORT = "/openapi.json"
SNAPSHOT = "/api/v1/assets/bench-1/snapshot"


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["gzip"], True),
        (["gzip, deflate, br"], True),
        (["deflate", "gzip;q=0.5"], True),
        (["x-gzip"], True),
        (["gzip;q=1.0, identity; q=0.5, *;q=0"], True),
        (["gzip;q=0"], False),
        (["GZIP; Q=0.000"], False),
        (["identity, gzip;q=0"], False),
        (["identity, gzip;q=0.5"], False),
        (["gzip;q=often"], False),
        (["notgzip"], False),
        (["identity"], False),
        ([""], False),
    ],
)
def test_gzip_goes_to_those_who_take_it(lines: list[str], expected: bool) -> None:
    assert takes_gzip(lines) is expected


@pytest.mark.parametrize(("coding", "expected"), [("gzip", "gzip"), ("gzip;q=0", None)])
async def test_a_refused_coding_is_not_used(world: Any, coding: str, expected: str | None) -> None:
    answer = await world.client("viewer").get(EXPORT, headers={"Accept-Encoding": coding})
    assert (answer.status_code, answer.headers.get("content-encoding")) == (200, expected)
    assert answer.headers["vary"] == "Accept-Encoding"
    assert json.loads(answer.content)


@pytest.mark.parametrize("path", ["/", "/livez", "/metrics", EXPORT, SNAPSHOT, "/js/api.js"])
async def test_head_says_what_get_says_without_a_body(world: Any, path: str) -> None:
    viewer = world.client("viewer")
    got, head = await viewer.get(path), await viewer.head(path)
    assert (head.status_code, head.content) == (got.status_code, b"")
    assert head.headers["content-type"] == got.headers["content-type"]
    assert "content-length" in head.headers


async def test_head_asks_for_a_key_and_makes_nothing(world: Any) -> None:
    assert (await world.client().head(SNAPSHOT)).status_code == 401
    answer = await world.client("operator").head("/api/v1/alarms/1/acknowledge")
    assert answer.status_code == 405
    refused = await world.client("viewer").patch(SNAPSHOT)
    assert refused.headers["allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    ("target", "path", "host"),
    [
        (b"/livez", "/livez", b"other"),
        (b"http://bench.example:8080/livez", "/livez", b"bench.example:8080"),
        (b"HTTP://bench.example/a%2Fb/c", "/a/b/c", b"bench.example"),
        (b"https://bench.example", "/", b"bench.example"),
        (b"wss://bench.example/api/v1/stream", "/api/v1/stream", b"bench.example"),
        (b"http://[/livez", "http://[/livez", b"other"),
        (b"*", "*", b"other"),
    ],
)
@pytest.mark.parametrize("kind", ["http", "websocket"])
async def test_a_whole_address_is_a_path_of_its_host(
    target: bytes, path: str, host: bytes, kind: str
) -> None:
    found: list[Any] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        found.append((scope["path"], dict(scope["headers"])[b"host"]))

    scope = {
        "type": kind,
        "method": "GET",
        "path": unquote(target.decode()),
        "raw_path": target,
        "headers": [(b"host", b"other")],
    }
    await HttpForms(app)(scope, receive=None, send=None)  # type: ignore[arg-type]
    assert found == [(path, host)]


async def test_a_body_in_another_encoding_is_named(world: Any) -> None:
    answer = await world.client("engineer").post(
        "/api/v1/assets/bench-1/identifications",
        content='{"comment": "Prüfstand"}'.encode("latin-1"),
        headers={"Content-Type": "application/json"},
    )
    assert (answer.status_code, answer.json()["detail"]) == (422, "body: expected UTF-8")
