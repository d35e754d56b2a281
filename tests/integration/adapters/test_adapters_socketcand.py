"""The handshake of a socketcand server, as busy buses, slow and broken servers give it."""

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import can
import pytest

from adapters.drivers.can import bus as can_bus
from adapters.drivers.can.bus import close_bus, open_bus
from adapters.drivers.can.config import CanSource

pytestmark = pytest.mark.wires

FRAME = b"< frame 200 1.000000 7017D204 >"
Serve = Callable[[Sequence[bytes]], int]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Serve one client with these answers: a greeting, then one to each thing it sends."""
    threads: list[threading.Thread] = []
    done = threading.Event()
    sockets: list[socket.socket] = []

    def start(answers: Sequence[bytes]) -> int:
        server = socket.create_server(("127.0.0.1", 0))
        sockets.append(server)

        def attend() -> None:
            connection, _ = server.accept()
            with connection:
                for number, answer in enumerate(answers):
                    if number:
                        connection.recv(256)
                    for piece in answer.split(b"|"):
                        connection.sendall(piece)
                        time.sleep(0.02)
                if len(answers) == 3:
                    done.wait(10)

        threads.append(threading.Thread(target=attend))
        threads[-1].start()
        return int(server.getsockname()[1])

    yield start
    done.set()
    for thread in threads:
        thread.join()
    for server in sockets:
        server.close()


def source(port: int) -> CanSource:
    return CanSource.model_validate(
        {
            "name": "drive",
            "interface": "socketcand",
            "channel": "can0",
            "dbc": Path(__file__).parents[2] / "adapters" / "bench.dbc",
            "host": "127.0.0.1",
            "port": port,
        }
    )


@pytest.mark.parametrize(
    "answers",
    [
        pytest.param([b"< hi >", b"< ok >", b"< ok >" + FRAME + FRAME], id="frames right behind"),
        pytest.param(
            [b"< h|i >", b"< o|k >", b"<| ok |>|" + FRAME[:9] + b"|" + FRAME[9:]], id="torn"
        ),
    ],
)
def test_a_bus_is_opened_however_its_answers_come(serve: Serve, answers: list[bytes]) -> None:
    bus = open_bus(source(serve(answers)))
    try:
        frame = None
        until = time.monotonic() + 5
        while frame is None and time.monotonic() < until:
            frame = bus.recv(0.25)
        assert frame is not None
        assert (frame.arbitration_id, bytes(frame.data)) == (0x200, bytes.fromhex("7017D204"))
    finally:
        close_bus(bus)


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ([b"< hi >", b"< error could not open bus >"], "expected '< ok >', got '< error could not"),
        ([b"< hi >", b"x" * 5000], "expected '< ok >', got 'xxxx"),
        ([b"< hi >"], "the server closed the connection instead of '< ok >'"),
        ([b"", b"", b""], "no '< hi >' within 0.3 s"),
    ],
)
def test_what_is_no_handshake_is_said_soon(
    serve: Serve, answers: list[bytes], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can_bus, "OPEN_TIMEOUT_S", 0.3)
    with pytest.raises(can.CanError, match=said):
        open_bus(source(serve(answers)))


def test_a_server_that_is_not_there_is_asked_once(free_port: int) -> None:
    began_s, began_cpu_s = time.monotonic(), time.thread_time()
    with pytest.raises(ConnectionRefusedError):
        open_bus(source(free_port))
    assert time.monotonic() - began_s < 5
    assert time.thread_time() - began_cpu_s < 0.5
