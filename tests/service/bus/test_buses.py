"""What every bus promises: numbered changes, commands with a bound and a deadline each."""

import asyncio
import contextlib
import stat
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import pytest
from patience import within

from service.bus import dispatch
from service.bus.calls import command_type
from service.bus.interface import CellBus, Handlers, ReaderBus
from service.bus.local import QUEUE, LocalCellBus, LocalReaderBus
from service.bus.memory import MemoryBus
from service.bus.messages import Call, CellState, Request, encode
from service.bus.places import LONGEST, bus_folder
from service.documents.identification import JobDocument
from service.domain.errors import (
    CellUnavailableError,
    JobConflictError,
    RequestRefusedError,
    ServiceError,
)

JOB = JobDocument(
    id="a1",
    status="running",
    progress=0.5,
    best_fitness=None,
    evaluations=3,
    created_at="2026-11-21T08:00:00.000Z",
    started_at=None,
    ended_at=None,
    error=None,
    model_version=None,
    windows=[],
    method="noa",
    seed=1,
    budget=None,
    requested_by="automatic",
    attempts=1,
    phase=None,
    seconds_left=None,
    active_fitness=None,
)


class Part(Protocol):
    @Call()
    async def double(self, number: int) -> int: ...

    @Call()
    async def fail(self, kind: str) -> None: ...

    @Call()
    async def wait(self) -> bool: ...


Double, Fail, Wait = (command_type(one) for one in (Part.double, Part.fail, Part.wait))


async def double(command: Any) -> int:
    return 2 * command.number


async def fail(command: Any) -> None:
    errors: dict[str, Exception] = {
        "refused": RequestRefusedError("/windows/0", "no data"),
        "conflict": JobConflictError("identification a1 is running", JOB),
        "key": KeyError(7),
        "fault": ZeroDivisionError("secret figures"),
    }
    raise errors[command.kind]


