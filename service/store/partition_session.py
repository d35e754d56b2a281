"""The session of one cell in PostgreSQL that takes and leaves partitions."""

import contextlib
import time
from collections.abc import Collection
from typing import Any, Final

import psycopg
from sqlalchemy.engine import URL

from service.store.addresses import shown
from service.store.database_lock import SERVICE_LOCK
from service.store.errors import DatabaseInUseError, StoreError
from service.store.partition_shares import COME_BACK_S, ClusterView, Member
from service.store.postgresql_connection import CONNECT_ARGS, PatientConnection, connection_error

#: First number of the advisory locks of the partitions; any that no one else uses.
LOCKS: Final = 0x42545770
_ANSWER_S: Final = 6.0

# A cell is there while the session that holds its locks is, or it had a heartbeat a moment ago.
_ALIVE = """
SELECT 1 FROM cells
WHERE EXISTS (SELECT FROM pg_stat_activity WHERE application_name = id || ' *')
OR beat_at > clock_timestamp() - make_interval(secs => %(come_back_s)s)
"""
_BEAT = """
INSERT INTO cells (id, beat_at, assets_revision) VALUES (%(me)s, clock_timestamp(), %(revision)s)
ON CONFLICT (id) DO UPDATE SET beat_at = clock_timestamp(), assets_revision = %(revision)s
RETURNING extract(epoch FROM beat_at)::float8
"""
_MEMBERS = """
SELECT id, extract(epoch FROM beat_at)::float8, assets_revision,
EXISTS (SELECT FROM pg_stat_activity WHERE application_name = id || ' *') FROM cells
"""
# All connections of a cell that hangs: one in the middle of a transaction would hold up its
# successor. Not of one that has had a heartbeat since it was judged.
_END = """
SELECT pg_terminate_backend(pid) FROM cells
JOIN pg_stat_activity ON application_name IN (cells.id, cells.id || ' *')
WHERE cells.id = %s AND extract(epoch FROM beat_at)::float8 = %s
"""
_FORGET_DEAD = """
DELETE FROM cells WHERE beat_at < clock_timestamp() - interval '1 hour' AND id <> %(me)s
"""
_PARTITIONS = """
SELECT id, owner, EXISTS (
    SELECT FROM pg_locks WHERE locktype = 'advisory' AND granted AND classid = %(locks)s
    AND objid = partitions.id AND objsubid = 2
    AND database = (SELECT oid FROM pg_database WHERE datname = current_database()))
FROM partitions
"""
_TAKE = "UPDATE partitions SET epoch = epoch + 1, owner = %s WHERE id = %s RETURNING epoch"
_LEAVE = "UPDATE partitions SET owner = '' WHERE id = ANY(%s) AND owner = %s"


class PartitionSession:
    """A connection with a lock for each partition that the cell owns.

    Raises `StoreError` if there is no connection, or the cells that run have another number of
    partitions; its methods raise `psycopg.Error`.

    - ``clock_ahead_s``: how far the clock of this machine is ahead of that of the server.
    """

    def __init__(self, url: URL, cell: str, count: int) -> None:
        self.cell = cell
        self.count = count
        self.clock_ahead_s = 0.0
        self._url = url
        self._name = f"fleet.database_url = {shown(url)!r}"
        with contextlib.ExitStack() as failing:
            try:
                self._connection = self._connect()
                failing.callback(self._connection.close)
                self._make_rows()
            except psycopg.Error as error:
                raise connection_error(self._name, error, url) from error
            failing.pop_all()

    @property
    def is_broken(self) -> bool:
        """Whether the connection is gone, and with it the locks."""
        return bool(self._connection.closed or self._connection.broken)

    def reconnect(self) -> None:
        """Connect again."""
        self._connection = self._connect()

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
            alive = connection.execute(_ALIVE, {"come_back_s": COME_BACK_S}).fetchall()
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

    def beat(self, assets_revision: int) -> ClusterView:
        """Give a sign of life; shows who else is there and owns what."""
        connection = self._connection
        beat = {"me": self.cell, "revision": assets_revision}
        server_s = float(_first(connection.execute(_BEAT, beat))[0])
        self.clock_ahead_s = time.time() - server_s
        members = {
            str(id): Member(float(beat_s), bool(is_connected), int(revision))
            for id, beat_s, revision, is_connected in connection.execute(_MEMBERS)
        }
        partitions = connection.execute(_PARTITIONS, {"locks": LOCKS}).fetchall()
        return ClusterView(
            server_s=server_s,
            members=members,
            owners={int(id): str(owner) for id, owner, _ in partitions},
            locked=frozenset(int(id) for id, _, is_locked in partitions if is_locked),
        )

    def end_silent(self, cell: str, beat_s: float) -> bool:
        """End the connections of a cell that has had no heartbeat since this one."""
        return bool(self._connection.execute(_END, (cell, beat_s)).fetchall())

    def forget_dead(self) -> None:
        """Delete the rows of cells that ended long ago."""
        self._connection.execute(_FORGET_DEAD, {"me": self.cell})

    def take(self, partition: int) -> int | None:
        """Become the owner of a partition; gives its epoch, None where it is not free yet."""
        if not self.lock(partition):
            return None
        try:
            epoch: int = _first(self._connection.execute(_TAKE, (self.cell, partition)))[0]
        except psycopg.errors.LockNotAvailable:  # its old owner is being ended
            self._unlock(partition)
            return None
        return epoch

    def leave(self, partitions: Collection[int]) -> None:
        """Give partitions up."""
        self._connection.execute(_LEAVE, (sorted(partitions), self.cell))
        for partition in partitions:
            self._unlock(partition)

    def epochs(self) -> dict[int, int]:
        """Epoch by partition, of those that the rows say are ours; ends our broken sessions."""
        # The session that broke may hold our locks still.
        self._connection.execute(
            "SELECT pg_terminate_backend(pid, 3000) FROM pg_stat_activity "
            "WHERE application_name = %s AND pid <> pg_backend_pid()",
            (f"{self.cell} *",),
        )
        rows = self._connection.execute(
            "SELECT id, epoch FROM partitions WHERE owner = %s", (self.cell,)
        ).fetchall()
        return dict(rows)

    def close(self, owned: Collection[int]) -> None:
        """Give everything up; the other cells take it at once."""
        with contextlib.suppress(psycopg.Error):
            self._connection.execute(_LEAVE, (list(owned), self.cell))
            self._connection.execute("DELETE FROM cells WHERE id = %s", (self.cell,))
        self._connection.close()

    def lock(self, partition: int) -> bool:
        """Lock a partition; False while another session has the lock."""
        arguments = (LOCKS, partition)
        found = self._connection.execute("SELECT pg_try_advisory_lock(%s, %s)", arguments)
        return bool(_first(found)[0])

    def _unlock(self, partition: int) -> None:
        self._connection.execute("SELECT pg_advisory_unlock(%s, %s)", (LOCKS, partition))


def _first(cursor: psycopg.Cursor[Any]) -> Any:
    return cursor.fetchone()
