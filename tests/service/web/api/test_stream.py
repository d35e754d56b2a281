"""The stream over a real server and real sockets."""

import asyncio
import base64
import contextlib
import json
import socket
import struct
from collections.abc import AsyncIterator, Collection
from dataclasses import replace
from typing import Any

import pytest
import uvicorn
from patience import wait_for, within
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from service.bus.stream import heartbeats
from service.domain.errors import CellUnavailableError
from service.security.keys import revoke_key
from service.web.api.routes import stream
from service.web.shares import Shares

pytestmark = pytest.mark.wires

PATH = "/api/v1/stream"
# Much longer than any of this takes on a machine that does nothing else.
PATIENCE_S = 30.0


class Server:
    """The application of a world on a loopback port."""

    def __init__(self, world: Any) -> None:
        # With the protocol named, asyncio turns off Nagle's delay on what is accepted.
        self.listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self.listener.bind(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        config = uvicorn.Config(
            world.app, log_config=None, access_log=False, timeout_graceful_shutdown=3
        )
        self.server = uvicorn.Server(config)
        self.task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        self.task = asyncio.create_task(self.server.serve(sockets=[self.listener]))
        while not self.server.started:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)

    async def stop(self) -> None:
        self.server.should_exit = True
        if self.task is not None:
            await wait_for(self.task, 30)

    @contextlib.asynccontextmanager
    async def open(
        self, query: str = "", key: str | None = None, **options: Any
    ) -> AsyncIterator[ClientConnection]:
        headers = dict(options.pop("headers", {}))
        if key is not None:
            headers["X-API-Key"] = key
        address = f"ws://127.0.0.1:{self.port}{PATH}{query}"
        async with connect(
            address, additional_headers=headers, proxy=None, open_timeout=PATIENCE_S, **options
        ) as websocket:
            yield websocket


@pytest.fixture
async def server(world: Any) -> AsyncIterator[Server]:
    server = Server(world)
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


async def receive(websocket: ClientConnection, count: int = 1) -> list[dict[str, Any]]:
    async with within(PATIENCE_S):
        return [json.loads(await websocket.recv()) for _ in range(count)]


async def subscribed(world: Any, count: int = 1) -> None:
    async with within(PATIENCE_S):
        while world.bus.subscribers != count:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)


async def test_hello_has_the_snapshot_and_then_come_the_messages(world: Any, server: Any) -> None:
    async with server.open("?assets=bench-1", world.keys["viewer"]) as websocket:
        (hello,) = await receive(websocket)
        assert hello["type"] == "hello"
        assert (hello["asset"], hello["gap"], hello["seq"]) == ("bench-1", False, 0)
        assert hello["epoch"] == world.bus.epoch
        assert hello["data"]["tags"].keys() == world.bench.tags.keys()
        world.bus.publish("state", "rig-2", {})
        world.bus.publish("state", "bench-1", {"time": None})
        world.bus.publish("health", None, {"degraded": False})
        messages = await receive(websocket, 2)
        assert [(m["type"], m["seq"]) for m in messages] == [("state", 2), ("health", 3)]


async def test_each_asset_says_hello(world: Any, server: Any) -> None:
    async with server.open(key=world.keys["viewer"]) as websocket:
        assert [m["asset"] for m in await receive(websocket, 2)] == ["bench-1", "rig-2"]


async def test_who_follows_one_asset_still_hears_the_alarms_of_all(world: Any, server: Any) -> None:
    async with server.open("?live=rig-2", world.keys["viewer"]) as websocket:
        (hello,) = await receive(websocket)
        assert hello["asset"] == "rig-2"
        assert world.bus.followed() == {"rig-2"}
        for asset in ("bench-1", "rig-2"):
            world.bus.publish("verdict", asset, {})
            world.bus.publish("alarm", asset, {})
        messages = await receive(websocket, 3)
        assert [(m["type"], m["asset"]) for m in messages] == [
            ("alarm", "bench-1"),
            ("verdict", "rig-2"),
            ("alarm", "rig-2"),
        ]
    await subscribed(world, 0)
    async with server.open("?live=", world.keys["viewer"]) as websocket:
        (hello,) = await receive(websocket)
        assert (hello["type"], hello["asset"]) == ("hello", None)
        assert world.bus.followed() == frozenset()
    with pytest.raises(InvalidStatus) as refused:
        async with server.open("?live=nobody", world.keys["viewer"]):
            pass
    assert refused.value.response.status_code == 404


