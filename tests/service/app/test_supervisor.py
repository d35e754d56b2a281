"""The supervisor with real processes: what dies is started again alone, what ends ends in order."""

import asyncio
import contextlib
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
import small_sides
from patience import within

from service.app import supervisor
from service.app.sides import sides_of
from service.app.supervisor import Side, SideEndedError, run_sides
from service.domain.sides import SideName
from service.service_manager import ServiceManager
from service.site.settings import MqttSection, ServiceSection, Settings

pytestmark = pytest.mark.wires

PATIENCE_S = 60.0

Work = Callable[..., None]


class Supervised:
    """Sides under a supervisor in this process."""

    def __init__(self, folder: Path, works: dict[SideName, Work], silent_s: float) -> None:
        settings = Settings(service=ServiceSection(data_dir=folder))
        self.listener = socket.create_server(("127.0.0.1", 0))
        listening: asyncio.Future[socket.socket] = asyncio.get_running_loop().create_future()
        listening.set_result(self.listener)
        self.folder = folder
        self.stop, self.ready = asyncio.Event(), asyncio.Event()
        self.sides = [
            Side(
                name,
                settings,
                listening if name == "web" else None,
                work=work,
                silent_s=silent_s,
            )
            for name, work in works.items()
        ]
        self.task = asyncio.create_task(
            run_sides(
                self.sides, manager=ServiceManager({}), on_ready=self.ready.set, stop=self.stop
            )
        )

    async def starts_of(self, side: str, number: int) -> list[int]:
        """Processes that a side has had, when it has been ready so many times."""
        async with within(PATIENCE_S):
            while True:
                ready = [
                    pid
                    for event, pid, _ in small_sides.events(self.folder, side)
                    if event == "ready"
                ]
                if len(ready) >= number:
                    return ready
                assert not self.task.done()
                await asyncio.sleep(0.02)

    async def who_answers(self) -> int:
        """Connect as a caller does; a connection waits while there is no web side."""
        reader, writer = await asyncio.open_connection(*self.listener.getsockname()[:2])
        async with within(PATIENCE_S):
            answer = await reader.read()
        writer.close()
        return int(answer)


@contextlib.asynccontextmanager
async def supervised(
    folder: Path, works: dict[SideName, Work], silent_s: float = 30.0
) -> AsyncIterator[Supervised]:
    running = Supervised(folder, works, silent_s)
    try:
        yield running
    finally:
        running.stop.set()
        with contextlib.suppress(SideEndedError):
            await running.task
        running.listener.close()


async def gone(pid: int) -> None:
    """Wait for the end of a process."""
    async with within(PATIENCE_S):
        with contextlib.suppress(ProcessLookupError):
            while True:
                os.kill(pid, 0)
                await asyncio.sleep(0.01)


ALL: dict[SideName, Work] = {"cell": small_sides.behaves, "web": small_sides.behaves}


async def test_a_side_that_is_killed_is_started_again_and_the_others_go_on(tmp_path: Path) -> None:
    async with supervised(tmp_path, ALL) as running:
        await running.ready.wait()
        cell = await running.starts_of("cell", 1)
        for number in range(1, 6):
            web = await running.starts_of("web", number)
            assert await running.who_answers() == web[-1]
            os.kill(web[-1], signal.SIGKILL)
            await gone(web[-1])
            # Nobody is refused: the supervisor holds the socket.
            assert await running.who_answers() != web[-1]
        assert await running.starts_of("cell", 1) == cell


#: No test waits so long: what is ended was seen to hang.
NEVER_S = 1000.0


async def test_a_side_that_stands_still_is_killed_and_started_again(tmp_path: Path) -> None:
    async with supervised(tmp_path, ALL, silent_s=NEVER_S) as running:
        await running.ready.wait()
        first = await running.starts_of("cell", 1)
        os.kill(first[0], signal.SIGSTOP)
        both = await running.starts_of("cell", 2)
        assert both[0] == first[0]
        with pytest.raises(ProcessLookupError):
            os.kill(first[0], 0)


