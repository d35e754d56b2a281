"""Clients of the service, a process of their own (``python -m`` this module).

They speak just enough HTTP and WebSocket, so that they cost far less than what they measure. The
process reads one JSON document of arguments and prints one of results.
"""

import asyncio
import contextlib
import json
import math
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime

_MASK = bytes(4)
_OPEN_AT_ONCE = 50
_PATIENCE_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Calls:
    """What HTTP clients do: each sends a request, waits for its answer, sends the next.

    They end after so many seconds; where no answer has come by then, with the first one.
    """

    port: int
    path: str
    seconds: float
    connections: int
    method: str = "GET"
    headers: Mapping[str, str] = field(default_factory=dict)
    body: str = ""
    interval_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Answered:
    """How fast HTTP clients were answered, by status, and how many connections were lost."""

    requests: int
    per_s: float
    p50_s: float
    p95_s: float
    p99_s: float
    max_s: float
    statuses: Mapping[str, int]
    lost: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """What clients of the stream do; those that are stalled never read."""

    port: int
    path: str
    key: str
    clients: int
    stalled: int
    settle_s: float
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """How late messages came to the clients that read, and how many of these were cut off."""

    messages: int
    types: Mapping[str, int]
    p50_s: float
    p95_s: float
    p99_s: float
    max_s: float
    lost: int
    fewest_per_client: int


def quantile(values: Sequence[float], probability: float) -> float:
    """The smallest of the values that this many of them do not exceed; NaN of none."""
    if not values:
        return math.nan
    return sorted(values)[max(math.ceil(probability * len(values)) - 1, 0)]


