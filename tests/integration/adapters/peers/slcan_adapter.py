"""A CAN adapter that speaks slcan over TCP, with the standard library only.

Once its channel is open it sends frames 0x100 (Intel speed, counting up from 8000 in steps of
0.125 rpm) and 0x18FEF100 (Motorola load, 26500) every PERIOD seconds. Commands on standard input:
``pause`` (answered by a line when the last frame is sent), ``go``, ``line TEXT`` (TEXT with
escapes, sent as one line), ``flood N``.
"""

import socket
import sys
import threading
import time


def main(port: int, period_s: float, hang_up: bool) -> None:
    server = socket.create_server(("127.0.0.1", port))
    state = {"running": True, "told": True, "connection": None}

    def commands() -> None:
        for command in sys.stdin:
            word, _, rest = command.rstrip("\n").partition(" ")
            connection = state["connection"]
            if word in ("pause", "go"):
                state["told"] = word == "go"
                state["running"] = word == "go"
            elif word == "line" and connection:
                connection.sendall(rest.encode().decode("unicode_escape").encode("latin-1") + b"\r")
            elif word == "flood" and connection:
                for first in range(0, int(rest), 100):
                    count = min(100, int(rest) - first)
                    connection.sendall(b"t10084069000000000000\r" * count)

    threading.Thread(target=commands, daemon=True).start()
    sys.stdout.write("listening\n")
    sys.stdout.flush()
    speed = 64000
    while True:
        connection, _ = server.accept()
        if hang_up:
            connection.close()
            continue
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            received = b""
            while b"O\r" not in received:
                chunk = connection.recv(64)
                if not chunk:
                    raise ConnectionError
                received += chunk
            state["connection"] = connection
            connection.setblocking(True)
            while True:
                if state["running"]:
                    payload = (speed & 0xFFFF).to_bytes(2, "little") + bytes(6)
                    connection.sendall(
                        f"t1008{payload.hex()}\r".encode() + b"T18FEF10086784000000000000\r"
                    )
                    speed = 8000 if speed >= 64000 else speed + 1
                elif not state["told"]:
                    state["told"] = True
                    sys.stdout.write("paused\n")
                    sys.stdout.flush()
                time.sleep(period_s)
        except OSError:
            state["connection"] = None
            connection.close()


main(int(sys.argv[1]), float(sys.argv[2]), len(sys.argv) > 3)
