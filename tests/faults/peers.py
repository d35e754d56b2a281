"""Field devices that misbehave on demand and number whatever they send.

Each runs in a process of its own, so that it can be killed and frozen, and shares a small file with
the test: what it shall do, and how many answers or frames it has sent. The number is carried in the
value itself, so that the stored samples can be compared with what was sent, one by one.

    python peers.py modbus|can PORT STATE
    python peers.py cable PORT TARGET
"""

import itertools
import mmap
import random
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

# Of the Modbus server; the argument is a code, or ms.
NORMAL, LATE, GARBAGE, EXCEPTION, SPIKES, STUCK = range(6)
WRONG, FLOOD = 1, 2  # of the CAN peer; its argument: frames per second of the flood
POISON = 4_000_000_000
"""Carried by answers that nobody may take for a value."""
FRAME_ID, UNKNOWN_ID = 0x120, 0x121
FRAMES_PER_S = 100
NUMBER_AT = 4
SPIKE_K = 40


class State:
    """What test and peer share: outlives both. `sent` counts before anything goes out."""

    def __init__(self, file: Path) -> None:
        if not file.exists():
            file.write_bytes(bytes(24))
        with file.open("r+b") as opened:
            self._map = mmap.mmap(opened.fileno(), 24)

    def _get(self, index: int) -> int:
        return int(struct.unpack_from("<Q", self._map, 8 * index)[0])

    def _set(self, index: int, value: int) -> None:
        struct.pack_into("<Q", self._map, 8 * index, value)

    def order(self, mode: int, argument: int = 0) -> None:
        self._set(2, argument)
        self._set(0, mode)

    @property
    def mode(self) -> int:
        return self._get(0)

    @property
    def sent(self) -> int:
        return self._get(1)

    @property
    def argument(self) -> int:
        return self._get(2)

    def next(self) -> int:
        number = self.sent + 1
        self._set(1, number)
        return number


def modbus(port: int, state: State) -> None:
    """Serve input registers: three temperatures in tenths of a degree, a number in 4 and 5."""
    noise, turn, asked = random.Random(1), threading.Lock(), itertools.count()

    def registers(number: int, mode: int) -> list[int]:
        turn_of = next(asked)
        wobble = 0 if mode == STUCK else turn_of % 3
        spike = SPIKE_K * 10 if mode == SPIKES and turn_of % 5 == 0 else 0
        temperatures = [600 + wobble + spike, 550 + wobble, 220 + wobble]
        return [*temperatures, 0, number >> 16, number & 0xFFFF]

    def answer(transaction: int, unit: int, request: bytes) -> bytes:
        function, address, count = struct.unpack(">BHH", request[:5])
        mode, argument = state.mode, state.argument
        if mode == EXCEPTION:
            return struct.pack(">HHHBBB", transaction, 0, 3, unit, function | 0x80, argument)
        number = POISON
        if mode == LATE:
            time.sleep(argument / 1000)
        elif mode in (NORMAL, SPIKES, STUCK) and address <= NUMBER_AT < address + count:
            number = state.next()
        words = registers(number, mode)[address : address + count]
        body = struct.pack(f">BBB{count}H", unit, function, 2 * count, *words)
        good = struct.pack(">HHH", transaction, 0, len(body)) + body
        if mode != GARBAGE:
            return good
        return noise.choice(
            (
                noise.randbytes(noise.randrange(1, 300)),
                good[:-3],  # cut short
                struct.pack(">HHH", transaction, 0, len(body) - 2) + body[:2] + body[4:],
                struct.pack(">H", (transaction + 1) & 0xFFFF) + good[2:],  # to nobody's request
                struct.pack(">HHHBB", transaction, 0, 2, unit, function),  # nothing in it
                b"HTTP/1.1 400 Bad Request\r\n\r\n",
            )
        )

    def serve(connection: socket.socket) -> None:
        with connection:
            while True:
                head = _exactly(connection, 7)
                transaction, _, length, unit = struct.unpack(">HHHB", head)
                request = _exactly(connection, length - 1)
                with turn:
                    _hang_up_with(connection)
                    connection.sendall(answer(transaction, unit, request))

    _accept(port, serve)


def can(port: int, state: State) -> None:
    """Speak slcan: a numbered frame every 10 ms, and whatever else is ordered."""

    def serve(connection: socket.socket) -> None:
        with connection:
            received = b""
            while b"O\r" not in received:
                received += _exactly(connection, 1)
            began, done = time.monotonic(), 0
            while True:
                time.sleep(0.01)
                mode = state.mode
                per_s = state.argument if mode == FLOOD else FRAMES_PER_S
                due = int((time.monotonic() - began) * per_s) - done
                if due < 0 or due > per_s:  # another order, or frozen meanwhile
                    began, done, due = time.monotonic(), 0, 0
                lines = []
                for _ in range(due):
                    payload = state.next().to_bytes(4, "little").hex()
                    lines.append(f"t{FRAME_ID:03x}8{payload}00000000\r")
                    if mode != NORMAL:
                        lines.append(f"t{UNKNOWN_ID:03x}8ffffffff00000000\r")
                    if mode == WRONG:
                        lines.append(f"t{FRAME_ID:03x}3ffffff\r")
                done += due
                connection.sendall("".join(lines).encode())

    _accept(port, serve)


def cable(port: int, target: int) -> None:
    """Hand everything on to another port: killing this is pulling the cable."""

    def one_way(source: socket.socket, sink: socket.socket) -> None:
        try:
            while chunk := source.recv(65536):
                sink.sendall(chunk)
        except OSError:
            pass
        for end in (source, sink):
            end.close()

    def serve(connection: socket.socket) -> None:
        far = socket.create_connection(("127.0.0.1", target))
        threading.Thread(target=one_way, args=(far, connection), daemon=True).start()
        one_way(connection, far)

    _accept(port, serve)


def _accept(port: int, serve: Callable[[socket.socket], None]) -> None:
    def guarded(connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            serve(connection)
        except OSError:
            connection.close()

    server = socket.create_server(("127.0.0.1", port), backlog=16)
    sys.stdout.write("listening\n")
    sys.stdout.flush()
    while True:
        connection, _ = server.accept()
        threading.Thread(target=guarded, args=(connection,), daemon=True).start()


def _hang_up_with(connection: socket.socket) -> None:
    """Answer nobody: a request of before a freeze may come from somebody who has gone since."""
    connection.setblocking(False)
    try:
        gone = not connection.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        gone = False
    finally:
        connection.setblocking(True)
    if gone:
        raise ConnectionError


def _exactly(connection: socket.socket, count: int) -> bytes:
    received = b""
    while len(received) < count:
        chunk = connection.recv(count - len(received))
        if not chunk:
            raise ConnectionError
        received += chunk
    return received


if __name__ == "__main__":
    kind, own_port, other = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    if kind == "cable":
        cable(own_port, int(other))
    else:
        {"modbus": modbus, "can": can}[kind](own_port, State(Path(other)))
