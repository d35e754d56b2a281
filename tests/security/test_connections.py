"""A connection that keeps the server waiting is closed, and there are only so many of them."""

import asyncio
import contextlib
import os
import resource
import socket
from collections.abc import AsyncIterator

import pytest
import structlog
import websockets
from patience import wait_for, within
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from service.web import server as web_server
from service.web.server import Doorway, WebServer

pytestmark = pytest.mark.wires

PATIENCE_S = 30
MOST = 16
GET = b"GET / HTTP/1.1\r\nHost: bench\r\n\r\n"


async def hello(request: Request) -> Response:
    return PlainTextResponse("hello")


async def body(request: Request) -> Response:
    return PlainTextResponse(str(len(await request.body())))


async def refuse(request: Request) -> Response:
    return PlainTextResponse("no", 401)


async def long_answer(request: Request) -> Response:
    async def pieces() -> AsyncIterator[bytes]:
        for _ in range(1000):
            yield bytes(1 << 20)

    return StreamingResponse(pieces())


async def echo(websocket: WebSocket) -> None:
    await websocket.accept()
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            await websocket.send_text(await websocket.receive_text())


async def never(websocket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect):
        while (await websocket.receive())["type"] != "websocket.disconnect":
            pass


async def flood(websocket: WebSocket) -> None:
    await websocket.accept()
    with contextlib.suppress(TimeoutError):
        async with within(1.0):
            while True:
                await websocket.send_text("x" * 65_536)


@pytest.fixture
async def port() -> AsyncIterator[int]:
    app = Starlette(
        routes=[
            Route("/", hello),
            Route("/body", body, methods=["POST"]),
            Route("/refuse", refuse, methods=["POST"]),
            Route("/long", long_answer),
            WebSocketRoute("/echo", echo),
            WebSocketRoute("/never", never),
            WebSocketRoute("/flood", flood),
        ]
    )
    listener = socket.create_server(("127.0.0.1", 0))
    number = listener.getsockname()[1]
    server = WebServer(app, MOST, None)
    serving = asyncio.create_task(server.serve(sockets=[Doorway(listener, MOST)]))
    yield number
    server.should_exit = True
    await wait_for(serving, PATIENCE_S)


async def open_one(
    port: int, address: str = "127.0.0.1"
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0))


async def ending(reader: asyncio.StreamReader) -> bytes:
    """All that comes until the other side hangs up."""
    try:
        return await wait_for(reader.read(), PATIENCE_S)
    except ConnectionError:
        return b""


async def test_a_connection_without_a_whole_head_is_closed(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "HEAD_S", 1.0)
    silent = await open_one(port)
    half = await open_one(port)
    half[1].write(GET[:-2])
    # Half a request behind a whole one is no better.
    second = await open_one(port)
    second[1].write(GET + GET[:-2])
    async with websockets.connect(f"ws://127.0.0.1:{port}/echo") as stream:
        assert await ending(silent[0]) == b""
        assert await ending(half[0]) == b""
        assert (await ending(second[0])).count(b"hello") == 1
        await stream.send("still here")
        assert await stream.recv() == "still here"
    for _, writer in (silent, half, second):
        writer.close()


UPGRADE = (
    b"GET /echo HTTP/1.1\r\nHost: bench\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
)


@pytest.mark.parametrize(
    ("heads", "status"),
    [
        (b"", b"101"),
        # As long as a log-in proxy makes them, and REST takes them.
        (b"Cookie: " + b"a" * 9_000 + b"\r\n", b"101"),
        (b"Cookie: " + b"a" * 50_000 + b"\r\n", b"101"),
        (b"".join(b"X-%d: 1\r\n" % number for number in range(130)), b"101"),
        (b"Cookie: " + b"a" * 70_000 + b"\r\n", b"431"),
        # What would keep the event loop busy, from any caller.
        (b"".join(b"X-%d: 1\r\n" % number for number in range(300)), b"431"),
        (b"Connection: " + b"a," * 20_000 + b"upgrade\r\n", b"400"),
        (b"Sec-WebSocket-Protocol: " + b"a," * 20_000 + b"b\r\n", b"400"),
        (b"Content-Length: 5\r\n", b"400"),
        (b"Transfer-Encoding: chunked\r\n", b"400"),
    ],
)
async def test_an_upgrade_is_answered_whatever_its_head(
    port: int, heads: bytes, status: bytes
) -> None:
    reader, writer = await open_one(port)
    writer.write(UPGRADE + heads + b"\r\n")
    line = await wait_for(reader.readline(), PATIENCE_S)
    assert line.split()[1] == status
    if status != b"101":
        await ending(reader)  # which is closed, too
    writer.close()


async def test_a_stream_that_is_neither_accepted_nor_refused_is_closed(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "ACCEPT_S", 1.0)
    reader, writer = await open_one(port)
    writer.write(UPGRADE.replace(b"/echo", b"/never") + b"\r\n")
    async with websockets.connect(f"ws://127.0.0.1:{port}/echo") as stream:
        assert await ending(reader) == b""
        await stream.send("still here")
        assert await stream.recv() == "still here"
    writer.close()


