"""The one thread that writes samples into the store, or on the spool while the store is away."""

import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from heapq import nsmallest
from itertools import groupby
from operator import attrgetter

import structlog

from adapters.backoff import Backoff
from adapters.samples import Sample
from service.ingest.metrics import SampleLedger
from service.ingest.sample_queue import Parcel, SampleQueue, sum_of
from service.ingest.spool import Spool
from service.ingest.too_old import TooOld
from service.store import QueueUnavailableError, Store, StoreUnavailableError, WriteCounts

#: The store is given so long per try, and is left alone so long in between.
_PATIENCE_S = 1.0
_RETRY_S = 0.2
#: Longest pause, in wall seconds, between attempts at a store that stays away.
_RETRY_LAST_S = 2.0
#: The spool is emptied in portions of this many samples, for so long before new ones have a turn.
_DRAIN_SAMPLES = 5000
_DRAIN_S = 0.5
#: At the stop a store that hangs has so long; then what it was given goes on the spool as well.
_HANGS_S = 2.0

_log = structlog.get_logger(__name__)

_Write = Callable[[Sequence[Sample]], WriteCounts]


class SampleWriter:
    """A bounded queue of samples in front of the store, and the thread that empties it.

    Putting samples in never waits for the store. While the store does not answer, samples go on
    the spool; when it answers again, it first gets what is on the spool, so that their order is
    kept.

    - ``problem``: why the store takes no samples at the moment; None while all is well.
    - ``spool_problem``: why the spool does not take them either: samples wait in memory only. None
      while it does.
    - ``too_old``: samples that the store does not take because it has removed that time already.
    """

    def __init__(self, store: Store | None, spool: Spool, ledger: SampleLedger) -> None:
        self._store = store
        self._spool = spool
        self._ledger = ledger
        self._queue = SampleQueue()
        self._in_hand: Sequence[Sample] = ()
        self._thread: threading.Thread | None = None
        self._backoff = Backoff(_RETRY_S, _RETRY_LAST_S)
        self._retry_at = 0.0
        self._answers = 0  # of the store and the spool, good or bad
        self.problem: str | None = None
        self.spool_problem: str | None = None
        self.too_old = TooOld()
        lost = spool.take_lost()
        self._ledger.accept(len(spool) + lost)
        self._ledger.skip(lost, "damaged")

    @property
    def queued(self) -> int:
        """Samples that wait in memory."""
        return self._queue.length

    @property
    def spooled(self) -> int:
        """Samples that wait on the spool."""
        return len(self._spool)

    @property
    def is_running(self) -> bool:
        """Whether the thread is there that writes."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Begin to write; what was put in before waits until then."""
        self._thread = threading.Thread(target=self._run, name="sample-writer", daemon=True)
        self._thread.start()

    def attach(self, store: Store) -> None:
        """Store samples from now on; what waits on the spool goes first."""
        self._store = store

    def put(self, samples: Sequence[Sample]) -> None:
        """Queue samples; those for which there is no room are skipped and counted."""
        self._ledger.accept(len(samples))
        if lost := len(samples) - self._queue.put(samples):
            stopped = self._queue.gives_up_at is not None
            self._ledger.skip(lost, "store_unavailable" if stopped else "queue_full")

    def put_with_result(self, samples: Sequence[Sample]) -> "Future[WriteCounts]":
        """Queue samples, all or none; the future ends when they are on the disk.

        On the spool a sample that is known already looks like a new one; there all count
        as stored. Raises `StoreUnavailableError` if there is no room for them, or the writer has
        stopped; then none is accepted.
        """
        future: Future[WriteCounts] = Future()
        self._queue.push(Parcel(samples, future), self._ledger.accept, self.problem)
        return future

    def refuse_too_old(self, samples: Sequence[Sample]) -> None:
        """Count and report samples that are known to be too old for the store."""
        if samples:
            self._ledger.accept(len(samples))
            self._ledger.skip(len(samples), "too_old")
            self.too_old.add(samples, self._store.samples.kept_from_us if self._store else 0)

    def withdraw(self, future: "Future[WriteCounts]") -> bool:
        """Take queued samples back; False when they are being written, or are written already."""
        count = self._queue.withdraw(future)
        if count is None:
            return False
        self._ledger.skip(count, "withdrawn")
        return True

    def close(self, timeout_s: float) -> None:
        """Write everything that is queued, into the store or on the spool, then stop.

        ``timeout_s``: wall seconds for a store and a spool that do not answer; then what is left in
        memory is given up, counted and logged. What is on the spool stays there.
        """
        self._queue.stop(time.monotonic() + timeout_s)
        if self._thread is None:
            return
        while self._thread.is_alive():
            seen = self._answers
            self._thread.join(_HANGS_S)
            if self._answers == seen and self._thread.is_alive():
                self._rescue()
                return

    def _rescue(self) -> None:
        """Put everything on the spool next to a thread that hangs in the store.

        Should the store take it after all, it is the same sample once more, and known by then.
        """
        parcels = self._queue.clear()
        samples = [*self._in_hand, *(one for parcel in parcels for one in parcel.samples)]
        _log.warning("store_hangs", samples_on_spool=len(samples))
        try:
            if samples:
                self._on_spool(samples)
        except QueueUnavailableError as error:
            _log.error("samples_lost", count=len(samples), error=str(error))
            return
        for parcel in parcels:
            if parcel.future is not None and not parcel.future.done() and parcel.begin():
                parcel.end([WriteCounts(0, 0)])

    def _run(self) -> None:
        while (parcels := self._next()) is not None:
            self._work_off(parcels)

    def _work_off(self, parcels: Sequence[Parcel]) -> None:
        """Store what waits on the spool, for a while, and then a batch."""
        self._drain()
        # Parcels without a waiting caller share a transaction; the others get their own counts.
        for future, group in groupby(parcels, key=attrgetter("future")):
            alike = list(group)
            samples = [one for parcel in alike for one in parcel.samples]
            if future is not None:
                alike[0].begin()  # of a client that is gone the samples are kept all the same
            counts = self._keep(samples)
            self._queue.leave(len(samples))
            alike[0].end([counts])
        self._keep_backlog()

    def _keep_backlog(self) -> None:
        """Keep one portion of a long push."""
        push = self._queue.first_of_backlog()
        if push is None:
            return
        portion = push.portion
        push.kept.append(self._keep(portion))
        has_ended = not push.portion
        self._queue.leave(len(portion), push if has_ended else None)
        if has_ended:
            push.end(push.kept)

    def _next(self) -> list[Parcel] | None:
        """Wait for the next batch; it may be empty while the spool is not."""
        return self._queue.next_batch(self._until_retry_s)

    def _until_retry_s(self) -> float | None:
        """Wall seconds until the spool may be emptied; None while there is nothing on it."""
        return max(self._retry_at - time.monotonic(), 0.0) if len(self._spool) else None

    def _keep(self, samples: Sequence[Sample]) -> WriteCounts | None:
        """Put samples into the store or on the spool; None when nothing was kept."""
        kept: list[WriteCounts] = []
        self._in_hand = samples
        while True:
            if not len(self._spool):
                counts, samples = self._write(samples, self._into_store)
                kept += counts
            if samples:
                counts, samples = self._write(samples, self._on_spool)
                kept += counts
            if not samples:
                break
            if self._queue.gives_up_at is not None and time.monotonic() > self._queue.gives_up_at:
                _log.error("samples_lost", count=len(samples), error=self.spool_problem)
                self._ledger.skip(len(samples), "store_unavailable")
                self._in_hand = ()
                return None
            self._in_hand = samples
            time.sleep(_RETRY_S)
            self._drain()
        self._in_hand = ()
        if not kept:
            return None
        return sum_of(kept)

    def _drain(self) -> None:
        """Move samples from the spool into the store, for a while, if the store takes them."""
        if time.monotonic() < self._retry_at:
            return
        if self._store is None:
            self._retry_at = time.monotonic() + self._backoff.wait_s
            return
        until = time.monotonic() + _DRAIN_S
        while len(self._spool) and time.monotonic() < until:
            settled = 0
            try:
                chunk = self._spool.first(_DRAIN_SAMPLES)
                if chunk is None:
                    return
                _, rest = self._write(chunk.samples, self._into_store)
                settled = len(chunk.samples) - len(rest)
                if not rest:
                    self._spool.remove(chunk)
                    continue
            except QueueUnavailableError as error:
                _log.warning("spool_unavailable", error=str(error), waiting=len(self._spool))
                self._retry_at = time.monotonic() + self._backoff.wait_s
            finally:
                self._ledger.skip(self._spool.take_lost(), "damaged")
            # What is stored but still on the spool is read once more, and a duplicate then.
            self._ledger.accept(settled)
            return

    def _write(
        self, samples: Sequence[Sample], write: _Write
    ) -> tuple[list[WriteCounts], list[Sample]]:
        """Write samples; return the counts of what was written, and what could not be.

        A sample that is refused for what it is must not take its neighbours with it, nor end this
        thread: the batch is halved until it is found; it is skipped and counted.
        """
        written: list[WriteCounts] = []
        parts = [samples]
        while parts:
            part = parts.pop()
            try:
                written.append(write(part))
                self._answers += 1
            except StoreUnavailableError as error:
                if self.problem is None:
                    _log.warning("store_unavailable", error=str(error), waiting=self._queue.length)
                self.problem = str(error)
                self._retry_at = time.monotonic() + self._backoff.next()
                return written, [one for rest in (part, *reversed(parts)) for one in rest]
            except QueueUnavailableError as error:
                self._answers += 1
                if self.spool_problem is None:
                    _log.error("spool_unavailable", error=str(error), waiting=self._queue.length)
                self.spool_problem = str(error)
                return written, [one for rest in (part, *reversed(parts)) for one in rest]
            except Exception:
                # Whatever the reason, see above. It is an answer too: the store does not hang.
                self._answers += 1
                if len(part) == 1:
                    _log.exception("sample_refused", sample=part[0])
                    self._ledger.skip(1, "refused")
                else:
                    middle = len(part) // 2
                    parts += [part[middle:], part[:middle]]
        return written, []

    def _into_store(self, samples: Collection[Sample]) -> WriteCounts:
        if self._store is None:
            raise StoreUnavailableError("the store is not open yet")
        with self._ledger.write_seconds.time():
            counts = self._store.samples.write(samples, _PATIENCE_S)
        if self.problem is not None:
            _log.info("store_available", waiting=self._queue.length + len(self._spool))
        self.problem = self.spool_problem = None
        self._backoff.reset()
        self._ledger.settle(stored=counts.stored, duplicates=counts.duplicates)
        if too_old := len(samples) - counts.stored - counts.duplicates:
            self._ledger.skip(too_old, "too_old")
            # They are the oldest ones, whatever became of that time meanwhile.
            oldest = nsmallest(too_old, samples, key=attrgetter("time_us"))
            self.too_old.add(oldest, self._store.samples.kept_from_us)
        return counts

    def _on_spool(self, samples: Collection[Sample]) -> WriteCounts:
        given_up = self._spool.append(samples)
        self.spool_problem = None
        if given_up:
            _log.error("spool_full", samples_given_up=given_up, waiting=len(self._spool))
            self._ledger.skip(given_up, "spool_full")
        return WriteCounts(len(samples), 0)
