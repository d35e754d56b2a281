"""Pushes of a fleet while the bus is away, or a cell stands still: on the disk, and handed over."""

import asyncio
import contextlib
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from nats_server import NatsServer, at_work, running_nats, until

from adapters.samples import Sample
from service.bus import commands
from service.bus.asking import caller_role
from service.bus.calls import command_type
from service.bus.fleet_cells import Fleet
from service.bus.messages import CellState
from service.bus.nats_bus import NatsCellBus, NatsConnection
from service.bus.pushed_samples import PackedSamples, PushedSamples
from service.domain.errors import CellUnavailableError, PushRefusedError
from service.store.ownership import run_name
from service.web.cell import CellIngest
from service.web.waiting_pushes import FILE_NAME, WaitingPushes


def push(asset: str, *times: int) -> list[Sample]:
    return [Sample(asset, "x", time_us, float(time_us), 192, 7) for time_us in times]


class Receiver:
    """Takes what waits, but for some assets."""

    def __init__(self) -> None:
        self.taken: list[tuple[str, int]] = []
        self.away: set[str] = set()

    async def __call__(self, asset: str, samples: PackedSamples, received_us: int) -> None:
        await asyncio.sleep(0)
        if asset in self.away:
            raise CellUnavailableError("no cell")
        for one in samples.unpack(asset, received_us):
            assert (one.value, one.quality, one.received_us) == (float(one.time_us), 192, 7)
            self.taken.append((one.asset, one.time_us))

    def of(self, asset: str) -> list[int]:
        return [time_us for name, time_us in self.taken if name == asset]


async def test_pushes_are_handed_over_in_their_order_and_forgotten(tmp_path: Path) -> None:
    receiver = Receiver()
    with WaitingPushes.open(tmp_path, 16) as waiting:
        await asyncio.gather(
            *(
                waiting.keep(name, push(name, 10 * number, 10 * number + 1), 7)
                for number in range(70)
                for name in ("a", "b")
            )
        )
        assert (len(waiting), waiting.holds("a"), waiting.holds("c")) == (140, True, False)
        assert waiting.problem().status == "degraded"
        async with at_work(waiting.run(receiver)):
            await until(lambda: not (len(waiting) or waiting.holds("a")))
        expected = [10 * number + k for number in range(70) for k in (0, 1)]
        assert receiver.of("a") == receiver.of("b") == expected
        assert waiting.problem().status == "ok"


async def test_an_asset_without_a_cell_holds_up_no_other_and_no_push_is_lost(
    tmp_path: Path,
) -> None:
    receiver = Receiver()
    receiver.away = {"a"}
    with WaitingPushes.open(tmp_path, 16) as waiting:
        async with at_work(waiting.run(receiver)):
            for time_us in range(5):
                await waiting.keep("a", push("a", time_us), 7)
                await waiting.keep("b", push("b", time_us), 7)
            await until(lambda: receiver.of("b") == list(range(5)))
            assert receiver.of("a") == []
            receiver.away = set()
            await until(lambda: not len(waiting))
            assert receiver.of("a") == list(range(5))


async def test_what_waits_outlives_the_process(tmp_path: Path) -> None:
    receiver = Receiver()
    with WaitingPushes.open(tmp_path, 16) as waiting:
        await waiting.keep("a", push("a", 1), 7)
        # On the disk, whatever becomes of the process: another connection sees it.
        with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME)) as file:
            assert file.execute("SELECT COUNT(*) FROM pushes").fetchone() == (1,)
    with WaitingPushes.open(tmp_path, 16) as waiting:
        assert waiting.holds("a")
        async with at_work(waiting.run(receiver)):
            await waiting.keep("a", push("a", 2), 7)
            await until(lambda: not len(waiting))
    assert receiver.of("a") == [1, 2]


async def test_a_full_disk_share_refuses_what_does_not_fit_and_keeps_the_rest(
    tmp_path: Path,
) -> None:
    receiver, kept = Receiver(), 0
    with WaitingPushes.open(tmp_path, 1) as waiting:

        async def fill() -> None:
            nonlocal kept
            while kept < 10**6:
                await waiting.keep("a", push("a", *range(kept, kept + 10_000)), 7)
                kept += 10_000

        with pytest.raises(PushRefusedError, match="used up") as refused:
            await fill()
        assert refused.value.retry_after_s > 0
        assert 20_000 <= kept < 100_000
        async with at_work(waiting.run(receiver)):
            await until(lambda: not len(waiting))
            await waiting.keep("a", push("a", kept), 7)
            await until(lambda: not len(waiting))
    assert receiver.of("a") == list(range(kept + 1))


