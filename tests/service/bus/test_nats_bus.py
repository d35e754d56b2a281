"""The bus between machines, with a real server that is killed."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Any

import pytest
from nats_server import NatsServer, running_nats

from adapters.protocol import Clock
from service.alarms import UnknownAlarmError
from service.bus import commands
from service.bus.exposition import merged
from service.bus.fleet import Fleet
from service.bus.fleet_following import FleetFollowing
from service.bus.following import packed
from service.bus.interface import STREAM_TOPIC, Handler
from service.bus.messages import Command, State
from service.bus.nats_bus import NatsCellBus, NatsConnection
from service.bus.stream import Bus
from service.clock import ProcessClock
from service.domain.errors import CellUnavailableError
from service.notifications.states import NotificationState
from service.store import Alarm, run_name

PATIENCE_S = 60.0
Handlers = Mapping[type[Command[Any]], Handler]


@pytest.fixture(scope="module")
def nats() -> Iterator[NatsServer]:
    with running_nats() as server:
        yield server


class Cell:
    """A cell that follows some assets and answers with its name."""

    def __init__(self, nats: NatsServer, partitions: Mapping[int, int], assets: list[str]) -> None:
        self.run = run_name()
        self.assets = assets
        self.connection = NatsConnection(nats.url, None, self.run)
        self.bus = NatsCellBus(self.connection, self.run)
        self.stream = Bus(ProcessClock(), self.bus.epoch, on_message=self._hand_on)
        self.followed = 0
        self.tell(partitions)

    def tell(self, partitions: Mapping[int, int]) -> None:
        self.followed += 1
        self.bus.report(
            State(
                ready=True,
                stream=self.stream.seq,
                assets=1,
                partitions=dict(partitions),
                followed=self.followed,
            )
        )

    def _hand_on(self, message: Any) -> None:
        self.bus.publish(STREAM_TOPIC, message.seq, packed(message))

    async def work(self) -> None:
        async def names(_: Any) -> dict[str, int]:
            return dict.fromkeys(self.assets, 1)

        async def documents(command: Any) -> list[commands.Document]:
            return [
                commands.Document(b"tag", f"{one.asset} of {self.bus.epoch}".encode() * 20_000)
                for one in command.wanted
            ]

        async def jobs(command: Any) -> bytes:
            return self.bus.epoch.encode()

        async def act(command: Any) -> Alarm:
            raise UnknownAlarmError("none")

        async def after(command: Any) -> commands.StreamPart:
            messages, forgotten = self.stream.after(command.number, 200)
            return commands.StreamPart(
                self.stream.seq,
                forgotten,
                [commands.StreamMessage(m.seq, m.type, m.asset, m.text) for m in messages],
            )

        async def follow(command: Any) -> commands.StreamMade:
            return commands.StreamMade(self.stream.epoch, self.stream.seq)

        async def metrics(command: Any) -> bytes:
            return b'# HELP up Up.\n# TYPE up gauge\nup{process="cell"} 1.0\n'

        async def notifications(command: Any) -> list[NotificationState]:
            fails = "a" in self.assets
            return [
                NotificationState("mail", len(self.assets), 0, 5, 9 if fails else None, int(fails))
            ]

        async def test(command: Any) -> tuple[bool, str]:
            return True, f"{command.notification} by {self.bus.epoch}"

        handlers: Handlers = {
            commands.AssetNames: names,
            commands.GetNotifications: notifications,
            commands.TestNotification: test,
            commands.GetDocuments: documents,
            commands.GetJobs: jobs,
            commands.ActOnAlarm: act,
            commands.StreamAfter: after,
            commands.FollowStream: follow,
            commands.GetMetrics: metrics,
        }
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.connection.run())
            tasks.create_task(self.bus.serve(handlers))


@contextlib.asynccontextmanager
async def at_work(*things: Any) -> AsyncIterator[list["asyncio.Task[None]"]]:
    tasks = [asyncio.create_task(one) for one in things]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def until(holds: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < ends_s, "waited for a minute"
        await asyncio.sleep(0.02)


def fleet_of(nats: NatsServer, assets: list[str]) -> Fleet:
    async def no_alarms() -> list[Alarm]:
        return []

    return Fleet(NatsConnection(nats.url, None, "test"), 4, lambda: assets, no_alarms)


async def test_each_question_goes_to_the_cell_that_can_answer(nats: NatsServer) -> None:
    one = Cell(nats, {0: 1, 1: 1}, ["a", "b"])
    other = Cell(nats, {2: 1, 3: 1}, ["c"])
    fleet = fleet_of(nats, ["a", "b", "c", "d"])
    async with at_work(one.work(), other.work(), fleet.run()):
        await until(lambda: fleet.state.ready and not fleet.missing() and fleet.state.assets >= 1)
        await until(lambda: set(fleet.cells) == {one.bus.epoch, other.bus.epoch})
        assert list(await fleet.ask(commands.AssetNames(), 30)) == ["a", "b", "c"]
        assert await fleet.ask(commands.GetJobs("c"), 30) == other.bus.epoch.encode()
        wanted = [commands.Wanted(name, "snapshot") for name in "cab"]
        found = await fleet.ask(commands.GetDocuments(wanted), 30)
        owners = [document.text.split()[2][:8].decode() for document in found if document.text]
        assert owners == [other.bus.epoch, one.bus.epoch, one.bus.epoch]
        assert fleet.is_known("d")
        assert not fleet.is_known("e")
        with pytest.raises(CellUnavailableError, match="no cell follows asset 'd'"):
            await fleet.ask(commands.GetJobs("d"), 30)
        with pytest.raises(UnknownAlarmError):
            await fleet.ask(commands.ActOnAlarm("x", "acknowledge", "", ""), 30)
        (mail,) = await fleet.ask(commands.GetNotifications(), 30)
        assert mail == NotificationState("mail", 3, 0, 5, 9, 1)
        told, by = await fleet.ask(commands.TestNotification("mail", "engineer"), 30)
        assert told
        assert by in {f"mail by {cell.bus.epoch}" for cell in (one, other)}, "one cell, once"
        text = (await fleet.ask(commands.GetMetrics(), 30)).decode()
        assert f'up{{cell="cell-{one.bus.epoch}",process="cell"}} 1.0' in text
        assert 'bearing_twin_partition_owner{partition="3"} 1.0' in text


async def test_of_two_that_claim_an_asset_the_later_epoch_has_it(nats: NatsServer) -> None:
    old = Cell(nats, {0: 1, 1: 1, 2: 1, 3: 1}, ["a"])
    fleet = fleet_of(nats, ["a"])
    async with at_work(old.work(), fleet.run()):
        await until(lambda: fleet.state.ready and not fleet.missing())
        new = Cell(nats, {0: 2, 1: 2, 2: 2, 3: 2}, ["a"])
        async with at_work(new.work()):
            await until(lambda: set(fleet.owners().values()) == {new.bus.epoch})
            # The old one wakes and still believes what it knew.
            old.tell({0: 1, 1: 1, 2: 1, 3: 1})
            await until(lambda: len(fleet.alive()) == 2)
            await asyncio.sleep(1.0)
            assert await fleet.ask(commands.GetJobs("a"), 30) == new.bus.epoch.encode()


async def test_messages_that_a_dead_server_swallowed_are_found_by_their_numbers(
    nats: NatsServer,
) -> None:
    cell = Cell(nats, {0: 1, 1: 1, 2: 1, 3: 1}, ["a"])
    fleet = fleet_of(nats, ["a"])
    clock: Clock = ProcessClock()
    bus = Bus(clock)
    following = FleetFollowing(fleet, bus, clock)
    seen: list[int] = []

    def send(number: int) -> None:
        cell.stream.publish("job", "a", {"number": number})
        cell.tell({0: 1, 1: 1, 2: 1, 3: 1})

    async def read() -> None:
        subscription = bus.subscribe()
        while True:
            message = await subscription.get()
            if message.type == "job":
                seen.append(int(message.text.rpartition(":")[2].rstrip("}")))

    async with at_work(cell.work(), fleet.run(), following.run()):
        await until(following.caught_up.is_set)
        async with at_work(read()):
            await asyncio.sleep(0)
            send(1)
            await until(lambda: seen == [1])
            nats.kill()
            await until(lambda: not cell.connection.connected)
            send(2)
            await until(lambda: fleet.away_s > 2.0)
            with pytest.raises(CellUnavailableError):
                await fleet.ask(commands.GetJobs("a"), 1)
            nats.start()
            await until(lambda: fleet.away_s == 0.0)
            send(3)
            await until(lambda: seen[-1:] == [3])
            assert seen in ([1, 2, 3], [1, 3])
            assert len(set(seen)) == len(seen)


def test_metrics_of_cells_do_not_meet() -> None:
    text = b"# HELP n_total N.\n# TYPE n_total counter\nn_total 2.0\n"
    found = merged({"one": text, "two": text}).decode()
    assert found.count("# TYPE n_total counter") == 1
    assert 'n_total{cell="one"} 2.0' in found
    assert 'n_total{cell="two"} 2.0' in found
