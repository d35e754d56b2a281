"""Changes of alarms, audit trail, forecasts and features on their way to the store: safe, once."""

import threading
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Self, TypeVar
from uuid import uuid4

import structlog
from sqlalchemy import Connection

from service.store.alarm_records import Alarm
from service.store.changes import (
    AlarmChange,
    Change,
    FeatureChange,
    change_of,
    document_of,
)
from service.store.closable import Closable
from service.store.deliveries import Delivery
from service.store.durable_queue import DurableQueue
from service.store.errors import StoreUnavailableError
from service.store.queue_file import Mended, QueueFile, QueueLayout, QueueUnavailableError, Row
from service.store.records import AuditEntry
from service.store.refused_changes import NOT_OWNED, Refused, one_line
from service.store.store import Store

FILE_NAME = "outbox.db"

_APPLICATION_ID = 0x4254_6F62
_TABLES = """
CREATE TABLE IF NOT EXISTS changes (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    sender TEXT NOT NULL,
    document TEXT NOT NULL,
    checksum INTEGER
);
"""
#: Some 700 changes find room on a full disk.
_RESERVED_BYTES = 2**20
#: Both the store and the disk are left alone this many wall seconds after they refused.
_RETRY_S = 0.5
#: Wall seconds that `flush` gives the disk.
_DISK_PATIENCE_S = 10.0
_PORTION = 100
#: Changes of one transaction: samples wait that long.
_TOGETHER = 20

_log = structlog.get_logger(__name__)

ChangeT = TypeVar("ChangeT", bound=Change)