async def until(condition: Callable[[], object]) -> None:
    for _ in range(3000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("waited for half a minute")


@contextlib.asynccontextmanager
async def joined(
    kind: str, folder: Path, handlers: Handlers
) -> AsyncIterator[tuple[CellBus, ReaderBus]]:
    """Both ends of a bus, at work."""
    cell: Any
    reader: Any
    if kind == "memory":
        cell = reader = MemoryBus()
    else:
        cell, reader = LocalCellBus(folder), LocalReaderBus(folder)
    tasks = [asyncio.create_task(cell.serve(handlers)), asyncio.create_task(reader.run())]
    try:
        await until(lambda: reader.away_s < 1)
        await asyncio.sleep(0)
        yield cell, reader
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if kind == "local":
            reader.close()
            cell.close()


@pytest.fixture(params=["memory", "local"])
def kind(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


async def test_commands_are_answered(kind: str, tmp_path: Path) -> None:
    async with joined(kind, tmp_path, {Double: double}) as (_, reader):
        answers = await asyncio.gather(*(reader.ask(Double(n), 30) for n in range(100)))
        assert answers == [2 * n for n in range(100)]


async def test_errors_of_the_domain_come_out_as_they_went_in(kind: str, tmp_path: Path) -> None:
    async with joined(kind, tmp_path, {Fail: fail}) as (_, reader):
        with pytest.raises(RequestRefusedError) as refused:
            await reader.ask(Fail("refused"), 30)
        assert (refused.value.pointer, refused.value.detail) == ("/windows/0", "no data")
        with pytest.raises(JobConflictError) as conflict:
            await reader.ask(Fail("conflict"), 30)
        assert conflict.value.job == JOB
        assert str(conflict.value) == "identification a1 is running"
        with pytest.raises(KeyError) as key:
            await reader.ask(Fail("key"), 30)
        assert key.value.args == (7,)
        with pytest.raises(RuntimeError, match="ZeroDivisionError") as fault:
            await reader.ask(Fail("fault"), 30)
        assert "secret" not in str(fault.value)


async def test_a_command_that_takes_too_long_is_given_up_on_both_sides(
    kind: str, tmp_path: Path
) -> None:
    ended: list[bool] = []

    async def wait(command: Any) -> bool:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append(True)
        return True

    async with joined(kind, tmp_path, {Wait: wait}) as (_, reader):
        with pytest.raises(CellUnavailableError):
            await reader.ask(Wait(), 0.05)
        await until(lambda: ended)


async def test_a_caller_has_so_many_commands_under_way_and_no_more(
    kind: str, tmp_path: Path
) -> None:
    go_on = asyncio.Event()
    running = 0

    async def wait(command: Any) -> bool:
        nonlocal running
        running += 1
        await go_on.wait()
        return True

    async with joined(kind, tmp_path, {Wait: wait, Double: double}) as (_, reader):
        asked = [
            asyncio.create_task(reader.ask(Wait(), 60)) for _ in range(dispatch.AT_ONCE_EACH + 50)
        ]
        await until(lambda: sum(task.done() for task in asked) == 50)
        await until(lambda: running >= dispatch.AT_ONCE_EACH)  # they begin one after the other
        assert running == dispatch.AT_ONCE_EACH
        go_on.set()
        answers = await asyncio.gather(*asked, return_exceptions=True)
        assert answers.count(True) == dispatch.AT_ONCE_EACH
        assert sum(isinstance(one, CellUnavailableError) for one in answers) == 50
        assert await reader.ask(Double(4), 30) == 8


async def test_a_reader_that_does_not_read_sees_what_it_missed_by_the_numbers(
    kind: str, tmp_path: Path
) -> None:
    async with joined(kind, tmp_path, {}) as (cell, reader):
        changes = reader.changes("values")
        first = asyncio.ensure_future(anext(changes))
        number = 0
        async with within(30):
            while not first.done():  # a subscription takes a moment
                number += 1
                cell.publish("values", number, b"x")
                await asyncio.sleep(0.005)
        begun_s = time.monotonic()
        last = number + 20 * QUEUE
        for one in range(number + 1, last + 1):
            cell.publish("values", one, b"x" * 500)
        assert time.monotonic() - begun_s < 20.0, "the cell has waited for its reader"
        seen = [first.result()]

        async def read_on() -> None:
            while seen[-1].body != b"end":
                seen.append(await anext(changes))

        reading = asyncio.create_task(read_on())
        async with within(60):
            while not reading.done():
                last += 1
                cell.publish("values", last, b"end")
                await asyncio.sleep(0.01)
        numbers = [change.number for change in seen]
        assert numbers == sorted(numbers)
        holes = sum(after - before - 1 for before, after in pairwise(numbers))
        assert holes > 0
        assert {change.epoch for change in seen} == {cell.epoch}


async def test_a_cell_that_starts_again_is_found_again(tmp_path: Path) -> None:
    reader = LocalReaderBus(tmp_path)
    following = asyncio.create_task(reader.run())
    with pytest.raises(CellUnavailableError):
        await reader.ask(Double(1), 5)
    epochs = []
    try:
        for _ in range(3):
            cell = LocalCellBus(tmp_path)
            cell.report(CellState("the store"))
            serving = asyncio.create_task(cell.serve({Double: double}))
            await until(lambda epoch=cell.epoch: reader.epoch == epoch)  # type: ignore[misc]
            epochs.append(reader.epoch)
            assert reader.state.waits_for == "the store"
            assert await reader.ask(Double(21), 30) == 42
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            cell.close()
    finally:
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        reader.close()
    assert len(set(epochs)) == 3


async def test_a_command_that_waited_for_a_dead_cell_is_not_done_afterwards(tmp_path: Path) -> None:
    done: list[int] = []

    async def note(command: Any) -> int:
        done.append(command.number)
        return 0

    async with joined("local", tmp_path, {Double: note}) as (_, reader):
        assert isinstance(reader, LocalReaderBus)
        # As if it had been queued while the cell was away.
        late = Request(1, time.monotonic() - 0.001, Double.__name__, encode(Double(1)))  # type: ignore[arg-type]
        reader._send(encode(late), 30.0)
        await reader.ask(Double(2), 30)
        assert done == [2]


@pytest.mark.wires
async def test_a_flood_of_anything_leaves_the_cell_its_time(tmp_path: Path) -> None:
    late_s: list[float] = []

    async def poll() -> None:
        while True:
            begun_s = time.monotonic()
            await asyncio.sleep(0.02)
            late_s.append(time.monotonic() - begun_s - 0.02)

    async with joined("local", tmp_path, {Double: double}) as (_, reader):
        polling = asyncio.create_task(poll())
        script = (
            "import sys, time, zmq\n"
            "s = zmq.Context().socket(zmq.DEALER); s.linger = 0; s.connect(sys.argv[1])\n"
            "end = time.monotonic() + 3\n"
            "while time.monotonic() < end: s.send(b'\\xc1' * 200)\n"
        )
        address = f"ipc://{tmp_path / 'bus-commands'}"
        flood = await asyncio.create_subprocess_exec(sys.executable, "-c", script, address)
        answers = 0
        while flood.returncode is None:
            with contextlib.suppress(CellUnavailableError):
                answers += await reader.ask(Double(1), 5) == 2
            await asyncio.sleep(0.01)
        polling.cancel()
        assert answers > 20, "others are answered meanwhile"
        late_s.sort()
        assert late_s[len(late_s) // 2] < 0.02, "polls go on"


async def test_the_sockets_are_private_and_left_ones_are_replaced(tmp_path: Path) -> None:
    for name in ("bus-changes", "bus-commands"):
        (tmp_path / name).write_text("left by an earlier run")
    async with joined("local", tmp_path, {Double: double}) as (_, reader):
        assert await reader.ask(Double(3), 30) == 6
        for name in ("bus-changes", "bus-commands"):
            assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o600


async def test_a_data_directory_with_a_long_path_has_its_sockets_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As short as the real one; that of a test's worker is not.
    with tempfile.TemporaryDirectory() as runtime:
        monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
        data_dir = tmp_path / ("x" * LONGEST)
        data_dir.mkdir()
        folder = bus_folder(data_dir)
        assert folder != data_dir
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        async with joined("local", data_dir, {Double: double}) as (_, reader):
            assert await reader.ask(Double(3), 30) == 6
        assert bus_folder(data_dir / ".." / data_dir.name) == folder


def test_a_place_of_the_sockets_is_one_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data_dir = tmp_path / ("x" * LONGEST)
    data_dir.mkdir()
    long = tmp_path / ("t" * LONGEST)
    long.mkdir()
    with tempfile.TemporaryDirectory() as runtime:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
        monkeypatch.setenv("TMPDIR", runtime)
        folder = bus_folder(data_dir)
        assert folder.parent == Path(runtime)
        folder.rmdir()
        folder.symlink_to(tmp_path)
        with pytest.raises(ServiceError, match=f"{folder} is not of this user; expected XDG"):
            bus_folder(data_dir)
