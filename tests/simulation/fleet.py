"""Cells of a fleet with the product's own parts, over a fake server, clock and disk.

Each cell is `Ownership`, `Share`, `AlarmBook`, `Outbox`, `Spool` and `SampleWriter`, in the order
in which `service.cell.start` joins them; its threads are turns of an actor. The store is a real one
on SQLite, its queues are real files. Fakes stand at the edges alone: `server.py` and `world.py`.
"""

import contextlib
import logging
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from uuid import UUID

import psycopg
import structlog
from prometheus_client import CollectorRegistry
from simulation.server import FakeConnection, Server
from simulation.without_threads import CellDatabase, CellOutbox, NoThread
from simulation.world import Killed, World, replaced
from sqlalchemy.engine import make_url

from adapters.samples import Quality, Sample
from service.alarms import AlarmBook, AlarmCondition, NotAllowedError, UnknownAlarmError, records
from service.cell import start
from service.cell.share import Share
from service.ingest import Spool, writer
from service.ingest.metrics import SampleLedger
from service.ingest.writer import SampleWriter
from service.site.partitions import partitions_of
from service.site.settings import Settings, load_settings
from service.store import (
    AuditEntry,
    Store,
    StoreUnavailableError,
    WriteCounts,
    outbox,
    ownership,
    partition_session,
)
from service.store.fences import ClosedFence
from service.store.identity import Witness
from service.store.ownership import Ownership
from service.store.partition_shares import LOOK_S
from service.store.queue_file import QueueFile

PARTITIONS = 8
ASSETS = tuple(f"axle-{number}" for number in range(8))
CHANNEL = "load_n"
#: Until a process that has ended begins again: mostly soon.
RESTARTS_S = (1.0, 2.0, 3.0, 15.0)
_WEB_S = 1.0
_FIELDS = "bearing = '6311'\nlow_risk = { speed_rpm_max = 4300, load_n_max = 3400 }\n"

# What the store itself sees, as the witness of the demo does.
_WITNESS = """
CREATE TABLE sim_writes (asset TEXT);
CREATE TABLE sim_revived (id TEXT);
CREATE TRIGGER sim_insert AFTER INSERT ON alarms
BEGIN INSERT INTO sim_writes VALUES (NEW.asset); END;
CREATE TRIGGER sim_update AFTER UPDATE ON alarms
BEGIN INSERT INTO sim_writes VALUES (NEW.asset); END;
CREATE TRIGGER sim_revive AFTER UPDATE ON alarms
WHEN OLD.state = 'NORM' AND OLD.raised_at_us > 0 AND NEW.state <> 'NORM'
BEGIN INSERT INTO sim_revived VALUES (NEW.id); END;
"""


