"""The bus between machines, with a real server that is killed."""

import asyncio
from collections.abc import Iterator, Mapping
from typing import Any, Literal, Protocol

import pytest
from nats_server import NatsServer, at_work, running_nats, until

from adapters.protocol import Clock
from service.alarms import UnknownAlarmError
from service.bus import commands
from service.bus.asking import caller_role
from service.bus.calls import call, command_type
from service.bus.commands import HealthCheck
from service.bus.exposition import merged
from service.bus.fleet_cells import Fleet
from service.bus.fleet_following import FleetFollowing
from service.bus.following import packed
from service.bus.health_reports import HealthReports
from service.bus.interface import HEALTH_TOPIC, METRICS_TOPIC, STREAM_TOPIC, Handlers
from service.bus.messages import Call, CellState, encode
from service.bus.nats_bus import NatsCellBus, NatsConnection
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.domain.errors import CellUnavailableError, RoleRefusedError
from service.features.notifications.interface import Notifications, NotificationState
from service.store import Alarm
from service.store.ownership import run_name

pytestmark = pytest.mark.wires


class Followers(Protocol):
    """An interface that the fleet has never heard of: asked is the cell that follows the asset."""

    @Call()
    async def follower(self, asset_id: str) -> str: ...


@pytest.fixture(scope="module")
def nats() -> Iterator[NatsServer]:
    with running_nats() as server:
        yield server


#: What the database says: epoch and owner of each partition.
RECORD: dict[int, tuple[int, str]] = {}


@pytest.fixture(autouse=True)
def no_partitions() -> None:
    RECORD.clear()


async def of_record() -> dict[int, tuple[int, str]]:
    return dict(RECORD)