async def test_a_stream_whose_end_is_not_read_is_hung_up_on(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "UNREAD_S", 1.0)
    _, writer = await open_one(port)
    writer.write(UPGRADE.replace(b"/echo", b"/flood") + b"\r\n")

    async def write_on() -> None:
        while True:
            writer.write(b"x")
            await writer.drain()
            await asyncio.sleep(0.1)

    with pytest.raises(ConnectionError):  # nothing that is sent is answered before
        await wait_for(write_on(), PATIENCE_S)


async def test_a_body_that_does_not_end_is_cut_off(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "BODY_S", 2.0)
    reader, writer = await open_one(port)
    writer.write(b"POST /body HTTP/1.1\r\nHost: bench\r\nTransfer-Encoding: chunked\r\n\r\n")

    async def drip() -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(b"1\r\n0\r\n")
                await writer.drain()
                await asyncio.sleep(0.05)

    dripping = asyncio.create_task(drip())
    assert await ending(reader) == b""
    dripping.cancel()
    writer.close()


async def test_an_answer_before_the_end_of_the_body_ends_the_connection(port: int) -> None:
    reader, writer = await open_one(port)
    writer.write(b"POST /refuse HTTP/1.1\r\nHost: bench\r\nTransfer-Encoding: chunked\r\n\r\n")
    answer = await wait_for(reader.readuntil(b"no"), PATIENCE_S)
    assert answer.startswith(b"HTTP/1.1 401")
    piece = b"10000\r\n" + bytes(65_536) + b"\r\n"
    most = 64 * web_server.REFUSED_BODY_BYTES

    async def flood() -> int:
        for sent in range(0, most, len(piece)):
            try:
                writer.write(piece)
                await wait_for(writer.drain(), PATIENCE_S)
            except ConnectionError:
                return sent
        return most

    assert await flood() < most
    writer.close()


async def test_an_answer_that_nobody_reads_is_given_up(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "UNREAD_S", 2.0)
    reader, writer = await open_one(port)
    writer.write(GET.replace(b"/ ", b"/long "))
    await asyncio.sleep(5.0)
    assert 0 < len(await ending(reader)) < 500 << 20, "far from whole"
    writer.close()


async def test_an_address_leaves_as_many_connections_as_it_takes(port: int) -> None:
    async def is_let_in(one: tuple[asyncio.StreamReader, asyncio.StreamWriter]) -> bool:
        try:
            return bool(await wait_for(one[0].read(1), 0.3)) is not False
        except TimeoutError:
            return True
        except ConnectionError:
            return False

    asked, inside = [], []
    # Each address may have as many as it leaves free: there is always one for the next.
    for address, places in (("127.0.0.1", 8), ("127.0.0.2", 4), ("127.0.0.3", 2), ("127.0.0.4", 1)):
        ones = [await open_one(port, address) for _ in range(MOST)]
        inside = [one for one in ones if await is_let_in(one)]
        assert len(inside) == places
        asked += ones
    # The last eighth hears why it is not served.
    reader, writer = inside[-1]
    writer.write(GET)
    assert (await wait_for(reader.readline(), PATIENCE_S)).split()[1] == b"503"
    for _, writer in asked:
        writer.close()
    for _ in range(100):
        reader, writer = await open_one(port)
        writer.write(GET)
        status = await wait_for(reader.readline(), PATIENCE_S)
        writer.close()
        if status.startswith(b"HTTP/1.1 200"):
            return
        await asyncio.sleep(0.1)
    pytest.fail("the places of those who left are not free again")


async def test_without_a_free_descriptor_callers_are_hung_up_on_and_the_log_stays_short(
    port: int,
) -> None:
    waiting = [socket.socket() for _ in range(20)]
    loop = asyncio.get_running_loop()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(map(int, os.listdir("/proc/self/fd")))  # noqa: PTH208 - a few names
    # Every number below is taken, so that the next connection finds none.
    fillers = []
    while (filler := os.open(os.devnull, os.O_RDONLY)) < highest:
        fillers.append(filler)
    fillers.append(filler)
    resource.setrlimit(resource.RLIMIT_NOFILE, (filler + 1, hard))
    try:
        with structlog.testing.capture_logs() as lines:
            for one in waiting:
                one.setblocking(False)
                await loop.sock_connect(one, ("127.0.0.1", port))
            for one in waiting:
                assert await wait_for(loop.sock_recv(one, 1), PATIENCE_S) == b""
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for one in waiting:
            one.close()
        for filler in fillers:
            os.close(filler)
    assert [line["event"] for line in lines] == ["no_file_for_a_connection"]
    reader, writer = await open_one(port)
    writer.write(GET)
    assert (await wait_for(reader.readline(), PATIENCE_S)).startswith(b"HTTP/1.1 200")
    writer.close()
