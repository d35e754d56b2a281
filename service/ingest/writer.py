"""The one thread that writes samples into the store."""

import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from itertools import groupby

import structlog

from adapters.samples import Sample
from service.ingest.metrics import SampleLedger
from service.store import Store, StoreUnavailableError, WriteCounts

#: A transaction holds at least so many samples, or those of so many wall seconds.
BATCH_SAMPLES = 5000
BATCH_S = 0.5
#: Samples that may wait in memory (about 40 MB): 40 s at 5000 samples/s.
QUEUE_SAMPLES = 200_000
#: The store is given so long per try, and is left alone so long in between.
_PATIENCE_S = 1.0
_RETRY_S = 0.2

_log = structlog.get_logger(__name__)

_Parcel = tuple[Sequence[Sample], "Future[WriteCounts] | None"]


class SampleWriter:
    """A bounded queue of samples in front of the store, and the thread that empties it.

    Putting samples in never waits for the store. While the store does not answer, the writer
    tries again until it does.

    Parameters
    ----------
    store : Store
        Where the samples go.
    ledger : SampleLedger
        Where every sample is accounted for.
    """

    def __init__(self, store: Store, ledger: SampleLedger) -> None:
        self._store = store
        self._ledger = ledger
        self._parcels: deque[_Parcel] = deque()
        self._queued = 0
        self._waiting_since = 0.0
        self._urgent = False
        self._condition = threading.Condition()
        self._give_up_at: float | None = None
        self._thread: threading.Thread | None = None
        self.problem: str | None = None

    def start(self) -> None:
        """Begin to write; what was put in before waits until then."""
        self._thread = threading.Thread(target=self._run, name="sample-writer", daemon=True)
        self._thread.start()

    def put(self, samples: Sequence[Sample]) -> None:
        """Queue samples; those for which there is no room are skipped and counted."""
        self._ledger.accept(len(samples))
        with self._condition:
            stopped = self._give_up_at is not None
            room = 0 if stopped else max(QUEUE_SAMPLES - self._queued, 0)
            if room:
                self._append(samples[:room], None)
        if len(samples) > room:
            lost = len(samples) - room
            self._ledger.skip(lost, "store_unavailable" if stopped else "queue_full")

    def put_and_tell(self, samples: Sequence[Sample]) -> "Future[WriteCounts]":
        """Queue samples, all or none; the future ends when they are on the disk.

        Raises
        ------
        StoreUnavailableError
            If there is no room for them, or the writer has stopped; then none is accepted.
        """
        future: Future[WriteCounts] = Future()
        with self._condition:
            if self._give_up_at is not None:
                raise StoreUnavailableError("the service is stopping")
            if self._queued + len(samples) > QUEUE_SAMPLES:
                raise StoreUnavailableError(
                    f"{self._queued} samples already wait to be stored"
                    + (f" ({self.problem})" if self.problem else "")
                )
            self._ledger.accept(len(samples))
            self._urgent = True
            self._append(samples, future)
        return future

    def close(self, timeout_s: float) -> None:
        """Write everything that is queued, then stop.

        Parameters
        ----------
        timeout_s : float
            Wall seconds for a store that does not answer; then what is left is given up, counted
            and logged.
        """
        with self._condition:
            self._give_up_at = time.monotonic() + timeout_s
            self._condition.notify()
        if self._thread is not None:
            self._thread.join()

    def _append(self, samples: Sequence[Sample], future: "Future[WriteCounts] | None") -> None:
        if not self._parcels:
            self._waiting_since = time.monotonic()
        self._parcels.append((samples, future))
        self._queued += len(samples)
        # Waking the thread for every few samples would cost more than writing them.
        if len(self._parcels) == 1 or self._urgent or self._queued >= BATCH_SAMPLES:
            self._condition.notify()

    def _run(self) -> None:
        while parcels := self._next():
            for future, group in groupby(parcels, key=lambda parcel: parcel[1]):
                samples = [sample for part, _ in group for sample in part]
                # False when nobody waits any more; the samples were accepted all the same.
                awaited = future is not None and future.set_running_or_notify_cancel()
                counts = self._write(samples)
                with self._condition:
                    self._queued -= len(samples)
                if future is None or not awaited:
                    continue
                if counts is None:
                    future.set_exception(StoreUnavailableError("the samples were not stored"))
                else:
                    future.set_result(counts)

    def _next(self) -> list[_Parcel]:
        """Wait for the next batch; empty when the writer has been stopped and all is done."""
        with self._condition:
            while not self._due():
                rest_s = self._waiting_since + BATCH_S - time.monotonic()
                self._condition.wait(max(rest_s, 0.0) if self._parcels else None)
            batch: list[_Parcel] = []
            count = 0
            while self._parcels and count < BATCH_SAMPLES:
                batch.append(self._parcels.popleft())
                count += len(batch[-1][0])
            if not self._parcels:
                self._urgent = False
            return batch

    def _due(self) -> bool:
        if self._give_up_at is not None:
            return True
        if not self._parcels:
            return False
        waited_s = time.monotonic() - self._waiting_since
        return self._urgent or self._queued >= BATCH_SAMPLES or waited_s >= BATCH_S

    def _write(self, samples: Sequence[Sample]) -> WriteCounts | None:
        """Store samples, however long that takes; None when that is not to be."""
        while True:
            try:
                counts = self._store.write_samples(samples, _PATIENCE_S)
            except StoreUnavailableError as error:
                if self.problem is None:
                    _log.warning("store_unavailable", error=str(error), samples=len(samples))
                self.problem = str(error)
                if self._give_up_at is not None and time.monotonic() > self._give_up_at:
                    _log.error("samples_lost", count=len(samples), error=str(error))
                    self._ledger.skip(len(samples), "store_unavailable")
                    return None
                time.sleep(_RETRY_S)
            except Exception:
                # A sample that the store refuses must not take its neighbours with it, nor end
                # this thread: halve the batch until it is found.
                if len(samples) == 1:
                    _log.exception("sample_refused", sample=samples[0])
                    self._ledger.skip(1, "refused")
                    return None
                middle = len(samples) // 2
                halves = [self._write(samples[:middle]), self._write(samples[middle:])]
                parts = [part for part in halves if part is not None]
                if not parts:
                    return None
                return WriteCounts(
                    sum(part.stored for part in parts), sum(part.duplicates for part in parts)
                )
            else:
                if self.problem is not None:
                    _log.info("store_available", waiting=self._queued)
                    self.problem = None
                self._ledger.settle(stored=counts.stored, duplicates=counts.duplicates)
                return counts
