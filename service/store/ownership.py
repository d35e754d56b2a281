"""Which partitions of a fleet this cell owns: PostgreSQL decides, and no one else writes for them.

The row of a partition names its owner and counts an epoch up with each new one; whoever writes for
a partition holds that row against a change until its transaction ends. A session lock for each
partition tells at once that its owner's process has died; a heartbeat tells that one hangs.
"""

import contextlib
import math
import random
import socket
import threading
import time
import uuid
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any, Final

import psycopg
import structlog
from sqlalchemy import Connection, select
from sqlalchemy.engine import URL

from service.store.addresses import shown
from service.store.closable import Closable
from service.store.database_lock import SERVICE_LOCK
from service.store.errors import DatabaseInUseError, StoreError
from service.store.postgresql_connection import CONNECT_ARGS, PatientConnection, connection_error
from service.store.tables import PartitionRow

#: Wall seconds between two looks, and without a heartbeat until a cell counts as hanging.
LOOK_S: Final = 0.5
DEAD_S: Final = 4.0
#: After a start of the server its cells are given so many seconds to come back.
_COME_BACK_S: Final = 8.0
#: Clocks of cell and server that differ by more are reported.
_CLOCKS_DIFFER_S: Final = 2.0
#: First number of the advisory locks of the partitions; any that no one else uses.
LOCKS: Final = 0x42545770
_ANSWER_S: Final = 6.0
_END_S: Final = 2.0

# A cell is there while the session that holds its locks is. After a start of the server no session
# is there yet: those that were there before it count.
_ALIVE = """
SELECT id, assets_revision FROM cells
WHERE EXISTS (SELECT FROM pg_stat_activity WHERE application_name = id || ' *')
OR (clock_timestamp() < pg_postmaster_start_time() + make_interval(secs => %(come_back_s)s)
    AND beat_at > pg_postmaster_start_time() - make_interval(secs => %(come_back_s)s))
"""
_BEAT = """
INSERT INTO cells (id, beat_at, assets_revision) VALUES (%(me)s, clock_timestamp(), %(revision)s)
ON CONFLICT (id) DO UPDATE SET beat_at = clock_timestamp(), assets_revision = %(revision)s
RETURNING extract(epoch FROM beat_at)::float8
"""
# All connections of a cell that hangs: one in the middle of a transaction would hold up its
# successor. Cells that came back with the server have had no time for a heartbeat yet.
_END_SILENT = """
SELECT cells.id, pg_terminate_backend(pid) FROM cells
JOIN pg_stat_activity ON application_name IN (cells.id, cells.id || ' *')
WHERE beat_at < clock_timestamp() - make_interval(secs => %(dead_s)s)
AND clock_timestamp() > pg_postmaster_start_time() + make_interval(secs => %(come_back_s)s)
AND cells.id <> %(me)s
"""
_FORGET_DEAD = """
DELETE FROM cells WHERE beat_at < clock_timestamp() - interval '1 hour' AND id <> %(me)s
"""
_FREE = """
SELECT id, owner FROM partitions WHERE NOT EXISTS (
    SELECT FROM pg_locks WHERE locktype = 'advisory' AND granted AND classid = %(locks)s
    AND objid = partitions.id AND objsubid = 2
    AND database = (SELECT oid FROM pg_database WHERE datname = current_database()))
"""
_TAKE = "UPDATE partitions SET epoch = epoch + 1, owner = %s WHERE id = %s RETURNING epoch"
_LEAVE = "UPDATE partitions SET owner = '' WHERE id = ANY(%s) AND owner = %s"

_log = structlog.get_logger(__name__)


