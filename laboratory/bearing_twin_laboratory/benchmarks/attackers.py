"""Callers that take all they can get, each run as a process of its own beside the service.

    python -m bearing_twin_laboratory.benchmarks.attackers NAME HOST PORT KEY SECONDS

Each goes on for so many seconds, says on its standard output how many answers of each status it
got, and knows nothing of the service but its address and, where it is a user of it, a key.
"""

import asyncio
import gzip
import http.client
import json
import logging
import os
import resource
import secrets
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta

from bearing_twin_laboratory.benchmarks.work_attackers import (
    acknowledgements,
    readyz,
    sheets,
    silences,
)
from service.domain.roles import Role

#: The environment variable with the asset that is asked for.
ASSET_NAME = "ATTACKED_ASSET"
ASSET, PUSHED_ASSET = os.environ.get(ASSET_NAME, "bench-1"), "gateway-1"
PUSHED = tuple(f"t_node_{number}_c" for number in range(1, 14))
SAMPLES = 20_000
#: The environment variable with the port of OPC UA.
OPCUA_PORT = "OPCUA_PORT"
#: Every attacker but the owner of the service comes from another address.
SOURCE = "127.0.0.9"

_DAY = timedelta(days=1)
_chunk = bytes(65_536)
_tail = b"%x\r\n%s\r\n" % (len(_chunk), _chunk)


class Attack:
    """One run: where to, until when, and what came back."""

    def __init__(self, host: str, port: int, key: str, seconds: float) -> None:
        self.host, self.port, self.key, self.seconds = host, port, key, seconds
        self.until_s = 0.0
        self.answers: Counter[str] = Counter()
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Say that all is prepared, and begin."""
        self.until_s = time.monotonic() + self.seconds
        sys.stdout.write("attacking\n")
        sys.stdout.flush()

    @property
    def over(self) -> bool:
        """Whether its time has come."""
        return time.monotonic() >= self.until_s

    def note(self, what: object) -> None:
        """Count an answer."""
        with self._lock:
            self.answers[str(what)] += 1

    def connect(self, source: str = SOURCE) -> socket.socket:
        """Open a connection that lasts to the end of the attack at most."""
        left_s = max(self.until_s - time.monotonic(), 0.1)
        return socket.create_connection((self.host, self.port), left_s, (source, 0))

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> int:
        """Make one call to its end, or to the end of the attack; 0 without an answer."""
        left_s = max(self.until_s - time.monotonic(), 0.1)
        connection = http.client.HTTPConnection(
            self.host, self.port, timeout=left_s, source_address=(SOURCE, 0)
        )
        given = {"Content-Type": "application/json"} | headers
        if self.key:
            given["X-API-Key"] = self.key
        status = 0
        try:
            connection.request(method, f"/api/v1{path}", body, given)
            answer = connection.getresponse()
            while answer.read(1 << 16) and not self.over:
                pass
            status = answer.status
        except OSError:
            time.sleep(0.05)
        except http.client.HTTPException:
            pass
        finally:
            connection.close()
        self.note(status)
        return status

    def side_by_side(self, count: int, work: Callable[[int], None]) -> None:
        """Do a work again and again in so many threads, with the number of each, to the end."""

        def go_on(number: int) -> None:
            while not self.over:
                try:
                    work(number)
                except OSError as error:
                    self.note(type(error).__name__)
                    time.sleep(0.02)

        threads = [threading.Thread(target=go_on, args=(number,)) for number in range(count)]
        self.begin()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def _flood(attack: Attack, connection: socket.socket, pieces: Iterator[bytes]) -> None:
    """Send without end until the other side has had enough."""
    with connection:
        for piece in pieces:
            if attack.over:
                return
            connection.sendall(piece)
            if select.select([connection], [], [], 0)[0]:
                answer = connection.recv(4096)
                attack.note(answer[9:12].decode("latin-1") or "closed")
                if not answer:
                    return


def _head(attack: Attack, path: str, *lines: str, key: bool = False) -> bytes:
    given = ["Host: bench", "Content-Type: application/json", "Transfer-Encoding: chunked", *lines]
    if key:
        given.append(f"X-API-Key: {attack.key}")
    return "\r\n".join([f"POST /api/v1{path} HTTP/1.1", *given, "", ""]).encode()


def _gzip_tail(attack: Attack, path: str, key: bool) -> None:
    """Send a gzip member that ends at once, and then zeros without end."""
    member = gzip.compress(b"[")
    first = b"%x\r\n%s\r\n" % (len(member), member)

    def once(number: int) -> None:
        def pieces() -> Iterator[bytes]:
            yield _head(attack, path, "Content-Encoding: gzip", key=key) + first
            while True:
                yield _tail

        _flood(attack, attack.connect(), pieces())

    attack.side_by_side(8, once)


def gzip_tail_without_key(attack: Attack) -> None:
    """Zeros without end behind a gzip member, for a route that asks for no key."""
    _gzip_tail(attack, "/session", key=False)


def gzip_tail_with_key(attack: Attack) -> None:
    """The same for a push."""
    _gzip_tail(attack, f"/assets/{PUSHED_ASSET}/measurements", key=True)


def drip(attack: Attack) -> None:
    """Send a body one byte at a time, on a hundred connections."""
    member = gzip.compress(b" " * 200)

    def once(number: int) -> None:
        def pieces() -> Iterator[bytes]:
            path = f"/assets/{PUSHED_ASSET}/measurements"
            yield _head(attack, path, "Content-Encoding: gzip", key=True)
            for byte in member:
                yield b"1\r\n%c\r\n" % byte
                time.sleep(0.02)
            while True:
                yield b"1\r\n0\r\n"
                time.sleep(0.02)

        _flood(attack, attack.connect(), pieces())

    attack.side_by_side(100, once)


def idle_connections(attack: Attack) -> None:
    """Hold eleven hundred connections, half of them with half a request."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    held: list[socket.socket] = []
    attack.begin()
    while not attack.over:
        while len(held) < 1100 and not attack.over:
            try:
                one = attack.connect("127.0.0.1")
                if len(held) % 2:
                    one.sendall(b"GET /livez HTTP/1.1\r\nHost: bench\r\nX: ")
            except OSError:
                attack.note("refused")
                break
            held.append(one)
        for one in _readable(held):
            try:
                gone = not one.recv(4096)
            except OSError:
                gone = True
            if gone:
                attack.note("closed")
                one.close()
                held.remove(one)
    for one in held:
        one.close()