async def test_a_damaged_push_is_left_out(tmp_path: Path) -> None:
    receiver = Receiver()
    with WaitingPushes.open(tmp_path, 16) as waiting:
        for time_us in range(3):
            await waiting.keep("a", push("a", time_us), 7)
    with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME, isolation_level=None)) as file:
        file.execute("UPDATE pushes SET received_us = 8 WHERE number = 2")
    with WaitingPushes.open(tmp_path, 16) as waiting:
        async with at_work(waiting.run(receiver)):
            await until(lambda: not len(waiting))
    assert receiver.of("a") == [0, 2]


# ---------------------------------------------------------------------- with a real bus
@pytest.fixture(scope="module")
def nats() -> Iterator[NatsServer]:
    with running_nats() as server:
        yield server


class Cell:
    """A cell that takes samples of one asset, and counts how often it has each."""

    def __init__(self, nats: NatsServer, asset: str = "a", partition: int = 0) -> None:
        self.asset, self.partition = asset, partition
        run = self.run = run_name()
        self.stored: dict[int, int] = {}
        self.hangs = self.is_full = False
        self.connection = NatsConnection(nats.url, None, run)
        self.bus = NatsCellBus(self.connection, run)
        self.bus.report(CellState(ready=True, assets=1, partitions={partition: 1}, followed=1))

    async def owns(self) -> dict[int, tuple[int, str]]:
        return {self.partition: (1, self.run)}

    async def work(self) -> None:
        async def names(_: Any) -> dict[str, int]:
            return {self.asset: 1}

        async def take(command: Any) -> commands.Taken:
            if self.is_full:
                raise PushRefusedError("200000 samples already wait to be stored", 60)
            if self.hangs:
                await asyncio.Event().wait()
            samples = command.samples
            for one in samples.unpack(7, 0, len(samples)):
                self.stored[one.time_us] = self.stored.get(one.time_us, 0) + 1
            return commands.Taken(len(samples), 0, 0)

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.connection.run())
            tasks.create_task(
                self.bus.serve(
                    {
                        command_type(commands.Assets.names): names,
                        command_type(commands.Pushes.take): take,
                    }
                )
            )


@pytest.mark.wires
async def test_while_the_bus_is_away_every_push_is_accepted_and_stored_once_it_is_back(
    nats: NatsServer, tmp_path: Path
) -> None:
    cell = Cell(nats)
    fleet = Fleet(NatsConnection(nats.url, None, "web"), 1, lambda: ["a"], _no_alarms, cell.owns)
    caller_role.set("gateway")
    with WaitingPushes.open(tmp_path, 16) as waiting:
        ingest = CellIngest(fleet, 0, waiting)
        async with at_work(cell.work(), fleet.run(), waiting.run(ingest.hand_over)):
            await until(lambda: fleet.state.ready)
            assert (await ingest.accept("a", push("a", 1), (), 7, 5.0)).stored == 1
            assert cell.stored == {1: 1}
            await asyncio.to_thread(nats.kill)
            for time_us in range(2, 12):
                counts = await ingest.accept("a", push("a", time_us), (), 7, 5.0)
                assert counts == (1, 0)
            assert cell.stored == {1: 1}
            await asyncio.to_thread(nats.start)
            await until(lambda: not len(waiting))
            assert sorted(cell.stored) == list(range(1, 12))
            assert (await ingest.accept("a", push("a", 12), (), 7, 5.0)).stored == 1
            assert len(waiting) == 0, "the cell has it"


