"""Structured logs: one JSON object per line on standard error, which need not be read."""

import contextlib
import json
import logging
import os
import sys
import time
from collections.abc import Sequence
from queue import SimpleQueue
from threading import Event, Lock, RLock, Thread

import structlog
from cachetools import TTLCache

#: Seconds for which a library's message is left out after it was logged.
_REPEATED_S = 10.0


#: Lines that wait for someone who reads the log; further ones are dropped and counted.
_MOST_WAITING = 1000
#: Seconds that the end of a process waits for that.
_LAST_S = 1.0
_AGAIN_S = 0.1
_STDERR = 2


class _Lines(logging.Handler):
    """Writes lines to standard error in a thread of its own.

    Nothing waits for who reads them: a log driver that is stuck, a terminal that was stopped, a
    disk that is full. After a fork the new process begins with a thread of its own.
    """

    def __init__(self) -> None:
        super().__init__()
        self._begin()

    def _begin(self) -> None:
        # A simple queue can be put to from anywhere, also while it is being put to.
        self._waiting: SimpleQueue[str | Event] = SimpleQueue()
        self._starting = RLock()
        self._thread: Thread | None = None
        self._dropped = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Let a record be written; one that nothing has room for is counted."""
        try:
            line = self.format(record)
        except Exception:
            self.handleError(record)
            return
        if self._waiting.qsize() >= _MOST_WAITING:
            self._dropped += 1
            return
        self._waiting.put(line)
        if self._thread is None:
            self._start()

    def flush(self) -> None:
        """Wait until all is written; for a moment only, where it is not read."""
        if self._thread is not None:
            written = Event()
            self._waiting.put(written)
            written.wait(_LAST_S)

    def begin_after_fork(self) -> None:
        """Leave what waits to the process that was forked from."""
        self._begin()

    def _start(self) -> None:
        with self._starting:
            if self._thread is None:
                thread = Thread(target=self._write, name="writes the log", daemon=True)
                with contextlib.suppress(RuntimeError):  # no thread is left: the next line tries
                    thread.start()
                    self._thread = thread

    def _write(self) -> None:
        waiting = self._waiting
        while True:
            line = waiting.get()
            if isinstance(line, Event):
                line.set()
                continue
            dropped, self._dropped = self._dropped, 0
            if not (_written(line) and (not dropped or _written(_note(dropped)))):
                self._dropped += dropped + 1


def say_last(lines: Sequence[str]) -> None:
    """Write what a process has to say at its end; waits only a moment for who reads it."""
    if sys.stderr is None:  # it was closed
        return
    for handler in logging.getLogger().handlers:
        handler.flush()
    if not _is_plain():
        sys.stderr.write("".join(f"{line}\n" for line in lines))
        sys.stderr.flush()
        return
    sys.stderr.flush()
    writer = Thread(target=lambda: all(map(_written, lines)), daemon=True)
    writer.start()
    writer.join(_LAST_S)


def _is_plain() -> bool:
    """Whether standard error is that of the process: a test may have put another in its place."""
    own = sys.__stderr__
    return own is not None and sys.stderr is own and own.fileno() == _STDERR


def _written(line: str) -> bool:
    """Write a line, however long that takes; says whether there is a place for it."""
    rest = memoryview(f"{line}\n".encode(errors="backslashreplace"))
    while rest:
        try:
            # Not by `sys.stderr`: a fork would find it locked while this waits.
            rest = rest[os.write(_STDERR, rest) :]
        except BlockingIOError:
            time.sleep(_AGAIN_S)
        except OSError:
            return False
    return True


def _note(dropped: int) -> str:
    at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    said = {"event": "log_lines_dropped", "lines": dropped, "level": "warning", "timestamp": at}
    return json.dumps(said)


class _Repeated(logging.Filter):
    """Log a message once in ten seconds: a client that floods the service does not fill its log."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: TTLCache[str, logging.LogRecord] = TTLCache(64, _REPEATED_S)
        self._lock = Lock()

    def filter(self, record: logging.LogRecord) -> bool:
        """Say whether a record is logged; one with a traceback always is."""
        if record.exc_info:
            return True
        with self._lock:
            return self._seen.setdefault(f"{record.levelno} {record.msg}", record) is record


def configure_logging(level: str = "info") -> None:
    """Send our own and the libraries' records to standard error as JSON lines, UTC.

    Standard output stays free for the documents that commands print. `logging.shutdown` writes what
    still waits, for a moment; a process that ends by `os._exit` calls it first.
    """
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True, key="timestamp"),
        structlog.processors.StackInfoRenderer(),
    ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )
    handler: logging.Handler
    if _is_plain():
        handler = lines = _Lines()
        os.register_at_fork(after_in_child=lines.begin_after_fork)
    else:
        handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                # Never local variables: one of them may be a key.
                structlog.processors.ExceptionRenderer(
                    structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
                ),
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # These log every connection and poll at level info; what matters we log ourselves.
    for noisy in ("uvicorn.error", "pymodbus", "can", "alembic", "numba", "httpx2"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    # Their messages about connections that strangers make and break.
    for stranger in ("uvicorn.error", "asyncio"):
        logging.getLogger(stranger).filters[:] = [_Repeated()]
    # pymodbus logs an exception reply of a device, which is data for us, as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
