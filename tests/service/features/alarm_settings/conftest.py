"""Commands, a web side on an open store, and a running twin."""

from tests.service.cli.conftest import asset, cli, commands, configure, port, refused
from tests.service.live.conftest import executor, machine_at_rest, make_live
from tests.service.web.api.conftest import empty_store, patient, settings, world

__all__ = [
    "asset",
    "cli",
    "commands",
    "configure",
    "empty_store",
    "executor",
    "machine_at_rest",
    "make_live",
    "patient",
    "port",
    "refused",
    "settings",
    "world",
]
