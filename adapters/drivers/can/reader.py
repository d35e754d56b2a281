"""The thread that listens to a CAN bus.

python-can's own Notifier ends silently when its bus fails, and some interfaces return at once for
ever when their peer is gone, so this is a thread of our own that watches over what it reads.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

import can

from adapters import AdapterError
from adapters.backoff import Backoff
from adapters.drivers.can.binding import MessageTable
from adapters.drivers.can.bus import close_bus, open_bus
from adapters.drivers.can.config import CanSource
from adapters.protocol import Clock
from adapters.samples import Sample
from adapters.words import one_line

logger = logging.getLogger(__name__)

# Wall seconds.
RECEIVE_S = 0.25  # one wait for a frame; also how long a stop may take to be noticed
RECONNECT_FIRST_S = 0.2
RECONNECT_LAST_S = 5.0
SILENCE_FIRST_S = 10.0  # without any frame the bus is opened again: a peer can vanish silently
SILENCE_LAST_S = 60.0

CAPACITY = 50_000  # samples kept while no one takes them
MOST_GARBAGE = 50  # unreadable lines in a row
MOST_EMPTY_READS = 50  # reads in a row that return nothing long before their time


class BusLostError(AdapterError):
    """The bus is open but of no more use."""


class Reader(threading.Thread):
    """Listens, decodes, and keeps samples until they are taken.

    ``notify``: called from this thread when samples wait after there were none, and when it ends.
    """

    def __init__(
        self,
        source: CanSource,
        messages: MessageTable,
        clock: Clock,
        notify: Callable[[], None],
    ) -> None:
        super().__init__(name=f"can-{source.name}", daemon=True)
        self._source = source
        self._messages = messages
        self._clock = clock
        self._notify = notify
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._waiting: deque[Sample] = deque()
        self._errors: dict[str, int] = {}
        self._lost = False  # the bad samples that mark the gap have been handed over
        self._silence = Backoff(SILENCE_FIRST_S, SILENCE_LAST_S)
        self.problem = "not connected yet"
        self.failure: BaseException | None = None
        self.frames = 0
        self.skipped = 0
        self.reconnects = 0

    def stop(self) -> None:
        """Ask the thread to end; it closes the bus itself."""
        self._stopping.set()

    def take(self) -> list[Sample]:
        """Take all samples that wait."""
        with self._lock:
            taken, self._waiting = self._waiting, deque()
        return list(taken)

    def errors(self) -> dict[str, int]:
        """Copy of the number of errors by kind."""
        with self._lock:
            return dict(self._errors)

    def run(self) -> None:
        """Open, listen, and open again, until stopped."""
        try:
            self._run()
        except BaseException as error:
            self.failure = error  # the driver raises it again where it will be seen
            raise
        finally:
            self._notify()

    def _run(self) -> None:
        backoff = Backoff(RECONNECT_FIRST_S, RECONNECT_LAST_S)
        opened_before = False
        while not self._stopping.is_set():
            frames_before = self.frames
            try:
                bus = open_bus(self._source)
            except Exception as error:  # interfaces raise whatever their libraries raise
                self._count("connect")
                self._lose(f"cannot open {self._source.channel}: {_reason(error)}")
            else:
                self.problem = ""
                if opened_before:
                    self.reconnects += 1
                    logger.info("source %s: bus reopened", self._source.name)
                opened_before = True
                try:
                    self._listen(bus)
                except Exception as error:  # also
                    self._count("bus")
                    self._lose(f"{self._source.channel}: {_reason(error)}")
                finally:
                    close_bus(bus)
            if self.frames > frames_before:
                backoff.reset()
            self._stopping.wait(backoff.next())

    def _listen(self, bus: can.BusABC) -> None:
        """Read frames until stopped; raises when the bus is lost."""
        heard = time.monotonic()
        garbage = empty = 0
        while not self._stopping.is_set():
            began = time.monotonic()
            try:
                frame = bus.recv(RECEIVE_S)
            except (ValueError, IndexError) as error:  # slcan: a torn or foreign line
                self._count("garbage")
                garbage += 1
                if garbage > MOST_GARBAGE:
                    raise BusLostError(f"no valid CAN frames ({error})") from error
                continue
            if frame is None:
                now = time.monotonic()
                empty = empty + 1 if now - began < 0.1 * RECEIVE_S else 0
                if empty > MOST_EMPTY_READS:
                    raise BusLostError("reads return at once without a frame")
                if now - heard > self._silence_limit_s():
                    self._silence.next()
                    raise BusLostError(f"no frame for {now - heard:.0f} s")
                continue
            heard = time.monotonic()
            garbage = empty = 0
            self._silence.reset()
            self._receive(frame)

    def _receive(self, frame: can.Message) -> None:
        self.frames += 1
        if frame.is_error_frame or frame.is_remote_frame:
            self._count("error_frame" if frame.is_error_frame else "remote_frame")
            return
        message = self._messages.find(frame.arbitration_id, frame.is_extended_id)
        if message is None:
            self._count("unknown_id")
            return
        samples = message.receive(frame.arbitration_id, frame.data, self._clock.now_us())
        for kind in message.errors:
            self._count(kind)
        self._lost = False
        self._put(samples)

    def _silence_limit_s(self) -> float:
        rate = self._clock.rate
        slowest_us = max((m.age_limit_us(rate) for m in self._messages.values()), default=0.0)
        return max(self._silence.wait_s, slowest_us / 1e6 / rate)

    def _lose(self, problem: str) -> None:
        """Note the loss and mark the gap, once per loss."""
        if problem != self.problem:
            logger.warning("source %s: %s", self._source.name, problem)
        self.problem = problem
        if self._lost or self._stopping.is_set():
            return
        self._lost = True
        now_us = self._clock.now_us()
        for message in self._messages.values():
            self._put(message.bad_samples(now_us))

    def _put(self, samples: list[Sample]) -> None:
        if not samples:
            return
        with self._lock:
            first = not self._waiting
            self._waiting.extend(samples)
            while len(self._waiting) > CAPACITY:
                self._waiting.popleft()
                self.skipped += 1
        if first:
            self._notify()

    def _count(self, kind: str) -> None:
        with self._lock:
            self._errors[kind] = self._errors.get(kind, 0) + 1


def _reason(error: BaseException) -> str:
    """One line for people; python-can often hides the reason in the cause."""
    cause = error.__cause__
    text = f"{error} ({cause})" if cause is not None and str(cause) != str(error) else str(error)
    return one_line(text) or type(error).__name__
