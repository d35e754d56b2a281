"""What PostgreSQL does for ownership, in memory: sessions, advisory locks, rows, and its faults.

The rows of partitions also stand in the store's file, where the fence of a transaction reads them.
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import psycopg
from simulation.world import World

from service.store import partition_session

#: As `Ownership` gives its statements.
ANSWER_S = 6.0


class Rows:
    def __init__(self, rows: Sequence[tuple[Any, ...]]) -> None:
        self._rows = list(rows)

    def fetchall(self) -> list[tuple[Any, ...]]:
        return self._rows

    def fetchone(self) -> tuple[Any, ...]:
        return self._rows[0]

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(self._rows)


class Server:
    def __init__(self, world: World, file: sqlite3.Connection, count: int) -> None:
        self.world = world
        self.count = count
        self.cells: dict[str, tuple[float, int]] = {}
        self.partitions = dict.fromkeys(range(count), (0, ""))
        self.sessions: dict[str, list[FakeConnection]] = {}
        self.locks: dict[int, FakeConnection] = {}
        self.frozen_until_s = self.down_until_s = 0.0
        self.cut: dict[str, float] = {}
        self.taken: list[tuple[str, int]] = []
        self.clock_ahead_s = 0.0
        self._file = file
        self._store()

    # ------------------------------------------------------------------ faults
    def freeze(self, seconds: float) -> None:
        self.frozen_until_s = self.world.now_s + seconds

    def cut_off(self, cell: str, seconds: float) -> None:
        """Break the connections of a cell, and refuse it for a while."""
        self.cut[cell] = self.world.now_s + seconds
        self.end(cell)

    def restart(self, down_s: float = 0.0) -> None:
        self.down_until_s = self.world.now_s + down_s
        for cell in list(self.sessions):
            self.end(cell)

    def end(self, cell: str) -> int:
        ended = self.sessions.pop(cell, [])
        for one in ended:
            one.closed = one.broken = True
        self.locks = {id: one for id, one in self.locks.items() if one not in ended}
        return len(ended)

    def copy(self) -> tuple[Any, ...]:
        return dict(self.cells), dict(self.partitions)

    def become(self, copy: tuple[Any, ...]) -> None:
        """Go on with an older copy: no session is there."""
        self.restart()
        self.cells, self.partitions = dict(copy[0]), dict(copy[1])
        self._store()

    def require_answer(self, cell: str) -> None:
        """Wait as the client of a server that is frozen does."""
        world = self.world
        if max(self.cut.get(cell, 0.0), self.down_until_s) > world.now_s:
            raise psycopg.OperationalError("cut off, or down")
        rest_s = self.frozen_until_s - world.now_s
        if rest_s > ANSWER_S:
            world.now_s += ANSWER_S
            raise psycopg.OperationalError("no answer")
        world.now_s += max(rest_s, 0.0)

    # ------------------------------------------------------------------ statements
    def set_owner(self, partition: int, epoch: int, owner: str) -> None:
        self.partitions[partition] = epoch, owner
        self._file.execute(
            "UPDATE partitions SET epoch = ?, owner = ? WHERE id = ?", (epoch, owner, partition)
        )

    def _store(self) -> None:
        self._file.execute("DELETE FROM partitions")
        self._file.executemany(
            "INSERT INTO partitions (id, epoch, owner) VALUES (?, ?, ?)",
            [(id, epoch, owner) for id, (epoch, owner) in self.partitions.items()],
        )

    @property
    def server_s(self) -> float:
        return self.world.now_s + self.clock_ahead_s

    def is_connected(self, cell: str) -> bool:
        return bool(self.sessions.get(cell))


class FakeConnection:
    """The connection of one `Ownership`; stands for `PatientConnection`."""

    def __init__(self, server: Server, cell: str, actor: str) -> None:
        self.closed = self.broken = False
        self.answer_s: float | None = None
        self._server, self._cell, self._actor = server, cell, actor
        server.require_answer(actor)
        server.sessions.setdefault(cell, []).append(self)

    def close(self) -> None:
        server = self._server
        mine = server.sessions.get(self._cell, [])
        if self in mine:
            mine.remove(self)
        server.locks = {id: one for id, one in server.locks.items() if one is not self}
        self.closed = True

    def transaction(self) -> "FakeConnection":
        return self

    def __enter__(self) -> "FakeConnection":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def execute(self, text: str, given: Any = ()) -> Rows:
        server = self._server
        statement = _STATEMENTS.get(text) or next(
            (one for begin, one in _BEGINNINGS.items() if text.startswith(begin)), None
        )
        assert statement is not None, text
        server.world.reach(self._actor, "a statement")
        try:
            if self.closed:
                raise psycopg.OperationalError("the connection is closed")
            server.require_answer(self._actor)
        except psycopg.OperationalError:
            self.close()
            self.broken = True
            raise
        return Rows(statement(self, server, given))

    # ------------------------------------------------------------------ what they do
    def beat(self, server: Server, given: Mapping[str, Any]) -> list[tuple[Any, ...]]:
        server.cells[given["me"]] = server.server_s, given["revision"]
        return [(server.server_s,)]

    def members(self, server: Server, _: Any) -> list[tuple[Any, ...]]:
        return [
            (name, beat_s, revision, server.is_connected(name))
            for name, (beat_s, revision) in server.cells.items()
        ]

    def shares(self, server: Server, _: Any) -> list[tuple[Any, ...]]:
        locks = server.locks
        return [(id, owner, id in locks) for id, (_, owner) in server.partitions.items()]

    def end_other(self, server: Server, given: tuple[str, float]) -> list[tuple[Any, ...]]:
        cell, beat_s = given
        if server.cells.get(cell, (None, 0))[0] != beat_s:
            return []
        return [(True,)] * server.end(cell)

    def forget(self, server: Server, given: Mapping[str, Any]) -> list[tuple[Any, ...]]:
        old_s = server.server_s - 3600.0
        server.cells = {
            name: one
            for name, one in server.cells.items()
            if one[0] >= old_s or name == given["me"]
        }
        return []

    def take(self, server: Server, given: tuple[str, int]) -> list[tuple[Any, ...]]:
        owner, partition = given
        epoch = server.partitions[partition][0] + 1
        server.set_owner(partition, epoch, owner)
        server.taken.append((owner, partition))
        return [(epoch,)]

    def leave(self, server: Server, given: tuple[list[int], str]) -> list[tuple[Any, ...]]:
        for partition in given[0]:
            epoch, owner = server.partitions[partition]
            if owner == given[1]:
                server.set_owner(partition, epoch, "")
        return []

    def lock(self, server: Server, given: tuple[int, int]) -> list[tuple[Any, ...]]:
        holder = server.locks.setdefault(given[1], self)
        return [(holder is self,)]

    def unlock(self, server: Server, given: tuple[int, int]) -> list[tuple[Any, ...]]:
        if server.locks.get(given[1]) is self:
            del server.locks[given[1]]
        return []

    def end_mine(self, server: Server, _: Any) -> list[tuple[Any, ...]]:
        for one in list(server.sessions.get(self._cell, [])):
            if one is not self:
                one.close()
                one.broken = True
        return []

    def owned(self, server: Server, given: tuple[str]) -> list[tuple[Any, ...]]:
        rows = server.partitions.items()
        return [(id, epoch) for id, (epoch, owner) in rows if owner == given[0]]

    def yes(self, server: Server, _: Any) -> list[tuple[Any, ...]]:
        return [(True,)]

    def count(self, server: Server, _: Any) -> list[tuple[Any, ...]]:
        return [(server.count,)]


_STATEMENTS: dict[str, Any] = {
    partition_session._BEAT: FakeConnection.beat,
    partition_session._MEMBERS: FakeConnection.members,
    partition_session._PARTITIONS: FakeConnection.shares,
    partition_session._END: FakeConnection.end_other,
    partition_session._FORGET_DEAD: FakeConnection.forget,
    partition_session._TAKE: FakeConnection.take,
    partition_session._LEAVE: FakeConnection.leave,
    partition_session._ALIVE: FakeConnection.yes,
}
_BEGINNINGS: dict[str, Any] = {
    "SELECT pg_try_advisory_lock(": FakeConnection.lock,
    "SELECT pg_advisory_unlock(": FakeConnection.unlock,
    "SELECT pg_terminate_backend(": FakeConnection.end_mine,
    "SELECT id, epoch FROM partitions": FakeConnection.owned,
    "SELECT count(*) FROM partitions": FakeConnection.count,
    "SET ": FakeConnection.yes,
    "SELECT pg_try_advisory_lock_shared": FakeConnection.yes,
    "LOCK ": FakeConnection.yes,
    "DELETE FROM partitions": FakeConnection.yes,
    "INSERT INTO partitions": FakeConnection.yes,
}