async def test_a_side_that_computes_without_end_is_killed_and_started_again(
    tmp_path: Path,
) -> None:
    works: dict[SideName, Work] = {"cell": small_sides.behaves, "web": small_sides.spins}
    async with supervised(tmp_path, works, silent_s=NEVER_S) as running:
        both = await running.starts_of("web", 2)
        with pytest.raises(ProcessLookupError):
            os.kill(both[0], 0)
        assert len(await running.starts_of("cell", 1)) == 1


async def test_a_side_that_finds_no_room_for_its_process_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with supervised(tmp_path, ALL) as running:
        (web,) = await running.starts_of("web", 1)
        await running.starts_of("cell", 1)
        with monkeypatch.context() as full:

            def refuse(*_: object) -> None:
                raise BlockingIOError(11, "Resource temporarily unavailable")

            full.setattr("service.app.supervisor.start", refuse)
            os.kill(web, signal.SIGKILL)
            await asyncio.sleep(1.0)
            assert not running.task.done()
        await running.starts_of("web", 2)
        assert len(await running.starts_of("cell", 1)) == 1


async def test_under_systemd_the_sides_give_their_own_signs_of_life(tmp_path: Path) -> None:
    """The environment of systemd names the supervisor alone as the one whose signs it expects."""
    script = tmp_path / "serve.py"
    script.write_text(
        "import os, small_sides\n"
        "from service.app import sides\n"
        "from service.service_manager import ServiceManager\n"
        "from service.site.settings import Settings\n"
        "async def signs(side, settings, stop, listener):\n"
        "    print(ServiceManager()._watchdog_s, flush=True)\n"
        "sides.run_side = signs\n"
        "sides.side_process('cell', Settings(), {'WATCHDOG_USEC': '30000000'}, None)\n"
    )
    environment = os.environ | {
        "PYTHONPATH": str(Path(small_sides.__file__).parent),
        "WATCHDOG_PID": str(os.getpid()),
    }
    process = await asyncio.create_subprocess_exec(
        sys.executable, script, env=environment, stdout=asyncio.subprocess.PIPE
    )
    out, _ = await process.communicate()
    assert process.returncode == 0
    assert out.decode() == "30.0\n"


async def test_at_the_end_the_cell_ends_last(tmp_path: Path) -> None:
    async with supervised(tmp_path, ALL) as running:
        await running.ready.wait()
        await running.starts_of("cell", 1)
        await running.starts_of("web", 1)
    ended = {side: small_sides.events(tmp_path, side)[-1] for side in ("cell", "web")}
    assert [event for event, _, _ in ended.values()] == ["ended", "ended"]
    assert ended["web"][2] < ended["cell"][2]


async def test_a_side_that_refuses_ends_the_service_with_its_status(tmp_path: Path) -> None:
    works: dict[SideName, Work] = {"cell": small_sides.refuses, "web": small_sides.behaves}
    async with supervised(tmp_path, works) as running:
        with pytest.raises(SideEndedError) as caught:
            await running.task
    assert caught.value.status == os.EX_TEMPFAIL
    assert [event for event, _, _ in small_sides.events(tmp_path, "cell")] == ["refused"]


async def test_a_side_that_does_not_end_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(supervisor.STOP_S, "web", 0.5)
    works: dict[SideName, Work] = {"cell": small_sides.behaves, "web": small_sides.never_ends}
    async with supervised(tmp_path, works) as running:
        pids = await running.starts_of("web", 1)
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)
    assert small_sides.events(tmp_path, "cell")[-1][0] == "ended"


async def test_the_plant_side_runs_only_where_something_is_enabled() -> None:
    assert sides_of(Settings()) == ("cell", "web")
    assert sides_of(Settings(mqtt=MqttSection(enabled=True))) == ("cell", "web", "plant")