def _readable(held: list[socket.socket]) -> list[socket.socket]:
    """Give those on which something has come, within a quarter of a second."""
    poller = select.poll()  # `select` knows no descriptor above 1023
    by_number = {one.fileno(): one for one in held}
    for number in by_number:
        poller.register(number, select.POLLIN)
    return [by_number[number] for number, _ in poller.poll(250)]


def _push(attack: Attack, channel: str) -> Callable[[int], None]:
    began_ms = round(time.time() * 1000) - 86_400_000
    rounds = iter(range(10**6))

    def body() -> bytes:
        first_ms = began_ms + next(rounds) * SAMPLES
        samples = [
            {
                "channel": channel.format(number % len(PUSHED) + 1),
                "time": _rfc3339(first_ms + number),
                "value": 50.0 + number % 7 / 10,
            }
            for number in range(SAMPLES)
        ]
        return json.dumps({"samples": samples}).encode()

    bodies = [body() for _ in range(8)]

    def once(number: int) -> None:
        text = bodies[next(rounds) % len(bodies)]
        if attack.ask("POST", f"/assets/{PUSHED_ASSET}/measurements", text) == 503:
            time.sleep(0.2)

    return once


def _rfc3339(ms: int) -> str:
    text = datetime.fromtimestamp(ms / 1000, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


def pushes(attack: Attack) -> None:
    """Four times twenty thousand samples side by side: a gateway that comes back."""
    attack.side_by_side(4, _push(attack, "t_node_{}_c"))


def rejected_pushes(attack: Attack) -> None:
    """The same, and nothing of it is right."""
    attack.side_by_side(4, _push(attack, "t_nowhere_{}_c"))


def large_reads(attack: Attack) -> None:
    """Twelve large pages of all channels side by side, none named."""
    span = "start=2020-01-01T00:00:00Z&end=2040-01-01T00:00:00Z"

    def once(number: int) -> None:
        path = f"/assets/{PUSHED_ASSET}/measurements?limit=50000&{span}"
        if attack.ask("GET", path) == 503:
            time.sleep(0.2)

    attack.side_by_side(12, once)


def downloads(attack: Attack) -> None:
    """Twelve downloads of everything, half as CSV and half as Parquet."""
    span = "start=2020-01-01T00:00:00Z&end=2040-01-01T00:00:00Z"

    def once(number: int) -> None:
        kind = ("csv", "parquet")[number % 2]
        path = f"/assets/{PUSHED_ASSET}/measurements?format={kind}&{span}"
        if attack.ask("GET", path) == 503:
            time.sleep(0.2)

    attack.side_by_side(12, once)


def what_ifs(attack: Attack) -> None:
    """Forty what-ifs of two days at once, by clients most of which leave after five seconds."""
    steps = [
        {"duration_s": 864, "speed_rpm": 3000 + 10 * number, "load_n": 3000}
        for number in range(200)
    ]
    body = json.dumps({"profile": steps, "step_s": 60}).encode()

    def once(number: int) -> None:
        short = Attack(attack.host, attack.port, attack.key, 0)
        patience_s = 5.0 if number % 10 else 60.0
        short.until_s = min(time.monotonic() + patience_s, attack.until_s)
        status = short.ask("POST", f"/assets/{ASSET}/forecasts", body)
        attack.note(status)
        if status == 503:
            time.sleep(0.2)

    attack.side_by_side(40, once)


def assets(attack: Attack) -> None:
    """Four clients that look at the list of assets without a pause."""

    def once(number: int) -> None:
        attack.ask("GET", "/assets")

    attack.side_by_side(4, once)


def streams(attack: Attack) -> None:
    """Two hundred streams that want all that was ever said, opened again and again."""

    def once(number: int) -> None:
        with attack.connect() as connection:
            connection.sendall(
                (
                    "GET /api/v1/stream?resume=0 HTTP/1.1\r\nHost: bench\r\n"
                    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
                    f"X-API-Key: {attack.key}\r\n\r\n"
                ).encode()
            )
            answer = connection.recv(65_536)
            attack.note(answer[9:12].decode("latin-1"))
            until_s = min(time.monotonic() + 2.0, attack.until_s)
            while answer and time.monotonic() < until_s:
                answer = connection.recv(65_536)

    attack.side_by_side(200, once)


def cookies(attack: Attack) -> None:
    """Forty callers without a key who make up the cookie of a session each time."""

    def once(number: int) -> None:
        cookie = f"bearing_twin_{attack.port}={secrets.token_urlsafe(32)}"
        attack.ask("GET", f"/assets/{ASSET}/snapshot", Cookie=cookie)

    attack.key = ""
    attack.side_by_side(40, once)


def opcua_frame(attack: Attack) -> None:
    """OPC UA messages that announce 4 GB, without a key."""
    port = int(os.environ[OPCUA_PORT])

    def once(number: int) -> None:
        left_s = max(attack.until_s - time.monotonic(), 0.1)
        with socket.create_connection((attack.host, port), left_s, (SOURCE, 0)) as connection:
            connection.sendall(struct.pack("<3scI", b"MSG", b"F", 0xFFFF_FFFF))
            sent = 0
            try:
                while not attack.over:
                    sent += connection.send(_chunk)
            finally:
                attack.note("sent more than 16 MiB" if sent > 1 << 24 else "closed")

    attack.side_by_side(4, once)


def opcua_history(attack: Attack) -> None:
    """Clients of OPC UA that have a day of history averaged, again and again."""
    address = f"opc.tcp://{attack.host}:{os.environ[OPCUA_PORT]}/"

    def once(number: int) -> None:
        asyncio.run(_read_history(attack, address, f"ns=2;s={PUSHED_ASSET}/{PUSHED[number]}"))

    attack.side_by_side(4, once)


async def _read_history(attack: Attack, address: str, node_id: str) -> None:
    from asyncua import Client, ua  # it takes a second, and the other attackers do not need it

    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    now = datetime.now(UTC)
    try:
        async with Client(address, timeout=60) as client:
            node = client.get_node(node_id)
            # Much to read, and little to answer: the caller has no work of it.
            details = ua.ReadProcessedDetails(
                StartTime=now - _DAY,
                EndTime=now,
                ProcessingInterval=59 * 60_000.0,
                AggregateType=[ua.NodeId(ua.ObjectIds.AggregateFunction_Average)],
            )
            while not attack.over:
                attack.note((await node.history_read(details)).StatusCode.name)
    except (ua.UaError, TimeoutError) as error:
        attack.note(type(error).__name__)


ATTACKS: dict[Callable[[Attack], None], Role] = {
    gzip_tail_without_key: "viewer",
    gzip_tail_with_key: "gateway",
    drip: "gateway",
    idle_connections: "viewer",
    pushes: "gateway",
    rejected_pushes: "gateway",
    large_reads: "viewer",
    downloads: "viewer",
    what_ifs: "operator",
    assets: "viewer",
    cookies: "viewer",
    opcua_frame: "viewer",
    opcua_history: "viewer",
    streams: "viewer",
    silences: "operator",
    acknowledgements: "operator",
    readyz: "viewer",
    sheets: "admin",
}
"""Every attacker, and the role of its key."""


def attack_names() -> dict[str, Role]:
    """Give the attackers by name, each with the role of its key."""
    return {one.__name__: role for one, role in ATTACKS.items()}


def begin_attack(
    name: str, port: int, key: str, seconds: float, environment: Mapping[str, str]
) -> "subprocess.Popen[str]":
    """Start an attacker; it says "attacking" when it has prepared all, and its answers at its end.

    - ``name``: one of `attack_names`.
    - ``port``, ``key``: where the service listens on 127.0.0.1, and a key of the attacker's role.
    - ``seconds``: for how long.
    - ``environment``: `OPCUA_PORT`, and `ASSET_NAME` where it is not "bench-1".
    """
    where = ("127.0.0.1", str(port), key, str(seconds))
    return subprocess.Popen(
        [sys.executable, "-m", __name__, name, *where],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


def _main() -> None:
    name, host, port, key, seconds = sys.argv[1:]
    # A caller stands on another machine: here it may not take the processor from the service.
    os.nice(15)
    attack = Attack(host, int(port), key, float(seconds))
    next(one for one in ATTACKS if one.__name__ == name)(attack)
    sys.stdout.write(json.dumps(attack.answers))


if __name__ == "__main__":
    _main()