@pytest.mark.parametrize(
    "query", ["assets=bench-1&assets=rig-2", "asset=bench-1", "live=rig-2&live=bench-1"]
)
async def test_a_query_that_would_be_ignored_is_refused(
    world: Any, server: Any, query: str
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        async with server.open(f"?{query}", world.keys["viewer"]):
            pass
    assert refused.value.response.status_code == 422


async def test_resume_brings_what_was_missed(world: Any, server: Any) -> None:
    async with server.open("?assets=bench-1", world.keys["viewer"]) as websocket:
        world.bus.publish("measurement", "bench-1", {"samples": []})
        _, seen = await receive(websocket, 2)
    await subscribed(world, 0)
    world.bus.publish("alarm", "bench-1", {"id": "1"})
    world.bus.publish("measurement", "bench-1", {"samples": []})
    query = f"?assets=bench-1&resume={seen['seq']}&epoch={world.bus.epoch}"
    async with server.open(query, world.keys["viewer"]) as websocket:
        hello, *missed = await receive(websocket, 3)
        assert (hello["gap"], hello["seq"]) == (False, 1)
        assert [(m["type"], m["seq"]) for m in missed] == [("alarm", 2), ("measurement", 3)]


@pytest.mark.parametrize("query", ["resume=99", "resume=1&epoch=earlier"])
async def test_resume_point_that_is_gone_is_told(world: Any, server: Any, query: str) -> None:
    world.bus.publish("state", "bench-1", {})
    world.bus.publish("state", "bench-1", {})
    async with server.open(f"?assets=bench-1&{query}", world.keys["viewer"]) as websocket:
        (hello,) = await receive(websocket)
        assert (hello["gap"], hello["seq"]) == (True, 2)


async def test_resume_before_anybody_followed_the_asset_is_told(world: Any, server: Any) -> None:
    asked = []

    async def follow(assets: Collection[str] | None) -> int:
        asked.append(assets)
        return 2

    world.app.state.context = replace(world.context, follow=follow)
    for _ in range(3):
        world.bus.publish("state", "bench-1", {})
    for number, gap in ((1, True), (2, False)):
        query = f"?assets=bench-1&resume={number}"
        async with server.open(query, world.keys["viewer"]) as websocket:
            (hello,) = await receive(websocket)
            assert hello["gap"] == gap
    assert asked == [["bench-1"], ["bench-1"]]


async def test_resume_has_a_gap_while_the_cell_cannot_tell_what_was_made(
    world: Any, server: Any
) -> None:
    async def follow(assets: Collection[str] | None) -> int:
        raise CellUnavailableError("no sign of the cell for 3 s")

    world.app.state.context = replace(world.context, follow=follow)
    for _ in range(3):
        world.bus.publish("state", "bench-1", {})
    for query, gap in (("&resume=2", True), ("", False)):
        async with server.open(f"?assets=bench-1{query}", world.keys["viewer"]) as websocket:
            (hello,) = await receive(websocket)
            assert hello["gap"] == gap


async def test_key_may_come_as_subprotocol(world: Any, server: Any) -> None:
    protocol = f"bearer.{world.keys['viewer']}"
    async with server.open(subprotocols=[protocol]) as websocket:
        assert websocket.subprotocol == protocol
        assert (await receive(websocket))[0]["type"] == "hello"


@contextlib.asynccontextmanager
async def session_cookie(world: Any, server: Any) -> AsyncIterator[dict[str, str]]:
    client = world.client(base_url=f"http://127.0.0.1:{server.port}")
    await client.post("/api/v1/session", json={"key": world.keys["viewer"]})
    yield {"Cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}


async def test_session_cookie_opens_the_stream_from_our_own_page_only(
    world: Any, server: Any
) -> None:
    async with session_cookie(world, server) as headers:
        own = headers | {"Origin": f"http://127.0.0.1:{server.port}"}
        async with server.open(headers=own) as websocket:
            assert (await receive(websocket))[0]["type"] == "hello"
        for origin in ({}, {"Origin": "http://evil.example"}):
            with pytest.raises(InvalidStatus) as refusal:
                async with server.open(headers=headers | origin):
                    pass
            assert refusal.value.response.status_code == 403


@pytest.mark.parametrize("by", ["header", "basic", "subprotocol"])
async def test_a_stream_for_another_site_is_refused(world: Any, server: Any, by: str) -> None:
    key = world.keys["viewer"]
    options: dict[str, Any] = {"headers": {}}
    if by == "header":
        options["key"] = key
    elif by == "basic":
        options["headers"]["Authorization"] = (
            f"Basic {base64.b64encode(b'any:' + key.encode()).decode()}"
        )
    else:
        options["subprotocols"] = [f"bearer.{key}"]
    for foreign in (
        {"Origin": "http://evil.example"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):
        with pytest.raises(InvalidStatus) as refusal:
            async with server.open(**options | {"headers": options["headers"] | foreign}):
                pass
        assert refusal.value.response.status_code == 403
    async with server.open(**options) as websocket:
        assert await websocket.recv()


@pytest.mark.parametrize("role", [None, "wrong", "gateway"])
@pytest.mark.parametrize("by", ["header", "subprotocol", "query"])
async def test_others_are_refused_with_403_before_the_upgrade(
    world: Any, server: Any, role: str | None, by: str
) -> None:
    key = world.keys.get(role, f"bt_00000000_{'A' * 43}" if role else "")
    options: dict[str, Any] = {}
    query = ""
    if by == "header" and key:
        options["key"] = key
    elif by == "subprotocol" and key:
        options["subprotocols"] = [f"bearer.{key}"]
    elif by == "query":  # even a good key has no place in an address
        query = f"?key={world.keys['viewer']}"
    with pytest.raises(InvalidStatus) as refusal:
        async with server.open(query, **options):
            pass
    response = refusal.value.response
    assert response.status_code == 403
    assert response.headers["content-type"] == "application/problem+json"
    assert json.loads(response.body)["status"] == 403
    assert world.bus.subscribers == 0


@pytest.mark.parametrize(
    ("query", "status"), [("?assets=bench-9", 404), ("?resume=x", 422), ("?resume=-1", 422)]
)
async def test_wrong_query_is_refused(world: Any, server: Any, query: str, status: int) -> None:
    with pytest.raises(InvalidStatus) as refusal:
        async with server.open(query, world.keys["viewer"]):
            pass
    assert refusal.value.response.status_code == status


async def test_plain_get_is_told_to_upgrade(world: Any) -> None:
    response = await world.client("viewer").get(PATH)
    assert response.status_code == 426
    assert response.headers["upgrade"] == "websocket"


async def test_client_that_leaves_is_forgotten(world: Any, server: Any) -> None:
    async with server.open(key=world.keys["viewer"]) as websocket:
        await receive(websocket)
        await subscribed(world)
        await websocket.send("what a client says is not asked for")
    await subscribed(world, 0)


async def test_revoked_key_ends_the_stream_within_two_seconds(world: Any, server: Any) -> None:
    async with server.open(key=world.keys["operator"]) as websocket:
        await receive(websocket, 2)
        await asyncio.to_thread(revoke_key, world.store, world.keys["operator"][:11])
        with pytest.raises(ConnectionClosed) as closed:
            async with within(PATIENCE_S):
                await websocket.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert "no longer valid" in closed.value.rcvd.reason


async def strangers(world: Any) -> None:
    """Use up what an address has of wrong keys and of unknown sessions, in a stopped minute."""
    client = world.client(address=("127.0.0.1", 1))
    statuses = set()
    for number in range(40):
        cookie = {"Cookie": f"bearing_twin_8080={number:043d}"}
        statuses.add((await client.get("/api/v1/assets", headers=cookie)).status_code)
        key = {"X-API-Key": f"bt_00000000_{number:043d}"}
        statuses.add((await client.get("/api/v1/assets", headers=key)).status_code)
    assert statuses == {401, 429}


@pytest.mark.parametrize("ends", ["key revoked", "key of a session revoked", "logged out"])
async def test_what_strangers_send_keeps_no_stream_open(world: Any, server: Any, ends: str) -> None:
    async with contextlib.AsyncExitStack() as opened:
        cookie = await opened.enter_async_context(session_cookie(world, server))
        ours = cookie | {"Origin": f"http://127.0.0.1:{server.port}"}
        headers = {"X-API-Key": world.keys["viewer"]} if ends == "key revoked" else ours
        websocket = await opened.enter_async_context(server.open(headers=headers))
        await receive(websocket, 2)
        await strangers(world)
        if ends == "logged out":
            browser = world.client(headers=ours, base_url=f"http://127.0.0.1:{server.port}")
            answer = await browser.delete("/api/v1/session")
            assert answer.status_code == 204
        else:
            prefix = world.keys["viewer"][:11]
            answer = await world.client("admin").delete(f"/api/v1/keys/{prefix}")
            assert answer.status_code == 200
        with pytest.raises(ConnectionClosed) as closed:
            async with within(PATIENCE_S):
                await websocket.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008


async def test_stopping_the_service_ends_the_stream_promptly(world: Any, server: Any) -> None:
    async with server.open(key=world.keys["viewer"]) as websocket:
        await receive(websocket, 2)
        world.bus.close("the service stops")
        with pytest.raises(ConnectionClosed) as closed:
            await websocket.recv()
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1001, "the service stops")
        await server.stop()


async def deaf_client(world: Any, server: Any) -> tuple[Any, Any]:
    """A client that upgrades and then never reads again."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.setblocking(False)
    await asyncio.get_running_loop().sock_connect(raw, ("127.0.0.1", server.port))
    reader, writer = await asyncio.open_connection(sock=raw, limit=1024)
    writer.write(
        f"GET {PATH} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        f"X-API-Key: {world.keys['viewer']}\r\n\r\n".encode()
    )
    assert b"101" in await reader.readline()
    return reader, writer


async def test_deaf_client_delays_neither_the_others_nor_the_end(world: Any, server: Any) -> None:
    _, writer = await deaf_client(world, server)
    async with server.open(key=world.keys["viewer"]) as websocket:
        await receive(websocket, 2)
        await subscribed(world, 2)
        for number in range(1000):
            world.bus.publish("measurement", "bench-1", {"n": number, "fill": "x" * 20_000})
            if number % 50 == 0:
                world.bus.publish("alarm", "bench-1", {"n": number})
            await receive(websocket, 2 if number % 50 == 0 else 1)
        deaf = next(s for s in world.bus._subscriptions if s.dropped)
        assert deaf.dropped > 0
    await server.stop()
    linger = struct.pack("ii", 1, 0)
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    writer.close()


async def test_deaf_client_is_given_up_after_a_while(
    world: Any, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "SEND_PATIENCE_S", 0.3)
    _, writer = await deaf_client(world, server)
    await subscribed(world)
    async with within(30):
        while world.bus.subscribers:
            world.bus.publish("measurement", "bench-1", {"fill": "x" * 200_000})
            await asyncio.sleep(0.01)
    writer.close()


async def test_heartbeat_reaches_everybody(world: Any, server: Any) -> None:
    beating = asyncio.create_task(heartbeats(world.bus, every_s=0.05))
    try:
        async with server.open("?assets=rig-2", world.keys["viewer"]) as websocket:
            _, first, second = await receive(websocket, 3)
            assert first["type"] == second["type"] == "heartbeat"
            assert second["seq"] > first["seq"]
    finally:
        beating.cancel()


async def test_a_key_has_so_many_streams(world: Any, server: Any) -> None:
    viewer, operator = world.keys["viewer"], world.keys["operator"]
    world.app.state.turns.streams = Shares("streams", at_once=3, at_once_each=2)
    async with server.open(key=viewer) as first, server.open(key=viewer):
        with pytest.raises(InvalidStatus) as refused:
            async with server.open(key=viewer):
                pass
        assert refused.value.response.status_code == 503
        assert "Retry-After" in refused.value.response.headers
        async with server.open(key=operator):
            pass
        await first.close()
        await subscribed(world, 1)
        async with server.open(key=viewer) as again:
            assert (await receive(again))[0]["type"] == "hello"


async def test_opening_a_stream_counts_as_a_request(world: Any, server: Any) -> None:
    world.limit("requests", 2)
    for _ in range(2):
        async with server.open(key=world.keys["viewer"]):
            pass
    with pytest.raises(InvalidStatus) as refused:
        async with server.open(key=world.keys["viewer"]):
            pass
    assert refused.value.response.status_code == 429