@pytest.mark.wires
async def test_a_cell_that_stands_still_costs_a_pusher_less_than_six_seconds(
    nats: NatsServer, tmp_path: Path
) -> None:
    cell, other = Cell(nats), Cell(nats)
    fleet = Fleet(NatsConnection(nats.url, None, "web"), 1, lambda: ["a"], _no_alarms, cell.owns)
    caller_role.set("gateway")
    with WaitingPushes.open(tmp_path, 16) as waiting:
        ingest = CellIngest(fleet, 0, waiting)
        async with at_work(fleet.run(), waiting.run(ingest.hand_over)):
            async with at_work(cell.work()):
                await until(lambda: fleet.state.ready)
                assert (await ingest.accept("a", push("a", 1), (), 7, 5.0)).stored == 1
            # Nothing of it is heard any more, and nobody says that it has gone.
            began_s = time.monotonic()
            await ingest.accept("a", push("a", 2), (), 7, 5.0)
            await ingest.accept("a", push("a", 3), (), 7, 5.0)
            assert time.monotonic() - began_s < 6.0
            assert len(waiting) == 2
            async with at_work(other.work()):
                await until(lambda: not len(waiting))
                assert sorted(other.stored) == [2, 3]


@pytest.mark.wires
@pytest.mark.parametrize("fault", ["hangs", "is_full"])
async def test_a_cell_that_lives_but_takes_nothing_refuses_no_pusher(
    nats: NatsServer, tmp_path: Path, fault: str
) -> None:
    """Its loop goes on and its store does not, or it has no room: there is room on this disk."""
    cell = Cell(nats)
    fleet = Fleet(NatsConnection(nats.url, None, "web"), 1, lambda: ["a"], _no_alarms, cell.owns)
    caller_role.set("gateway")
    with WaitingPushes.open(tmp_path, 16) as waiting:
        ingest = CellIngest(fleet, 0, waiting)
        async with at_work(cell.work(), fleet.run(), waiting.run(ingest.hand_over)):
            await until(lambda: fleet.state.ready)
            setattr(cell, fault, True)
            began_s = time.monotonic()
            assert await ingest.accept("a", push("a", 1), (), 7, 10.0) == (1, 0)
            assert await ingest.accept("a", push("a", 2), (), 7, 10.0) == (1, 0)
            assert time.monotonic() - began_s < 6.0
            assert (cell.stored, len(waiting)) == ({}, 2)
            setattr(cell, fault, False)
            await until(lambda: not len(waiting))
            assert sorted(cell.stored) == [1, 2]


async def _no_alarms() -> list[Any]:
    return []


@pytest.mark.wires
async def test_a_push_for_many_goes_to_the_cell_of_each_and_what_none_takes_waits_here(
    nats: NatsServer, tmp_path: Path
) -> None:
    cells = {"a": Cell(nats, "a", 0), "b": Cell(nats, "b", 1)}

    async def owners() -> dict[int, tuple[int, str]]:
        return {n: owned for cell in cells.values() for n, owned in (await cell.owns()).items()}

    connection = NatsConnection(nats.url, None, "web")
    fleet = Fleet(connection, 2, lambda: ["a", "b", "c"], _no_alarms, owners)
    caller_role.set("gateway")

    nothing = PushedSamples.of(())

    def samples(time_us: int, *assets: str) -> PushedSamples:
        return PushedSamples.of(one for name in assets for one in push(name, time_us))

    with WaitingPushes.open(tmp_path, 16) as waiting:
        ingest = CellIngest(fleet, 0, waiting)
        async with at_work(*(cell.work() for cell in cells.values()), fleet.run()):
            await until(lambda: fleet.state.ready and all(map(fleet._owner, "ab")))
            counts, left = await ingest.accept_all(samples(1, "a", "b", "c"), nothing, 7, 5.0)
            assert (counts, left) == ((3, 0), ())
            assert [cell.stored for cell in cells.values()] == [{1: 1}, {1: 1}]
            assert [waiting.holds(name) for name in "abc"] == [False, False, True]
            # One cell has no room: the samples of the other are stored once, and not here.
            cells["b"].is_full = True
            counts, _ = await ingest.accept_all(samples(2, "a", "b"), nothing, 7, 5.0)
            assert counts == (2, 0)
            assert [cell.stored for cell in cells.values()] == [{1: 1, 2: 1}, {1: 1}]
            assert [waiting.holds(name) for name in "abc"] == [False, True, True]
            cells["b"].is_full = False
            handing_over = asyncio.create_task(waiting.run(ingest.hand_over))
            await until(lambda: not waiting.holds("b"))
            handing_over.cancel()
            assert cells["b"].stored == {1: 1, 2: 1}
            assert len(waiting) == 1, "no cell has c"