class Cell:
    """A cell that follows some assets and answers with its name."""

    def __init__(
        self,
        nats: NatsServer,
        partitions: Mapping[int, int],
        assets: list[str],
        *,
        is_owner: bool = True,
    ) -> None:
        self.run = run_name()
        self.assets = assets
        self.connection = NatsConnection(nats.url, None, self.run)
        self.bus = NatsCellBus(self.connection, self.run)
        self.stream = LiveMessages(ProcessClock(), self.bus.epoch, on_message=self._hand_on)
        self.followed = 0
        self.store: Literal["ok", "degraded"] = "ok"
        self.tell(partitions, is_owner=is_owner)

    def tell(self, partitions: Mapping[int, int], *, is_owner: bool = True) -> None:
        for partition, epoch in partitions.items():
            if is_owner and epoch > RECORD.get(partition, (0, ""))[0]:
                RECORD[partition] = epoch, self.run
        self.followed += 1
        self.bus.report(
            CellState(
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

        async def documents(command: Any) -> list[commands.PackedDocument]:
            return [
                commands.PackedDocument(
                    b"tag", f"{one.asset} of {self.bus.epoch}".encode() * 20_000
                )
                for one in command.wanted
            ]

        async def follower(command: Any) -> str:
            return self.bus.epoch

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

        async def notifications(command: Any) -> list[NotificationState]:
            fails = "a" in self.assets
            return [
                NotificationState("mail", len(self.assets), 0, 5, 9 if fails else None, int(fails))
            ]

        async def test(command: Any) -> tuple[bool, str]:
            return True, f"{command.notification} by {self.bus.epoch}"

        handlers: Handlers = {
            command_type(commands.Assets.names): names,
            command_type(Notifications.states): notifications,
            command_type(Notifications.test): test,
            command_type(commands.Assets.documents): documents,
            command_type(Followers.follower): follower,
            command_type(commands.Alarms.act): act,
            command_type(commands.LiveStream.after): after,
            command_type(commands.LiveStream.follow): follow,
        }
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.connection.run())
            tasks.create_task(self.bus.serve(handlers))
            while True:
                checks = [HealthCheck("store", self.store, self.bus.epoch)]
                self.bus.publish(HEALTH_TOPIC, 1, encode(checks))
                self.bus.publish(METRICS_TOPIC, 1, b"# TYPE up gauge\nup 1.0\n")
                await asyncio.sleep(0.1)


def fleet_of(nats: NatsServer, assets: list[str]) -> Fleet:
    async def no_alarms() -> list[Alarm]:
        return []

    return Fleet(NatsConnection(nats.url, None, "test"), 4, lambda: assets, no_alarms, of_record)


async def test_each_question_goes_to_the_cell_that_can_answer(nats: NatsServer) -> None:
    one = Cell(nats, {0: 1, 1: 1}, ["a", "b"])
    other = Cell(nats, {2: 1, 3: 1}, ["c"])
    fleet = fleet_of(nats, ["a", "b", "c", "d"])
    async with at_work(one.work(), other.work(), fleet.run()):
        await until(lambda: fleet.state.ready and not fleet.missing() and fleet.state.assets >= 1)
        await until(lambda: set(fleet.cells) == {one.bus.epoch, other.bus.epoch})
        assert list(await fleet.ask(call(commands.Assets.names), 30)) == ["a", "b", "c"]
        assert await fleet.ask(call(Followers.follower, "c"), 30) == other.bus.epoch
        wanted = [commands.Wanted(name, "snapshot") for name in "cab"]
        found = await fleet.ask(call(commands.Assets.documents, wanted), 30)
        owners = [document.text.split()[2][:8].decode() for document in found if document.text]
        assert owners == [other.bus.epoch, one.bus.epoch, one.bus.epoch]
        assert fleet.is_known("d")
        assert not fleet.is_known("e")
        with pytest.raises(CellUnavailableError, match="no cell follows asset 'd'"):
            await fleet.ask(call(Followers.follower, "d"), 30)
        with pytest.raises(RoleRefusedError, match=r"Alarms\.act: not for role 'none'"):
            await fleet.ask(call(commands.Alarms.act, "x", "acknowledge", "", ""), 30)
        caller_role.set("engineer")
        with pytest.raises(UnknownAlarmError):
            await fleet.ask(call(commands.Alarms.act, "x", "acknowledge", "", ""), 30)
        (mail,) = await fleet.ask(call(Notifications.states), 30)
        assert mail == NotificationState("mail", 3, 0, 5, 9, 1)
        told, by = await fleet.ask(call(Notifications.test, "mail", "engineer"), 30)
        assert told
        assert by in {f"mail by {cell.bus.epoch}" for cell in (one, other)}, "one cell, once"


async def test_cells_say_how_they_are_and_are_not_asked(nats: NatsServer) -> None:
    one, other = Cell(nats, {0: 1, 1: 1}, ["a"]), Cell(nats, {2: 1, 3: 1}, ["b"])
    other.store = "degraded"
    fleet = fleet_of(nats, ["a", "b"])
    reports = HealthReports(fleet)
    async with at_work(one.work(), other.work(), fleet.run(), reports.run()) as (_, ended, *_rest):
        await until(lambda: not fleet.missing() and len(reports.checks()) == 2)
        await until(lambda: other.bus.epoch in reports.checks()[1].detail)
        assert reports.checks() == [
            HealthCheck("partitions", "ok", "2 cells own all 4 partitions"),
            HealthCheck("store", "degraded", other.bus.epoch),
        ], "the worst of what every cell says of itself"
        await until(lambda: reports.metrics().count(b"up{cell=") == 2)
        text = reports.metrics().decode()
        assert f'up{{cell="cell-{one.bus.epoch}"}} 1.0' in text
        assert 'bearing_twin_partition_owner{partition="3"} 1.0' in text
        ended.cancel()
        await until(lambda: reports.checks()[0].status == "degraded")
        assert [check.status for check in reports.checks()] == ["degraded", "ok"]


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
            assert await fleet.ask(call(Followers.follower, "a"), 30) == new.bus.epoch


async def test_an_epoch_that_the_database_does_not_know_is_not_believed(nats: NatsServer) -> None:
    """Whoever has a password of the bus could own all partitions with one message."""
    cell = Cell(nats, {0: 1, 1: 1, 2: 1, 3: 1}, ["a"])
    absurd = dict.fromkeys(range(4), 2**60)
    fleet = fleet_of(nats, ["a"])
    async with at_work(cell.work(), fleet.run()):
        await until(lambda: fleet.state.ready and not fleet.missing())
        for claimed in (absurd, dict.fromkeys(range(4), 1)):
            other = Cell(nats, claimed, ["a"], is_owner=False)
            async with at_work(other.work()):
                await until(lambda: fleet.state.ready and len(fleet.alive()) == 2)
                await asyncio.sleep(1.0)
                assert set(fleet.owners().values()) == {cell.bus.epoch}
                assert await fleet.ask(call(Followers.follower, "a"), 30) == cell.bus.epoch
            fleet.cells.pop(other.bus.epoch, None)


async def test_messages_that_a_dead_server_swallowed_are_found_by_their_numbers(
    nats: NatsServer,
) -> None:
    cell = Cell(nats, {0: 1, 1: 1, 2: 1, 3: 1}, ["a"])
    fleet = fleet_of(nats, ["a"])
    clock: Clock = ProcessClock()
    bus = LiveMessages(clock)
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
                await fleet.ask(call(Followers.follower, "a"), 1)
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