class Cell:
    """One data directory, and the process that runs on it: begun again when it ends."""

    def __init__(self, fleet: Any, number: int) -> None:
        self.fleet, self.world = fleet, fleet.world
        self.name = f"cell-{number}"
        self.folder = fleet.folder / self.name
        self.folder.mkdir()
        self.next_s = self.world.now_s + number / 10
        self.runs: list[str] = []
        # Whether it was paused or cut off since all was quiet.
        self.is_disturbed = False
        self._close: Callable[[], None] = lambda: None
        self.ownership: Ownership | None = None
        self.witness: Any = None

    @property
    def is_up(self) -> bool:
        return self.ownership is not None

    def open_outbox(self, run: str) -> CellOutbox:
        box = CellOutbox.open(self.folder, self.store, run=run)
        spool = self.spool

        def close() -> None:
            box._queue.close()
            spool.close()

        self._close = close
        return box

    def own(self, run: str) -> Ownership:
        server, actor = self.fleet.server, self.name

        class Connecting:
            @staticmethod
            def connect(*_: object, **options: str) -> FakeConnection:
                return FakeConnection(server, options["application_name"].removesuffix(" *"), actor)

        with replaced((partition_session, "PatientConnection", Connecting)):
            mine = Ownership(
                make_url("postgresql://db/fleet"), run, PARTITIONS, lambda: None, lambda: None
            )
        session = mine._session
        session._connect = _with_fake(session._connect, Connecting)  # type: ignore[method-assign]
        return mine

    # ------------------------------------------------------------------ turns
    def step(self) -> None:
        try:
            if self.ownership is None:
                self._begin()
            else:
                self._turn()
        except Killed:
            self.end("killed")
        except (StoreUnavailableError, psycopg.OperationalError) as error:
            if self.ownership is None:  # `Waiting` tries again
                self.world.note(f"{self.name} waits: {error}")
                self.end("not begun")
                self.next_s = self.world.now_s + LOOK_S
                return
            raise
        self.next_s = max(
            self.next_s, self.world.now_s + LOOK_S * self.world.chance.uniform(0.9, 1.1)
        )

    def _begin(self) -> None:
        run = self.fleet.new_run()
        self.runs.append(run)
        self.store = Store(CellDatabase(self.fleet, self.name))
        self.store.write_only_what(ClosedFence())
        if self.fleet.knows_its_store:
            self.witness = Witness(self.folder, "store")
            self.store.write_if(self.witness)
        self.spool = Spool.open(self.folder, 16)
        self._close = self.spool.close
        self.writer = SampleWriter(self.store, self.spool, SampleLedger(CollectorRegistry()))
        self.outbox, self.share = self.fleet.join(self, run)
        self.book = AlarmBook(
            self.outbox, cast(Any, self.world), lambda alarm: None, begins_empty=True
        )
        self.followed: set[str] = set()
        self.ownership = self.share.ownership
        self.world.note(f"{self.name} begins as {run[-4:]}")

    def _turn(self) -> None:
        ownership = self.ownership
        assert ownership is not None
        ownership._go_round()
        if self.fleet.knows_its_store and self.witness.ended:
            self.end("begins again: its store is another one")
            return
        if ownership.lost:
            self.fleet.see_lost(self)
            self.outbox.flush(1.0)
            self.end("has lost its partitions")
            return
        with contextlib.suppress(StoreUnavailableError):
            self._take_up()
        self.book.evaluate_all(
            [self.fleet.condition(name) for name in ASSETS if name in self.followed]
        )
        self.outbox.turn()
        if self.writer._queue.is_due():
            self.writer._work_off(self.writer._next() or [])
        else:
            self.writer._drain()

    def _take_up(self) -> None:
        ours = {name for name in ASSETS if self.share.owns(name)}
        left, new = self.followed - ours, ours - self.followed
        if left:
            self.book.leave(left)
            if not self.outbox.flush(5.0):
                raise StoreUnavailableError("changes wait")
            self.followed -= left
        if new:
            self.book.take_over(new)
            self.followed |= new
        self.share.settle(0)

    def end(self, why: str) -> None:
        """End as a process does: nothing is said to anybody."""
        self.world.note(f"{self.name} {why}")
        self._close()
        self._close = lambda: None
        if self.witness is not None:
            self.witness.close()
        self.fleet.server.end(self.runs[-1]) if self.runs else None
        self.ownership = None
        self.followed = set()
        self.next_s = self.world.now_s + self.world.chance.choice(RESTARTS_S)


def _with_fake(connect: Callable[[], Any], connecting: object) -> Callable[[], Any]:
    def connected() -> Any:
        with replaced((partition_session, "PatientConnection", connecting)):
            return connect()

    return connected


class Web:
    """Pushes numbered samples to the owner; the same until they are acknowledged."""

    def __init__(self, fleet: Any) -> None:
        self.fleet, self.name = fleet, "web"
        self.next_s = fleet.world.now_s
        self._number = 0
        self._sent: dict[int, tuple[str, Future[WriteCounts] | None]] = {}

    def step(self) -> None:
        fleet = self.fleet
        self._number += 1
        self._sent[self._number] = fleet.world.chance.choice(ASSETS), None
        self.hear()
        for number, (asset, sent) in list(self._sent.items()):
            if sent is not None and not sent.done() and fleet.world.chance.random() < 0.8:
                continue
            cell = fleet.owner_of(asset)
            if cell is not None:
                pushed = cell.writer.put_with_result([sample(asset, number)])
                self._sent[number] = asset, pushed
        self.next_s = fleet.world.now_s + _WEB_S

    def hear(self) -> None:
        """Record what cells have answered."""
        for number, (asset, sent) in list(self._sent.items()):
            if sent is not None and sent.done() and sent.exception() is None:
                self.fleet.acknowledged[number] = asset
                del self._sent[number]


