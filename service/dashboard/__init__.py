"""The operator dashboard: static files that the service serves at ``/``."""

from pathlib import Path


def static_directory() -> Path:
    """Directory of the dashboard's files; its ``index.html`` is the page."""
    return Path(__file__).parent / "static"
