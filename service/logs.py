"""Structured logs: one JSON object per line on standard error."""

import logging
import sys
from threading import Lock

import structlog
from cachetools import TTLCache

#: Seconds for which a library's message is left out after it was logged.
_REPEATED_S = 10.0


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

    Standard output stays free for the documents that commands print.
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