def sample(asset: str, number: int) -> Sample:
    time_us = 1_600_000_000_000_000 + number
    return Sample(asset, CHANNEL, time_us, float(number), Quality.GOOD, time_us)


Join = Callable[[Cell, str], tuple[CellOutbox, Share]]


def product_order(cell: Cell, run: str) -> tuple[CellOutbox, Share]:
    """Join the parts in the order of `service.cell.start`, by its own functions."""
    fleet, store = cell.fleet, cell.store
    revision, assets = start.fence_earlier(fleet.settings, store)
    box = cell.open_outbox(run)
    start.deliver_earlier(cell.folder, store, box)
    share = Share(cell.own(run), fleet.changed)
    share.arrange(assets, revision)
    store.write_only_what(share)
    return box, share


class Fleet:
    def __init__(
        self,
        world: World,
        folder: Path,
        cells: int = 3,
        join: Join = product_order,
        knows_its_store: bool = True,
    ) -> None:
        self.world, self.folder, self.join = world, folder, join
        self.knows_its_store = knows_its_store
        file = folder / "fleet.toml"
        tables = "".join(
            f"[[assets]]\nid = '{name}'\n{_FIELDS}"
            f"[assets.channels]\n{CHANNEL} = {{ source = 'push' }}\n"
            for name in ASSETS
        )
        file.write_text(
            "[fleet]\ndatabase_url = 'postgresql://db/fleet'\n"
            f"nats_url = 'nats://127.0.0.1:4222'\npartitions = {PARTITIONS}\n{tables}"
        )
        self.settings: Settings = load_settings(file)
        self.changed = cast(Any, SimpleNamespace(set=lambda: None))
        self.store = Store.open("", folder / "store")
        path = str(self.store._database.engine.url.database)
        self.file = sqlite3.connect(path, isolation_level=None)
        self.file.executescript(_WITNESS)
        self.server = Server(world, self.file, PARTITIONS)
        self.partition = partitions_of(self.settings.assets, PARTITIONS)
        self.hot: set[str] = set()
        self.acknowledged: dict[int, str] = {}
        self.verified: set[int] = set()
        # What was acknowledged, and is gone with a store that was lost.
        self.gone: set[int] = set()
        self._runs = 0
        self.cells = [Cell(self, number) for number in range(cells)]
        self.web = Web(self)
        world.actors += [*self.cells, self.web]

    def close(self) -> None:
        for cell in self.cells:
            cell.end("closed")
        self.file.close()
        self.store.close()

    def new_run(self) -> str:
        self._runs += 1
        return f"bearing-twin sim {self._runs:04}"

    def owner_of(self, asset: str) -> Cell | None:
        _, owner = self.server.partitions[self.partition[asset]]
        return next((one for one in self.cells if one.is_up and one.runs[-1] == owner), None)

    def condition(self, asset: str) -> AlarmCondition:
        hot = asset in self.hot
        return AlarmCondition(
            asset, "measured limit", "t_outer_ring_c", "alarm", hot, 90.0 if hot else 20.0,
            "too hot", 1, limit_value=80.0,
        )  # fmt: skip

    # ------------------------------------------------------------------ an older copy
    def copy(self) -> tuple[Any, sqlite3.Connection]:
        copy = sqlite3.connect(":memory:")
        self.file.backup(copy)
        return self.server.copy(), copy

    def fail_over(self, copy: tuple[Any, sqlite3.Connection]) -> None:
        """Go on with an older copy of the database; what came since is gone with the other one."""
        self.web.hear()
        copy[1].backup(self.file)
        self.server.become(copy[0])
        self.store._database.engine.dispose()
        self.store._database._writer.dispose()
        numbers = self.acknowledged.keys()
        self.gone |= {number for number in numbers if not self.rows_of(number)} - self.waiting()
        for cell in self.cells:
            cell.is_disturbed = True

    def waiting(self, cells: Sequence[Cell] = ()) -> set[int]:
        """Samples on the disks of some cells, or of all."""
        found: set[int] = set()
        for cell in cells or self.cells:
            # What a torn file held was counted as gone when it was torn.
            torn = contextlib.suppress(sqlite3.DatabaseError)
            with contextlib.closing(sqlite3.connect(cell.folder / "spool.db")) as spool, torn:
                rows = spool.execute("SELECT value FROM samples WHERE channel = ?", (CHANNEL,))
                found |= {int(value) for (value,) in rows}
        return found

    def confirm(self) -> None:
        """A person says that the store is to be gone on with as it is."""
        self.store.identity.confirm(AuditEntry(0, "eva", "", "store.confirm"))

    def rows_of(self, number: int) -> list[tuple[float]]:
        asset = self.acknowledged[number]
        return self.file.execute(
            "SELECT value FROM samples JOIN channels ON channels.id = channel_id "
            "WHERE asset = ? AND name = ? AND time_us = ?",
            (asset, CHANNEL, sample(asset, number).time_us),
        ).fetchall()

    def acknowledge_one(self) -> None:
        """An operator acknowledges an alarm at its owner."""
        open_alarms = [
            (cell, one) for cell in self.cells if cell.is_up for one in cell.book.active()
        ]
        if open_alarms:
            cell, alarm = self.world.chance.choice(open_alarms)
            with contextlib.suppress(NotAllowedError, UnknownAlarmError):
                cell.book.acknowledge(alarm.id, "eva")

    # ------------------------------------------------------------------ what is always true
    def see_writes(self, actor: str, assets: list[str]) -> None:
        runs = next(one.runs for one in self.cells if one.name == actor)
        for asset in assets:
            _, owner = self.server.partitions[self.partition[asset]]
            self.world.require(
                owner in runs, f"{actor} writes an alarm of {asset}, whose partition {owner} owns"
            )

    def see_lost(self, cell: Cell) -> None:
        self.world.require(
            cell.is_disturbed, f"{cell.name} was ended though nothing had happened to it"
        )