class Outbox(Closable):
    """A queue on the disk in front of the store, and the two threads that fill and empty it.

    What is recorded is on the disk a moment later, whether or not the store answers, and stays
    there until the store has it. What an earlier run left is written before anything newer. The
    store remembers the number of the last change that it took, in the same transaction, and so
    takes none twice.

    - ``run``: name of this run, where cells of a fleet share the store.
    - ``problem``: why the store takes nothing at the moment; None while all is well.
    - ``disk_problem``: why the disk takes nothing: changes wait in memory only. None while it does.
    - ``refused``: changes of this run that the store did not take; they stand in `Store.refused`.
    """

    def __init__(self, queue: DurableQueue, store: Store, run: str = "") -> None:
        self._queue = queue
        self._store = store
        self._condition = threading.Condition()
        self._new: deque[Change] = deque()
        self._taken = 0
        self._kept = len(queue)
        self._closing = False
        self.problem: str | None = None
        self.disk_problem: str | None = None
        self.refused = 0
        # Each run is a sender of its own: the numbers of a file that was restored from a copy
        # begin again where the store has gone on from.
        self._run = run
        self._sender = self._new_sender()
        queue.on_mended(self._note_mended)
        self._threads = [
            threading.Thread(target=self._repeat, args=(has_work, work), name=name, daemon=True)
            for name, has_work, work in (
                ("outbox-keeper", lambda: self._new, self._keep),
                ("outbox-sender", lambda: self._kept, self._send),
            )
        ]
        for thread in self._threads:
            thread.start()

    @classmethod
    def open(cls, data_dir: Path, store: Store, file_name: str = FILE_NAME, run: str = "") -> Self:
        """Open an outbox of a data directory and begin to send what is in it.

        Each process has a file of its own. Raises `StoreError` if its file can be neither opened
        nor made; one line that names it.
        """
        path = data_dir / file_name
        return cls(DurableQueue(QueueFile.open(path, _LAYOUT)), store, run)

    @property
    def mended(self) -> Mended | None:
        """What became of the file when it was last found damaged in this run."""
        return self._queue.mended

    @property
    def lost(self) -> int:
        """Changes that damage of the file has cost in this run."""
        return self._queue.lost

    @property
    def waiting(self) -> int:
        """Changes that the store does not have yet."""
        return len(self._new) + self._kept

    @property
    def unkept(self) -> int:
        """Changes that neither the store nor the disk has: a power cut would lose them."""
        return len(self._new)

    def load_alarms(self) -> list[Alarm]:
        """All alarms that are not over, as they are when all that waits has been written."""
        # The file first: what leaves it meanwhile is in the store by then.
        waiting = self.waiting_changes(AlarmChange)
        alarms = {alarm.id: alarm for alarm in self._store.alarms.load()}
        alarms |= {change.alarm.id: change.alarm for change in waiting if change.alarm is not None}
        return [alarm for alarm in alarms.values() if alarm.state != "NORM"]

    def waiting_changes(self, kind: type[ChangeT]) -> list[ChangeT]:
        """Changes of a kind that the store does not have yet, oldest first."""
        found = (change_of(document) for _, document in self._read() if document is not None)
        return [change for change in found if isinstance(change, kind)]

    def record(self, change: Change) -> None:
        """Have a change written after all that were recorded before; returns at once."""
        with self._condition:
            self._new.append(change)
            self._condition.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until all that was recorded is safe: on the disk, and as a rule in the store too.

        ``timeout_s``: wall seconds for a store that takes its time; one that is known to be away is
        not waited for. Returns whether the store has all.
        """
        with self._condition:
            self._condition.wait_for(
                lambda: not self._new or self.disk_problem is not None, _DISK_PATIENCE_S
            )
            self._condition.wait_for(
                lambda: not self.waiting or self.problem is not None, timeout_s
            )
            return not self.waiting

    def close(self, timeout_s: float = 2.0) -> None:
        """Write what is left, for at most this many wall seconds; what the store lacks stays."""
        self.flush(timeout_s)
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        for thread in self._threads:
            thread.join(timeout_s)
        if self._new:
            _log.error("changes_lost", count=len(self._new), error=self.disk_problem)
        elif self._kept:
            _log.warning("changes_wait_for_next_start", count=self._kept, error=self.problem)
        if not any(thread.is_alive() for thread in self._threads):
            self._queue.close()

    # ------------------------------------------------------------------ the two threads
    def _repeat(self, has_work: Callable[[], object], work: Callable[[], bool]) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closing or has_work())
                if self._closing:
                    return
            try:
                done = work()
            except Exception:
                # A thread that ends would stop everything behind it without a word.
                _log.exception("outbox_failed", waiting=self.waiting)
                done = False
            with self._condition:
                self._condition.notify_all()
                if not done:
                    self._condition.wait_for(lambda: self._closing, _RETRY_S)

    def _keep(self) -> bool:
        """Put new changes on the disk; where it takes none, the first goes straight on."""
        with self._condition:
            changes = list(islice(self._new, _PORTION))
        try:
            self._queue.append([(self._sender, document_of(change)) for change in changes])
        except QueueUnavailableError as error:
            if self.disk_problem is None:
                _log.error("outbox_unavailable", error=str(error), waiting=self.waiting)
            self.disk_problem = str(error)
            if self._kept or not self._hand_over(changes[0], None):
                return False
            del changes[1:]
            kept = 0
        else:
            self.disk_problem = None
            kept = len(changes)
        with self._condition:
            for _ in changes:
                self._new.popleft()
            self._kept += kept
        return True

    def _send(self) -> bool:
        """Write a portion of what is on the disk into the store."""
        try:
            portion = self._read(_PORTION)
        except QueueUnavailableError as error:
            _log.error("outbox_unavailable", error=str(error), waiting=self.waiting)
            return False
        count = 0
        for begin in range(0, len(portion), _TOGETHER):
            part = portion[begin : begin + _TOGETHER]
            taken = self._deliver_together(part)
            if taken is None:
                taken = self._deliver_one_by_one(part)
            count += taken
            if taken < len(part):
                break
        try:
            self._queue.remove(self._taken)
        except QueueUnavailableError as error:
            # No harm: the store knows what it has.
            _log.warning("outbox_unavailable", error=str(error), waiting=self.waiting)
        with self._condition:
            self._kept -= count
        return self.problem is None

    def _deliver_together(self, portion: Sequence[tuple[Delivery, str | None]]) -> int | None:
        """Write changes into the store in one transaction: how many; None where one is not good.

        Nothing is written then.
        """
        changes: list[tuple[Change, Delivery]] = []
        for delivery, document in portion:
            change = None if document is None else change_of(document)
            if change is not None:
                changes.append((change, delivery))
        if len(portion) < 2 or len(changes) < len(portion):
            return None
        refused = self.refused
        try:
            with self._store.delivering():
                for change, delivery in changes:
                    self._write(change, delivery)
        except StoreUnavailableError as error:
            self.refused = refused
            self._wait(error)
            return 0
        except Exception:  # one by one shows which of them the store refuses, and why
            self.refused = refused
            return None
        self._taken = portion[-1][0].number
        self._go_on()
        return len(portion)

    def _deliver_one_by_one(self, portion: Sequence[tuple[Delivery, str | None]]) -> int:
        """Write changes into the store, each in its own transaction; how many it took."""
        for count, (delivery, document) in enumerate(portion):
            if not self._deliver(document, delivery):
                return count
            self._taken = delivery.number
        return len(portion)

    def _deliver(self, document: str | None, delivery: Delivery) -> bool:
        """Write what stands in the file into the store; False when that is offline."""
        if document is None:
            self._queue.note_damaged(1)
            return True
        change = change_of(document)
        if change is not None:
            return self._hand_over(change, delivery)
        return self._refuse(None, document, "this version cannot read it", delivery)

    def _hand_over(self, change: Change, delivery: Delivery | None) -> bool:
        """Write a change into the store; False when that is offline."""
        try:
            self._write(change, delivery)
        except StoreUnavailableError as error:
            return self._wait(error)
        except Exception as error:
            # A change that the store refuses must not hold up the ones behind it.
            return self._refuse(change, document_of(change), one_line(error), delivery)
        return self._go_on()

    def _write(self, change: Change, delivery: Delivery | None) -> None:
        if isinstance(change, AuditEntry):
            self._store.audit.add(change, delivery)
        elif isinstance(change, FeatureChange):
            refuse = partial(self._add_refused, delivery=delivery)
            change.save(self._store, delivery, refuse)
        else:
            self._store.alarms.save(change.alarm, change.lines, delivery, change.audit)

    def _add_refused(
        self, connection: Connection, change: Change, *, delivery: Delivery | None
    ) -> None:
        """Keep a part of a change that the store does not take, together with the rest of it."""
        refused = Refused(change, document_of(change), NOT_OWNED, delivery)
        self._store.refused.add_within(connection, refused)
        self.refused += 1

    def _refuse(
        self, change: Change | None, document: str, reason: str, delivery: Delivery | None
    ) -> bool:
        """Keep a change that the store does not take where it is seen; False when it waits."""
        _log.error("change_refused", change=document, reason=reason)
        try:
            self._store.refused.add(Refused(change, document, reason, delivery))
        except StoreUnavailableError as error:
            return self._wait(error)
        self.refused += 1
        return self._go_on()

    def _wait(self, error: StoreUnavailableError) -> bool:
        if self.problem is None:
            _log.warning("changes_wait", error=str(error), waiting=self.waiting)
        self.problem = str(error)
        return False

    def _go_on(self) -> bool:
        if self.problem is not None:
            self.problem = None
            _log.info("changes_written_again", waiting=self.waiting)
        return True

    def _read(self, limit: int = -1) -> list[tuple[Delivery, str | None]]:
        """Read the oldest changes that the store does not have; None for a damaged one."""
        return [
            (Delivery("", number), None) if row is None else (Delivery(row[0], number), row[1])
            for number, row in self._queue.first(limit, self._taken)
        ]

    def _new_sender(self) -> str:
        return f"{self._run}/{uuid4().hex}" if self._run else uuid4().hex

    def _note_mended(self) -> None:
        with self._condition:
            self._kept = len(self._queue)
            # The numbers may begin again: what the store has already it knows by its sender.
            self._sender, self._taken = self._new_sender(), 0


def _checksum(row: Row) -> int:
    sender, document = row
    return zlib.crc32(f"{sender}\0{document}".encode(errors="replace"))


def _salvage(row: Row) -> Row | None:
    return row if all(isinstance(value, str) for value in row) else None


_LAYOUT = QueueLayout(
    application_id=_APPLICATION_ID,
    tables=_TABLES,
    table="changes",
    key="number",
    columns=("sender", "document"),
    checksum=_checksum,
    salvage=_salvage,
    added_columns=[("checksum", "INTEGER")],
    reserved_bytes=_RESERVED_BYTES,
)