class Ownership(Closable):
    """The partitions that one run of a cell owns, kept by a thread on a connection of its own.

    Parameters
    ----------
    url : sqlalchemy.engine.URL
        Of the database.
    cell : str
        Names this run; see `run_name`. The connections of its store carry it, too.
    count : int
        Number of partitions; the same for all cells.
    on_change : callable
        Called, from another thread, when `owned` or `leaving` has changed.
    on_lost : callable
        Called, from another thread, when a partition was taken away. Nothing that this run knows
        about it holds any more: the cell must end.

    Attributes
    ----------
    lost : str
        Why a partition is lost, one line; empty while none is.
    clock_ahead_s : float
        How far the clock of this machine is ahead of that of the server.
    least_revision : int
        Of the assets: every cell that lives has taken this one up.

    Raises
    ------
    StoreError
        If there is no connection, or the cells that run have another number of partitions; a
        `StoreUnavailableError` if that may pass by itself.
    """

    def __init__(
        self,
        url: URL,
        cell: str,
        count: int,
        on_change: Callable[[], object],
        on_lost: Callable[[], object],
    ) -> None:
        self.cell = cell
        self.count = count
        self.lost = ""
        self.clock_ahead_s = 0.0
        self.assets_revision = 0
        self.least_revision = 0
        self._url = url
        self._name = f"fleet.database_url = {shown(url)!r}"
        self._on_change, self._on_lost = on_change, on_lost
        self._lock = threading.Lock()
        self._owned: Mapping[int, int] = MappingProxyType({})
        self._leaving: frozenset[int] = frozenset()
        self._left: set[int] = set()
        self._ended = threading.Event()
        with contextlib.ExitStack() as failing:
            try:
                self._connection = self._connect()
                failing.callback(self._connection.close)
                self._make_rows()
            except psycopg.Error as error:
                raise connection_error(self._name, error, url) from error
            failing.pop_all()
        self._thread = threading.Thread(target=self._keep, name="ownership", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------ what the cell asks
    @property
    def owned(self) -> Mapping[int, int]:
        """Epoch by partition, of those that are ours; `leaving` are among them."""
        return self._owned

    @property
    def leaving(self) -> frozenset[int]:
        """Partitions that another cell is to have: give them up with `leave`."""
        return self._leaving

    def leave(self, partitions: Collection[int]) -> None:
        """Give partitions up: all that was to be written for them is written."""
        with self._lock:
            self._left |= set(partitions) & self._leaving

    def held(self, connection: Connection, partitions: Collection[int]) -> set[int]:
        """Tell which partitions are ours until the end of a transaction.

        ``FOR SHARE`` makes the next owner wait until then.
        """
        owned = self._owned
        query = (
            select(PartitionRow.id, PartitionRow.epoch)
            .where(PartitionRow.id.in_(list(partitions)), PartitionRow.owner == self.cell)
            .with_for_update(read=True)
        )
        return {id for id, epoch in connection.execute(query) if owned.get(id) == epoch}

    def owned_by(self, connection: Connection, partitions: Collection[int], run: str) -> set[int]:
        """Tell which partitions a run, this one or an earlier one, owns until the commit."""
        query = (
            select(PartitionRow.id)
            .where(PartitionRow.id.in_(list(partitions)), PartitionRow.owner == run)
            .with_for_update(read=True)
        )
        return {id for (id,) in connection.execute(query)}

    def close(self) -> None:
        """Give everything up; the other cells take it at once."""
        self._ended.set()
        self._thread.join(_END_S)
        if self._thread.is_alive():  # the end of the process does it
            return
        with contextlib.suppress(psycopg.Error):
            self._connection.execute(_LEAVE, (list(self._owned), self.cell))
            self._connection.execute("DELETE FROM cells WHERE id = %s", (self.cell,))
        self._connection.close()

    # ------------------------------------------------------------------ the thread
    def _connect(self) -> psycopg.Connection[Any]:
        connection = PatientConnection.connect(
            self._url.set(drivername="postgresql").render_as_string(hide_password=False),
            autocommit=True,
            **{**CONNECT_ARGS, "application_name": f"{self.cell} *"},
        )
        connection.answer_s = _ANSWER_S
        try:
            # A row that a stopped owner holds must not hold up our own heartbeat.
            connection.execute("SET lock_timeout = '1s'; SET statement_timeout = '5s'")
            # A service without [fleet] would take all machines for its own.
            lock = f"pg_try_advisory_lock_shared({SERVICE_LOCK}, hashtext(current_schema()))"
            if not _first(connection.execute(f"SELECT {lock}"))[0]:
                raise DatabaseInUseError(
                    f"{self._name}: a service without [fleet] is running on it; stop that one"
                )
        except BaseException:
            connection.close()
            raise
        return connection

    def _make_rows(self) -> None:
        connection = self._connection
        with connection.transaction():
            connection.execute("LOCK TABLE partitions IN EXCLUSIVE MODE")
            known = _first(connection.execute("SELECT count(*) FROM partitions"))[0]
            alive = connection.execute(_ALIVE, {"come_back_s": _COME_BACK_S}).fetchall()
            if known not in (0, self.count) and alive:
                raise StoreError(
                    f"fleet.partitions = {self.count}: the cells that run have {known}; "
                    "expected the same for all"
                )
            connection.execute("DELETE FROM partitions WHERE id >= %s", (self.count,))
            connection.execute(
                "INSERT INTO partitions SELECT id, 0, '' FROM generate_series(0, %s) AS id "
                "ON CONFLICT DO NOTHING",
                (self.count - 1,),
            )

    def _keep(self) -> None:
        away = False
        while not self._ended.is_set():
            try:
                if away:
                    self._connection = self._connect()
                    self._take_again()
                    _log.info("partitions_owned_again", count=len(self._owned))
                    away = False
                self._look()
            except DatabaseInUseError as error:
                self.lost = str(error)
                _log.error("database_taken_over", error=self.lost)
                self._on_lost()
            except psycopg.Error as error:
                if self._connection.closed or self._connection.broken or away:
                    # No one else can take anything while the server is away.
                    away = True
                else:
                    _log.warning("ownership_look_failed", reason=str(error))
            if self.lost:
                return
            self._ended.wait(LOOK_S)

    def _look(self) -> None:
        connection, me = self._connection, self.cell
        beat = {"me": me, "revision": self.assets_revision}
        server_s = float(_first(connection.execute(_BEAT, beat))[0])
        self.clock_ahead_s = time.time() - server_s
        given = {"me": me, "dead_s": DEAD_S, "come_back_s": _COME_BACK_S, "locks": LOCKS}
        for silent in {row[0] for row in connection.execute(_END_SILENT, given)}:
            _log.warning("silent_cell_ended", cell=silent, silent_s=DEAD_S)
        connection.execute(_FORGET_DEAD, given)
        alive = {str(id): int(number) for id, number in connection.execute(_ALIVE, given)}
        alive[me] = self.assets_revision
        self.least_revision = min(alive.values())
        self._give_up_left()
        share = math.ceil(self.count / len(alive))
        surplus = len(self._owned) - len(self._leaving) - share
        if surplus > 0:
            kept = sorted(self._owned.keys() - self._leaving)
            self._change(leaving=self._leaving | set(random.sample(kept, surplus)))
        elif len(self._owned) < share:
            self._take(share - len(self._owned), alive.keys() - {me}, given)

    def _give_up_left(self) -> None:
        with self._lock:
            left, self._left = self._left, set()
        if not left:
            return
        self._connection.execute(_LEAVE, (sorted(left), self.cell))
        for partition in left:
            self._connection.execute("SELECT pg_advisory_unlock(%s, %s)", (LOCKS, partition))
        owned = {id: epoch for id, epoch in self._owned.items() if id not in left}
        self._change(owned=owned, leaving=self._leaving - left)

    def _take(self, most: int, others: Collection[str], given: Mapping[str, Any]) -> None:
        found = self._connection.execute(_FREE, given).fetchall()
        free = [id for id, owner in found if owner not in others and id not in self._owned]
        taken: dict[int, int] = {}
        for partition in random.sample(free, len(free)):
            if len(taken) == most:
                break
            if self._lock_partition(partition):
                try:
                    taken[partition] = _first(
                        self._connection.execute(_TAKE, (self.cell, partition))
                    )[0]
                except psycopg.errors.LockNotAvailable:  # its old owner is being ended
                    self._unlock_partition(partition)
        if taken:
            owned = len(self._owned) + len(taken)
            _log.info("partitions_taken", cell=self.cell, count=len(taken), owned=owned)
            self._change(owned={**self._owned, **taken})

    def _take_again(self) -> None:
        """Go on after the connection was lost: what nobody took meanwhile is still ours."""
        # The session that broke may hold our locks still.
        self._connection.execute(
            "SELECT pg_terminate_backend(pid, 3000) FROM pg_stat_activity "
            "WHERE application_name = %s AND pid <> pg_backend_pid()",
            (f"{self.cell} *",),
        )
        rows = self._connection.execute(
            "SELECT id, epoch FROM partitions WHERE owner = %s", (self.cell,)
        ).fetchall()
        ours = dict(rows)
        gone = [
            id
            for id, epoch in self._owned.items()
            if ours.get(id) != epoch or not self._lock_partition(id)
        ]
        if gone:
            self.lost = f"another cell owns {len(gone)} partitions that this one owned"
            _log.error("partitions_lost", count=len(gone), partitions=sorted(gone)[:10])
            self._on_lost()

    def _lock_partition(self, partition: int) -> bool:
        arguments = (LOCKS, partition)
        found = self._connection.execute("SELECT pg_try_advisory_lock(%s, %s)", arguments)
        return bool(_first(found)[0])

    def _unlock_partition(self, partition: int) -> None:
        self._connection.execute("SELECT pg_advisory_unlock(%s, %s)", (LOCKS, partition))

    def _change(
        self, owned: Mapping[int, int] | None = None, leaving: frozenset[int] | None = None
    ) -> None:
        with self._lock:
            if owned is not None:
                self._owned = MappingProxyType(dict(owned))
            if leaving is not None:
                self._leaving = frozenset(leaving)
        self._on_change()

    @property
    def clock_problem(self) -> str | None:
        """That the clock of this machine is not that of the server; None where it is."""
        if abs(self.clock_ahead_s) < _CLOCKS_DIFFER_S:
            return None
        return f"the clock differs by {self.clock_ahead_s:+.1f} s from that of the database server"


def run_name() -> str:
    """Name a run of a cell: no other one, on any machine, has the same.

    The server shows it as the name of its connections, within 63 characters.
    """
    return f"bearing-twin {socket.gethostname()[:30]} {uuid.uuid4().hex[:8]}"


def _first(cursor: psycopg.Cursor[Any]) -> Any:
    return cursor.fetchone()