@contextlib.contextmanager
def simulated(world: World) -> Iterator[None]:
    """Let the product's parts have the clock and the turns of the world, and no threads."""
    clock = SimpleNamespace(monotonic=world.monotonic, time=world.time, sleep=world.sleep)
    no_threads = SimpleNamespace(
        Thread=NoThread, Lock=ownership.threading.Lock, Event=ownership.threading.Event,
        Condition=outbox.threading.Condition,
    )  # fmt: skip
    writing = QueueFile.writing

    @contextlib.contextmanager
    def on_disk(self: QueueFile) -> Iterator[sqlite3.Connection]:
        actor = self._path.parent.name
        world.reach(actor, "a write on the disk")
        with writing(self) as connection:
            if world.full_until_s.get(actor, 0.0) > world.now_s:
                raise sqlite3.OperationalError("database or disk is full")
            yield connection
            world.reach(actor, "a sync of the disk")
        world.reach(actor, "the answer of the disk")

    levels = structlog.make_filtering_bound_logger(logging.CRITICAL)
    structlog.configure(wrapper_class=levels)
    try:
        with replaced(
            (ownership, "time", clock),
            (partition_session, "time", clock),
            (ownership, "threading", no_threads),
            (outbox, "threading", no_threads),
            (writer, "time", clock),
            (QueueFile, "writing", on_disk),
            (records, "uuid4", lambda: UUID(int=world.chance.getrandbits(128))),
        ):
            yield
    finally:
        structlog.reset_defaults()
