"""Which partitions of a fleet this cell owns: PostgreSQL decides, and no one else writes for them.

The row of a partition names its owner and counts an epoch up with each new one; who writes for
a partition holds that row against a change until its transaction ends. A session lock for each
partition shows at once that its owner's process has died; a heartbeat shows that one hangs.
"""

import socket
import threading
import time
import uuid
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Final

import psycopg
import structlog
from sqlalchemy import Connection, select
from sqlalchemy.engine import URL

from service.store.closable import Closable
from service.store.errors import DatabaseInUseError
from service.store.partition_session import PartitionSession
from service.store.partition_shares import (
    DEAD_S,
    LOOK_S,
    Watch,
    decide,
    interrupted,
    watched,
)
from service.store.tables import PartitionRow

#: Clocks of cell and server that differ by more are reported.
_CLOCKS_DIFFER_S: Final = 2.0
_END_S: Final = 2.0

_log = structlog.get_logger(__name__)


class Ownership(Closable):
    """The partitions that one run of a cell owns, kept by a thread on a connection of its own.

    Raises `StoreError` if there is no connection, or the cells that run have another number of
    partitions; a `StoreUnavailableError` if that is temporary.

    - ``cell``: names this run; see `run_name`. The connections of its store carry it, too.
    - ``on_change``: called, from another thread, when `owned` or `leaving` has changed.
    - ``on_lost``: called, from another thread, when a partition was taken away. Nothing that this
      run knows about it holds any more: the cell must end.
    - ``lost``: why a partition is lost, one line; empty while none is.
    - ``least_revision``: of the assets: every cell that lives has taken this one up.
    - ``assets``: how many each partition has: by these the cells' shares are even.
    """

    def __init__(
        self,
        url: URL,
        cell: str,
        count: int,
        on_change: Callable[[], object],
        on_lost: Callable[[], object],
        assets: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        self.assets = assets
        self.lost = ""
        self.assets_revision = 0
        self.least_revision = 0
        self._on_change, self._on_lost = on_change, on_lost
        self._lock = threading.Lock()
        self._owned: Mapping[int, int] = MappingProxyType({})
        self._leaving: frozenset[int] = frozenset()
        self._left: set[int] = set()
        self._watch = Watch()
        self._is_offline = False
        self._ended = threading.Event()
        self._session = PartitionSession(url, cell, count)
        self._thread = threading.Thread(target=self._keep, name="ownership", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------ what the cell asks
    @property
    def cell(self) -> str:
        """Name of this run."""
        return self._session.cell

    @property
    def count(self) -> int:
        """How many partitions there are."""
        return self._session.count

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
        """Give the partitions that are ours until the end of a transaction.

        ``FOR SHARE`` makes the next owner wait until then.
        """
        owned = self._owned
        query = (
            select(PartitionRow.id, PartitionRow.epoch)
            .where(PartitionRow.id.in_(list(partitions)), PartitionRow.owner == self.cell)
            .with_for_update(read=True)
        )
        return {id for id, epoch in connection.execute(query) if owned.get(id) == epoch}

    def close(self) -> None:
        """Give everything up; the other cells take it at once."""
        self._ended.set()
        self._thread.join(_END_S)
        if self._thread.is_alive():  # the end of the process does it
            return
        self._session.close(self._owned)

    # ------------------------------------------------------------------ the thread
    def _keep(self) -> None:
        while not self._ended.is_set():
            self._go_round()
            if self.lost:
                return
            self._ended.wait(LOOK_S)

    def _go_round(self) -> None:
        """Connect again where that is needed, and look once."""
        try:
            if self._is_offline:
                self._session.reconnect()
                # What the others did meanwhile is not known.
                self._watch = interrupted(self._watch)
                self._take_again()
                self._is_offline = False
            if not self.lost:
                self._look()
        except DatabaseInUseError as error:
            self.lost = str(error)
            _log.error("database_taken_over", error=self.lost)
            self._on_lost()
        except psycopg.Error as error:
            if self._session.is_broken:
                # No one else can take anything while the server is offline.
                self._is_offline = True
            elif not self._is_offline:
                _log.warning("ownership_look_failed", reason=str(error))

    def _look(self) -> None:
        view = self._session.beat(self.assets_revision)
        now_s = time.monotonic()
        self._watch = watched(self._watch, view, now_s)
        decision = decide(
            self.cell, view, self._watch, now_s, self._owned, self._leaving, self.assets
        )
        for cell, beat_s in decision.end.items():
            if self._session.end_silent(cell, beat_s):
                _log.warning("silent_cell_ended", cell=cell, silent_s=DEAD_S)
        self._session.forget_dead()
        self.least_revision = decision.least_revision
        self._give_up_left()
        if decision.leave:
            self._change(leaving=self._leaving | decision.leave)
        elif decision.take:
            self._take(decision.take)

    def _give_up_left(self) -> None:
        with self._lock:
            left, self._left = self._left, set()
        if not left:
            return
        self._session.leave(left)
        owned = {id: epoch for id, epoch in self._owned.items() if id not in left}
        self._change(owned=owned, leaving=self._leaving - left)

    def _take(self, partitions: Collection[int]) -> None:
        taken: dict[int, int] = {}
        for partition in partitions:
            epoch = self._session.take(partition)
            if epoch is not None:
                taken[partition] = epoch
        if taken:
            owned = len(self._owned) + len(taken)
            _log.info("partitions_taken", cell=self.cell, count=len(taken), owned=owned)
            self._change(owned={**self._owned, **taken})

    def _take_again(self) -> None:
        """Go on after the connection was lost: what no other took meanwhile is still ours."""
        ours = self._session.epochs()
        gone = [
            id
            for id, epoch in self._owned.items()
            if ours.get(id) != epoch or not self._session.lock(id)
        ]
        if gone:
            self.lost = f"another cell owns {len(gone)} partitions that this one owned"
            _log.error("partitions_lost", count=len(gone), partitions=sorted(gone)[:10])
            self._on_lost()
        else:
            _log.info("partitions_owned_again", count=len(self._owned))

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
        ahead_s = self._session.clock_ahead_s
        if abs(ahead_s) < _CLOCKS_DIFFER_S:
            return None
        return f"the clock differs by {ahead_s:+.1f} s from that of the database server"


def owned_by(connection: Connection, partitions: Collection[int], run: str) -> set[int]:
    """Give the partitions that a run, this one or an earlier one, owns until the commit."""
    query = (
        select(PartitionRow.id)
        .where(PartitionRow.id.in_(list(partitions)), PartitionRow.owner == run)
        .with_for_update(read=True)
    )
    return {id for (id,) in connection.execute(query)}


def run_name() -> str:
    """Name a run of a cell: no other one, on any machine, has the same.

    The server shows it as the name of its connections, within 63 characters.
    """
    return f"bearing-twin {socket.gethostname()[:30]} {uuid.uuid4().hex[:8]}"
