"""The command ``bearing-twin``."""

from service.cli.main import main

__all__ = ["main"]
