"""The other ends of the wires, processes of their own (``python -m`` this module).

They do as little as they can, so that what is measured is our side of the wire.
"""

import asyncio
import contextlib
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import IO

REGISTERS = 8
_HEADER = struct.Struct(">HHHB")
_TICK_S = 0.005
_BLOCK = 256


class Peer:
    """One peer process, which writes JSON lines and reads lines of text."""

    def __init__(self, process: subprocess.Popen[str], stdin: IO[str], stdout: IO[str]) -> None:
        self._process, self._stdin, self._stdout = process, stdin, stdout
        self.port = int(self.says()["port"])

    def says(self) -> dict[str, float]:
        """Wait for the next thing that it says."""
        document: dict[str, float] = json.loads(self._stdout.readline())
        return document

    def send(self, line: str) -> None:
        """Write a line to its standard input."""
        self._stdin.write(line + "\n")
        self._stdin.flush()


@contextlib.contextmanager
def running(*arguments: object) -> Iterator[Peer]:
    """Run a peer until the end of the context."""
    command = [
        sys.executable,
        "-m",
        f"{__package__}.peers",
        *map(str, arguments),
    ]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None  # noqa: PT018, S101
        try:
            yield Peer(process, process.stdin, process.stdout)
        finally:
            process.kill()


def _say(**document: object) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


def frames(first: int, count: int) -> bytes:
    """Frames of the virtual bench's DBC as slcan lines: speed and load in turn, counting."""
    lines = []
    for number in range(first, first + count):
        raw = number // 2 % 40_000
        identifier = 0x130 if number % 2 else 0x120
        payload = raw.to_bytes(2, "little") + bytes(6)
        lines.append(f"t{identifier:03X}8{payload.hex().upper()}\r".encode())
    return b"".join(lines)


def send_frames(rate: float, seconds: float) -> None:
    """Serve one CAN adapter (slcan over TCP) that sends frames for some seconds.

    - ``rate``: frames per second; 0 sends as fast as they are taken.
    - ``seconds``: how long; what a slow reader has held up is sent all the same.
    """
    server = socket.create_server(("127.0.0.1", 0))
    blocks = [frames(_BLOCK * n, _BLOCK) for n in range(40)]
    _say(port=server.getsockname()[1])
    connection, _ = server.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    received = b""
    while b"O\r" not in received:
        received += connection.recv(64)
    time.sleep(0.2)
    began = time.monotonic()
    _say(began=began)
    sent = 0
    while (passed_s := time.monotonic() - began) < seconds or sent < rate * seconds:
        if rate and sent + _BLOCK > rate * passed_s:
            time.sleep(_TICK_S)
            if sent + _BLOCK > rate * seconds:
                break
            continue
        connection.sendall(blocks[sent // _BLOCK % len(blocks)])
        sent += _BLOCK
    _say(sent=sent, seconds=time.monotonic() - began)
    sys.stdin.read()


class _Answers(asyncio.Protocol):
    """Answers every read with the same registers, except for the units that are dead."""

    def __init__(self, dead: set[int]) -> None:
        self._dead = dead
        self._received = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._received += data
        while len(self._received) >= 12:
            request, self._received = self._received[:12], self._received[12:]
            number, _, _, unit = _HEADER.unpack_from(request)
            if unit in self._dead or self._transport is None:
                continue
            count = int.from_bytes(request[10:12], "big")
            values = bytes(range(1, 2 * count + 1))
            self._transport.write(
                _HEADER.pack(number, 0, 3 + len(values), unit)
                + bytes((request[7], len(values)))
                + values
            )


async def answer_reads() -> None:
    """Serve Modbus TCP; lines ``dead UNIT`` and ``alive UNIT`` on standard input."""
    dead: set[int] = set()

    def listen() -> None:
        for line in sys.stdin:
            word, unit = line.split()
            (dead.add if word == "dead" else dead.discard)(int(unit))

    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: _Answers(dead), "127.0.0.1", 0)
    threading.Thread(target=listen, daemon=True).start()
    _say(port=server.sockets[0].getsockname()[1])
    await server.serve_forever()


if __name__ == "__main__":
    if sys.argv[1] == "can":
        send_frames(float(sys.argv[2]), float(sys.argv[3]))
    else:
        asyncio.run(answer_reads())
