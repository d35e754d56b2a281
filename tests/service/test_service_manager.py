"""What systemd hears of the service, on a real socket."""

import asyncio
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from patience import within

from service.app.one_process import serve_in_one_process
from service.service_manager import ServiceManager
from service.site.settings import ServiceSection, Settings

PATIENCE_S = 90.0
BLOCKED_S = 4.0


@pytest.fixture
def manager(monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The end of systemd; its watchdog bites after a second without a sign of life."""
    with (
        tempfile.TemporaryDirectory() as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
    ):
        address = str(Path(folder) / "notify")
        manager.bind(address)
        manager.settimeout(PATIENCE_S)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        monkeypatch.setenv("WATCHDOG_USEC", "1000000")
        yield manager


def hear(manager: socket.socket, wanted: str) -> None:
    while manager.recv(4096).decode() != wanted:
        pass


def heard_now(manager: socket.socket) -> list[str]:
    """All that has been said and not been heard yet."""
    manager.setblocking(False)
    found = []
    try:
        while True:
            found.append(manager.recv(4096).decode())
    except BlockingIOError:
        return found
    finally:
        manager.settimeout(PATIENCE_S)


class Running:
    """A service in a thread of this process, so that a test can block its event loop."""

    def __init__(self, data_dir: Path) -> None:
        self._settings = Settings(service=ServiceSection(data_dir=data_dir, port=0))
        self.loop = asyncio.new_event_loop()
        self._stop, self.is_ready = asyncio.Event(), threading.Event()
        self._thread = threading.Thread(target=self.loop.run_until_complete, args=(self._run(),))
        self._thread.start()

    async def _run(self) -> None:
        await serve_in_one_process(
            self._settings, announce=lambda _: self.is_ready.set(), stop=self._stop
        )

    def end(self) -> None:
        self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        self.loop.close()


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[[], Running]]:
    started: list[Running] = []

    def begin() -> Running:
        started.append(Running(tmp_path))
        return started[-1]

    yield begin
    for service in started:
        if not service.loop.is_closed():
            service.end()


@pytest.mark.wires
def test_it_says_ready_alive_and_stopping_and_nothing_while_the_loop_is_blocked(
    manager: socket.socket, run: Callable[[], Running]
) -> None:
    service = run()
    hear(manager, "READY=1")
    hear(manager, "WATCHDOG=1")
    assert service.is_ready.wait(PATIENCE_S)
    hear(manager, "WATCHDOG=1")
    blocked, free = threading.Event(), threading.Event()

    def block() -> None:
        blocked.set()
        time.sleep(BLOCKED_S)
        # Still within the same turn of the loop.
        free.set()

    service.loop.call_soon_threadsafe(block)
    assert blocked.wait(PATIENCE_S)
    heard_now(manager)
    time.sleep(BLOCKED_S / 2)
    while_blocked = heard_now(manager)
    assert not free.is_set()
    assert while_blocked == []
    hear(manager, "WATCHDOG=1")
    service.end()
    hear(manager, "STOPPING=1")


def test_it_gives_no_sign_of_life_when_its_work_does_not_go_on(manager: socket.socket) -> None:
    async def watch() -> None:
        looks = 0

        def is_alive() -> bool:
            nonlocal looks
            looks += 1
            return looks == 1

        watching = asyncio.create_task(ServiceManager().watch(is_alive))
        async with within(PATIENCE_S):
            while looks < 4:  # noqa: ASYNC110 - there is nothing to wait for
                await asyncio.sleep(0.01)
        watching.cancel()

    asyncio.run(watch())
    assert heard_now(manager) == ["WATCHDOG=1"]


def test_without_a_manager_nothing_is_sent_and_nothing_fails() -> None:
    manager = ServiceManager({})
    manager.ready()
    ServiceManager({"NOTIFY_SOCKET": "/nowhere/at/all"}).ready()


def test_an_abstract_address_is_understood() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0bearing-twin-test-{id(manager)}")
        manager.settimeout(PATIENCE_S)
        ServiceManager({"NOTIFY_SOCKET": f"@bearing-twin-test-{id(manager)}"}).status("two\nlines")
        assert manager.recv(4096) == b"STATUS=two lines"