# ---------------------------------------------------------------------------- HTTP
class _Caller(asyncio.Protocol):
    """One kept connection: sends a request, waits for its answer, sends the next."""

    def __init__(self, request: bytes, interval_s: float, phase_s: float) -> None:
        self.latencies_s: list[float] = []
        self.statuses: Counter[str] = Counter()
        self.ended = asyncio.get_running_loop().create_future()
        self._request = request
        self._interval_s = interval_s
        self._phase_s = phase_s
        self._received = bytearray()
        self._sent = 0.0
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101
        self._transport = transport
        asyncio.get_running_loop().call_later(self._phase_s, self._send)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.ended.done():
            self.ended.set_result(None)

    def stop(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def _send(self) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._sent = time.perf_counter()
            self._transport.write(self._request)

    def data_received(self, data: bytes) -> None:
        self._received += data
        end = self._received.find(b"\r\n\r\n")
        if end < 0:
            return
        head = bytes(self._received[:end]).lower()
        place = head.find(b"content-length:")
        if b"transfer-encoding: chunked" in head:
            # One question at a time: what has come is one answer, whole with its last chunk.
            if not self._received.endswith(b"\r\n0\r\n\r\n"):
                return
            self._received.clear()
        else:
            length = 0 if place < 0 else int(head[place + 15 :].split(b"\r\n", 1)[0])
            if len(self._received) < end + 4 + length:
                return
            del self._received[: end + 4 + length]
        passed_s = time.perf_counter() - self._sent
        self.statuses[head[9:12].decode()] += 1
        self.latencies_s.append(passed_s)
        if self._interval_s:
            wait_s = max(self._interval_s - passed_s, 0.0)
            asyncio.get_running_loop().call_later(wait_s, self._send)
        else:
            self._send()


async def _call(asked: Calls) -> Answered:
    body = asked.body.encode()
    lines = [f"{asked.method} {asked.path} HTTP/1.1", "Host: 127.0.0.1"]
    lines += [f"{name}: {value}" for name, value in asked.headers.items()]
    if body:
        lines += ["Content-Type: application/json", f"Content-Length: {len(body)}"]
    request = "\r\n".join([*lines, "", ""]).encode() + body
    loop = asyncio.get_running_loop()
    interval_s, count = asked.interval_s, asked.connections
    callers = [
        (
            await loop.create_connection(
                lambda number=number: _Caller(request, interval_s, interval_s * number / count),  # type: ignore[misc]
                "127.0.0.1",
                asked.port,
            )
        )[1]
        for number in range(count)
    ]
    began = time.perf_counter()
    ended = [caller.ended for caller in callers]
    while True:
        _, waiting = await asyncio.wait(ended, timeout=asked.seconds)
        passed_s = time.perf_counter() - began
        if any(caller.latencies_s for caller in callers) or not waiting or passed_s > _PATIENCE_S:
            break
    lost = sum(caller.ended.done() for caller in callers)
    for caller in callers:
        caller.stop()
    latencies_s = [one for caller in callers for one in caller.latencies_s]
    return Answered(
        requests=len(latencies_s),
        per_s=len(latencies_s) / passed_s,
        p50_s=quantile(latencies_s, 0.5),
        p95_s=quantile(latencies_s, 0.95),
        p99_s=quantile(latencies_s, 0.99),
        max_s=max(latencies_s, default=math.nan),
        statuses=dict(sum((caller.statuses for caller in callers), Counter())),
        lost=lost,
    )


# ---------------------------------------------------------------------------- WebSocket
class _Listener(asyncio.Protocol):
    """One client of the stream; a stalled one never reads."""

    def __init__(self, request: bytes, stalled: bool) -> None:
        self.open = asyncio.get_running_loop().create_future()
        self.delays_s: list[float] = []
        self.types: Counter[str] = Counter()
        self.counting = False
        self.gone = False
        self._request = request
        self._stalled = stalled
        self._received = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101
        self._transport = transport
        transport.write(self._request)

    def connection_lost(self, exc: Exception | None) -> None:
        self.gone = True
        if not self.open.done():
            self.open.set_result(None)

    def stop(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        now_s = time.time()
        self._received += data
        if not self.open.done():
            end = self._received.find(b"\r\n\r\n")
            if end < 0:
                return
            if not self._received.startswith(b"HTTP/1.1 101"):
                raise RuntimeError(bytes(self._received[:end]).decode())
            del self._received[: end + 4]
            self.open.set_result(None)
            if self._stalled and self._transport is not None:
                self._transport.pause_reading()
                return
        for opcode, payload in self._frames():
            if opcode == 0x9 and self._transport is not None:
                self._transport.write(bytes([0x8A, 0x80 | len(payload)]) + _MASK + payload)
            elif opcode == 0x1 and self.counting:
                self._count(payload, now_s)

    def _frames(self) -> Iterator[tuple[int, bytes]]:
        received = self._received
        while len(received) >= 2:
            length, start = received[1] & 0x7F, 2
            if length >= 126:
                start = 4 if length == 126 else 10
                length = int.from_bytes(received[2:start], "big")
                if len(received) < start:
                    return
            if len(received) < start + length:
                return
            yield received[0] & 0x0F, bytes(received[start : start + length])
            del received[: start + length]

    def _count(self, payload: bytes, now_s: float) -> None:
        head = payload[:300].decode(errors="ignore")
        kind = head.split('"type":"', 1)[1].split('"', 1)[0]
        self.types[kind] += 1
        if kind != "hello":
            sent_at = head.split('"sent_at":"', 1)[1].split('"', 1)[0]
            self.delays_s.append(now_s - datetime.fromisoformat(sent_at).timestamp())


async def _listen(asked: Listening) -> Heard:
    """Open the stream for many clients, listen for a while, report how late messages came."""
    request = "\r\n".join(
        [
            f"GET {asked.path} HTTP/1.1",
            "Host: 127.0.0.1",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            f"X-API-Key: {asked.key}",
            "",
            "",
        ]
    ).encode()
    loop = asyncio.get_running_loop()
    listeners: list[_Listener] = []
    total = asked.clients + asked.stalled
    while len(listeners) < total:
        batch = [
            (
                await loop.create_connection(
                    lambda stalled=number >= asked.clients: _Listener(request, stalled),  # type: ignore[misc]
                    "127.0.0.1",
                    asked.port,
                )
            )[1]
            for number in range(len(listeners), min(len(listeners) + _OPEN_AT_ONCE, total))
        ]
        async with asyncio.timeout(_PATIENCE_S):
            await asyncio.gather(*(one.open for one in batch))
        listeners += batch
    awake = listeners[: asked.clients]
    await asyncio.sleep(asked.settle_s)
    for one in awake:
        one.counting = True
    await asyncio.sleep(asked.seconds)
    delays_s = [delay for one in awake for delay in one.delays_s]
    lost = sum(one.gone for one in awake)
    for one in listeners:
        one.stop()
    return Heard(
        messages=len(delays_s),
        types=dict(sum((one.types for one in awake), Counter())),
        p50_s=quantile(delays_s, 0.5),
        p95_s=quantile(delays_s, 0.95),
        p99_s=quantile(delays_s, 0.99),
        max_s=max(delays_s, default=math.nan),
        lost=lost,
        fewest_per_client=min((len(one.delays_s) for one in awake), default=0),
    )


# ---------------------------------------------------------------------------- the other side
def call(asked: Calls) -> Answered:
    """Run HTTP clients in a process of their own until they have their results."""
    return Answered(**json.loads(_said("call", asked)))


def listen(asked: Listening) -> Heard:
    """Run clients of the stream in a process of their own until they have their results."""
    return Heard(**json.loads(_said("listen", asked)))


def _said(what: str, asked: Calls | Listening) -> str:
    with started(what, json.dumps(asdict(asked))) as process:
        out, _ = process.communicate()
        if process.returncode:
            raise RuntimeError(f"the benchmark's clients ended with status {process.returncode}")
    return out


@contextlib.contextmanager
def started(what: str, asked: str = "") -> Iterator["subprocess.Popen[str]"]:
    """Start such a process; it is cleared away at the end of the context."""
    command = [sys.executable, "-m", f"{__package__}.clients", what, asked]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def _serve_empty() -> None:
    """Serve one route that does nothing, as the service serves its own."""
    import uvicorn
    from fastapi import FastAPI

    from service.web.listening import bind

    app = FastAPI()

    @app.get("/")
    async def empty() -> dict[str, str]:
        return {}

    listener = bind("127.0.0.1", 0)
    sys.stdout.write(f"{listener.getsockname()[1]}\n")
    sys.stdout.flush()
    uvicorn.Server(uvicorn.Config(app, log_config=None, access_log=False)).run([listener])


if __name__ == "__main__":
    if sys.argv[1] == "empty":
        _serve_empty()
    else:
        asked = json.loads(sys.argv[2])
        found = (
            asyncio.run(_call(Calls(**asked)))
            if sys.argv[1] == "call"
            else asyncio.run(_listen(Listening(**asked)))
        )
        sys.stdout.write(json.dumps(asdict(found)))
