"""Structured logs: one JSON object per line on standard error."""

import logging
import sys

import structlog


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
    # These tell of every connection and poll at level info; what matters we log ourselves.
    for noisy in ("uvicorn.error", "pymodbus", "can", "alembic", "numba"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    # pymodbus logs an exception reply of a device, which is data for us, as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
