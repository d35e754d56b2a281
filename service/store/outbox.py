"""Alarm changes, audit lines, forecasts, tellings on their way to the store: crash-safe, once."""

import json
import threading
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Self
from uuid import uuid4

import msgspec
import structlog

from service.store.alarm_records import Alarm, AlarmTransition
from service.store.closable import Closable
from service.store.deliveries import Delivery
from service.store.durable_queue import DurableQueue
from service.store.errors import StoreUnavailableError
from service.store.forecast_records import IssuedForecast
from service.store.queue_file import Mended, QueueFile, QueueLayout, QueueUnavailableError, Row
from service.store.records import AuditEntry
from service.store.store import Store
from service.store.tellings import Telling, TellingChange

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

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """An alarm as it is now, and what happened to it; no alarm for lines that belong to none.

    What somebody asked for carries its line of the audit trail: both are written, or none.
    """

    alarm: Alarm | None
    lines: tuple[AlarmTransition, ...] = ()
    audit: AuditEntry | None = None


@dataclass(frozen=True, slots=True)
class ForecastBatch:
    """Forecasts that are to be kept together, with the line of who asked for them, if anybody."""

    forecasts: tuple[IssuedForecast, ...]
    audit: AuditEntry | None = None


Change = AlarmChange | AuditEntry | ForecastBatch | TellingChange


class Outbox(Closable):
    """A queue on the disk in front of the store, and the two threads that fill and empty it.

    What is recorded is on the disk a moment later, whether or not the store answers, and stays
    there until the store has it. What an earlier run left is written before anything newer. The
    store remembers the number of the last change that it took, in the same transaction, and so
    takes none twice.

    Parameters
    ----------
    queue : DurableQueue
        Where changes wait.
    store : Store
        Where they go.
    run : str
        Name of this run, where cells of a fleet share the store.

    Attributes
    ----------
    problem : str or None
        Why the store takes nothing at the moment; None while all is well.
    disk_problem : str or None
        Why the disk takes nothing: changes wait in memory only. None while it does.
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

        Each process has a file of its own.

        Raises
        ------
        StoreError
            If its file can be neither opened nor made; one line that names it.
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
        waiting = [change for _, change in self._read() if isinstance(change, AlarmChange)]
        alarms = {alarm.id: alarm for alarm in self._store.alarms.load()}
        alarms |= {change.alarm.id: change.alarm for change in waiting if change.alarm is not None}
        return [alarm for alarm in alarms.values() if alarm.state != "NORM"]

    def load_tellings(self) -> list[Telling]:
        """What was told of alarms, as it is when all that waits has been written."""
        waiting = [change for _, change in self._read() if isinstance(change, TellingChange)]
        found = {one.key: one for one in self._store.tellings.load()}
        found |= {one.key: one for change in waiting for one in change.tellings}
        return [one for one in found.values() if not one.over]

    def record(self, change: Change) -> None:
        """Have a change written after all that were recorded before; returns at once."""
        with self._condition:
            self._new.append(change)
            self._condition.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until all that was recorded is safe: on the disk, and as a rule in the store too.

        Parameters
        ----------
        timeout_s : float
            Wall seconds for a store that takes its time; one that is known to be away is not
            waited for.

        Returns
        -------
        bool
            Whether the store has all.
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
            self._queue.append([(self._sender, _document(change)) for change in changes])
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
        for delivery, change in portion:
            if not self._hand_over(change, delivery):
                break
            self._taken = delivery.number
            count += 1
        try:
            self._queue.remove(self._taken)
        except QueueUnavailableError as error:
            # No harm: the store knows what it has.
            _log.warning("outbox_unavailable", error=str(error), waiting=self.waiting)
        with self._condition:
            self._kept -= count
        return self.problem is None

    def _hand_over(self, change: Change | None, delivery: Delivery | None) -> bool:
        """Write a change into the store; False when that is away."""
        try:
            if isinstance(change, AuditEntry):
                self._store.audit.add(change, delivery)
            elif isinstance(change, ForecastBatch):
                self._store.forecasts.add(change.forecasts, delivery, change.audit)
            elif isinstance(change, TellingChange):
                self._store.tellings.save(change.tellings, delivery)
            elif change is not None:
                self._store.alarms.save(change.alarm, change.lines, delivery, change.audit)
            else:
                self._queue.note_damaged(1)
        except StoreUnavailableError as error:
            if self.problem is None:
                _log.warning("changes_wait", error=str(error), waiting=self.waiting)
            self.problem = str(error)
            return False
        except Exception as error:
            # A change that the store refuses must not hold up the ones behind it.
            _log.error("change_refused", change=change, error=repr(error))
        if self.problem is not None:
            self.problem = None
            _log.info("changes_written_again", waiting=self.waiting)
        return True

    def _read(self, limit: int = -1) -> list[tuple[Delivery, Change | None]]:
        """Read the oldest changes that the store does not have."""
        return [
            (Delivery("", number), None)
            if row is None
            else (Delivery(row[0], number), _change(row[1]))
            for number, row in self._queue.first(limit, self._taken)
        ]

    def _new_sender(self) -> str:
        return f"{self._run}/{uuid4().hex}" if self._run else uuid4().hex

    def _note_mended(self) -> None:
        with self._condition:
            self._kept = len(self._queue)
            # The numbers may begin again: what the store has already it knows by its sender.
            self._sender, self._taken = self._new_sender(), 0


def _document(change: Change) -> str:
    if isinstance(change, ForecastBatch):
        return json.dumps({"forecasts": msgspec.to_builtins(change)})
    if isinstance(change, TellingChange):
        return json.dumps({"tellings": msgspec.to_builtins(change)})
    kind = "audit" if isinstance(change, AuditEntry) else "alarm"
    return json.dumps({kind: asdict(change)}, default=float)


def _change(document: str) -> Change | None:
    """Read a change; None, with a log line, for one of another version."""
    try:
        ((kind, given),) = json.loads(document).items()
        if kind == "audit":
            return AuditEntry(**given)
        if kind == "forecasts":
            return msgspec.convert(given, ForecastBatch)
        if kind == "tellings":
            return msgspec.convert(given, TellingChange)
        alarm = None if given["alarm"] is None else Alarm(**given["alarm"])
        lines = tuple(AlarmTransition(**line) for line in given["lines"])
        audit = given.get("audit")  # earlier versions kept none
        return AlarmChange(alarm, lines, audit and AuditEntry(**audit))
    except (ValueError, TypeError, KeyError, AttributeError, msgspec.MsgspecError) as error:
        _log.error("change_refused", change=document, error=repr(error))
        return None


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
