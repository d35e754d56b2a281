"""The command ``bearing-twin``."""

from service.loading import load_without, loading

with loading():
    # It colours tracebacks on a terminal; ours are lines of JSON.
    load_without("rich", "structlog")
    from service.cli.main import main

__all__ = ["main"]
