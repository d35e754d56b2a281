"""Parts of the product that a simulation runs without threads."""

import contextlib
from collections.abc import Iterator
from typing import Any

import psycopg
from sqlalchemy import Connection

from service.store import (
    Outbox,
    StoreUnavailableError,
)
from service.store.database import PATIENCE_S, Database


class NoThread:
    """A thread whose work the turns of a cell do."""

    def __init__(self, **_: object) -> None:
        pass

    def start(self) -> None:
        pass

    def join(self, _: float) -> None:
        pass

    def is_alive(self) -> bool:
        return False


class CellDatabase(Database):
    """The store's database as one cell reaches it."""

    def __init__(self, fleet: Any, actor: str) -> None:
        base = fleet.store._database
        super().__init__(base.engine, base.name, base.dialect, base._writer)
        self._fleet, self._actor = fleet, actor

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        self._reach("a query")
        with super().reading() as connection:
            yield connection

    @contextlib.contextmanager
    def writing(self, patience_s: float = PATIENCE_S) -> Iterator[Connection]:
        self._reach("a transaction")
        with super().writing(patience_s) as connection:
            yield connection
            assets = [one for (one,) in connection.exec_driver_sql("SELECT asset FROM sim_writes")]
            if assets:
                connection.exec_driver_sql("DELETE FROM sim_writes")
                self._fleet.see_writes(self._actor, assets)
            self._fleet.world.reach(self._actor, "a commit")
        self._reach("the answer to a commit")

    def _reach(self, place: str) -> None:
        self._fleet.world.reach(self._actor, place)
        try:
            self._fleet.server.require_answer(self._actor)
        except psycopg.OperationalError as error:
            raise StoreUnavailableError(str(error)) from error


class CellOutbox(Outbox):
    """An outbox without threads."""

    def flush(self, timeout_s: float) -> bool:
        self.turn()
        return not self.waiting

    def turn(self) -> None:
        while self._new and self._keep():
            pass
        while self._kept and self._send():
            pass
