"""Samples that wait in memory for the thread that stores them."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from adapters.samples import Sample
from service.store import StoreUnavailableError, WriteCounts

#: A transaction holds at least this many samples, or those of this many wall seconds.
BATCH_SAMPLES = 5000
BATCH_S = 0.5
#: A push of more samples is a backlog. It is stored in portions of this many, and whatever else
#: comes meanwhile goes first.
PORTION_SAMPLES = 2000
#: Samples that may wait in memory (about 40 MB): 40 s at 5000 samples/s.
QUEUE_SAMPLES = 200_000


@dataclass(slots=True, eq=False)
class Parcel:
    """Samples that came together.

    - ``future``: ends when they are on the disk; None where no one waits for that.
    - ``kept``: of a backlog, what became of each portion so far; None: it was not kept.
    """

    samples: Sequence[Sample]
    future: Future[WriteCounts] | None = None
    kept: list[WriteCounts | None] = field(default_factory=list)

    @property
    def portion(self) -> Sequence[Sample]:
        """What of a backlog is to be stored next; empty when all has been."""
        first = len(self.kept) * PORTION_SAMPLES
        return self.samples[first : first + PORTION_SAMPLES]

    def begin(self) -> bool:
        """From now on it cannot be withdrawn; False when its client has withdrawn it."""
        future = self.future
        return future is None or future.running() or future.set_running_or_notify_cancel()

    def end(self, kept: Sequence[WriteCounts | None]) -> None:
        """Report what became of its portions."""
        future = self.future
        if future is None or future.done():
            return
        counts = [one for one in kept if one is not None]
        if len(counts) < len(kept):
            future.set_exception(StoreUnavailableError("the samples were not stored"))
        else:
            future.set_result(sum_of(counts))


class SampleQueue:
    """A bounded queue of parcels; long ones wait apart and give way to the others.

    - ``length``: samples that wait.
    - ``gives_up_at``: monotonic time at which what still waits is given up; None before the stop.
    """

    def __init__(self) -> None:
        self.length = 0
        self.gives_up_at: float | None = None
        self._parcels: deque[Parcel] = deque()
        self._backlog: deque[Parcel] = deque()
        self._waiting_since = 0.0
        self._urgent = True  # what comes first is stored at once
        self._changed = threading.Condition()

    def put(self, samples: Sequence[Sample]) -> int:
        """Append samples for which there is room; gives how many that are."""
        with self._changed:
            room = 0 if self.gives_up_at is not None else max(QUEUE_SAMPLES - self.length, 0)
            if room:
                self._append(Parcel(samples[:room]))
        return min(room, len(samples))

    def push(self, parcel: Parcel, accept: Callable[[int], None], problem: str | None) -> None:
        """Append a parcel whose client waits; ``accept`` counts its samples once that is certain.

        Raises `StoreUnavailableError` if there is no room, or the queue was stopped.
        """
        count = len(parcel.samples)
        with self._changed:
            if self.gives_up_at is not None:
                raise StoreUnavailableError("the service is stopping")
            if self.length + count > QUEUE_SAMPLES:
                raise StoreUnavailableError(
                    f"{self.length} samples already wait to be stored"
                    + (f" ({problem})" if problem else "")
                )
            accept(count)
            if count > PORTION_SAMPLES:
                self._backlog.append(parcel)
                self.length += count
                self._changed.notify()
            else:
                self._urgent = True
                self._append(parcel)

    def _append(self, parcel: Parcel) -> None:
        if not self._parcels:
            self._waiting_since = time.monotonic()
        self._parcels.append(parcel)
        self.length += len(parcel.samples)
        # Waking the thread for every few samples would cost more than writing them.
        if len(self._parcels) == 1 or self._urgent or self.length >= BATCH_SAMPLES:
            self._changed.notify()

    def withdraw(self, future: Future[WriteCounts]) -> int | None:
        """Take a parcel back: how many samples; None when it is being written, or is already."""
        with self._changed:
            # The writing thread has taken a short parcel out of its queue, and marked a long one.
            if not future.cancel():
                return None
            for queue in (self._parcels, self._backlog):
                for parcel in queue:
                    if parcel.future is future:
                        queue.remove(parcel)
                        self.length -= len(parcel.samples)
                        return len(parcel.samples)
        return None

    def stop(self, gives_up_at: float) -> None:
        """Let nothing more in; the thread that empties it is woken."""
        with self._changed:
            self.gives_up_at = gives_up_at
            self._changed.notify()

    def clear(self) -> list[Parcel]:
        """Take everything out that waits."""
        with self._changed:
            parcels = [*self._parcels, *self._backlog]
            self._parcels.clear()
            self._backlog.clear()
        return parcels

    def is_due(self) -> bool:
        """Whether a batch is full, has waited for long enough, or is asked for at once."""
        if self.gives_up_at is not None or self._backlog:
            return True
        if not self._parcels:
            return False
        waited_s = time.monotonic() - self._waiting_since
        return self._urgent or self.length >= BATCH_SAMPLES or waited_s >= BATCH_S

    def next_batch(self, longest_s: Callable[[], float | None]) -> list[Parcel] | None:
        """Wait for the next batch, which may be empty; None when stopped, and all is out.

        ``longest_s``: gives how long the thread may wait here, in wall seconds; None: for ever.
        """
        with self._changed:
            while not self.is_due():
                rest_s = max(self._waiting_since + BATCH_S - time.monotonic(), 0.0)
                limits_s = [rest_s if self._parcels else None, longest_s()]
                wait_s = min((one for one in limits_s if one is not None), default=None)
                if not self._changed.wait(wait_s) and limits_s[1] is not None:
                    break
            batch: list[Parcel] = []
            count = 0
            while self._parcels and count < BATCH_SAMPLES:
                batch.append(self._parcels.popleft())
                count += len(batch[-1].samples)
            if not self._parcels:
                self._urgent = False
            if not (batch or self._backlog) and self.gives_up_at is not None:
                return None
            return batch

    def first_of_backlog(self) -> Parcel | None:
        """The long parcel whose turn it is; it cannot be withdrawn any more."""
        with self._changed:
            if not self._backlog:
                return None
            parcel = self._backlog[0]
            if not parcel.kept:
                parcel.begin()
            return parcel

    def leave(self, count: int, ended: Parcel | None = None) -> None:
        """Count samples that wait no more, and remove a parcel of the backlog that has ended."""
        with self._changed:
            self.length -= count
            if ended is not None and self._backlog:
                self._backlog.popleft()


def sum_of(counts: Sequence[WriteCounts]) -> WriteCounts:
    """Counts of several writes as one."""
    return WriteCounts(sum(one.stored for one in counts), sum(one.duplicates for one in counts))
