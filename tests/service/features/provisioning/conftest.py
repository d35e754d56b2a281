"""Commands, and a web side on an open store."""

from typing import Any

import pytest

from service.site.settings import Settings
from tests.service.cli.conftest import asset, cli, commands, configure, port, refused, start
from tests.service.web.api.conftest import empty_store, patient, settings, world

from .provisioned import CONFIGURATION, Cell

__all__ = [
    "asset",
    "cell",
    "cli",
    "commands",
    "configure",
    "empty_store",
    "patient",
    "port",
    "refused",
    "settings",
    "start",
    "world",
]


@pytest.fixture
def cell(world: Any) -> Cell:
    """Give the application templates, and a cell that says what it was asked."""
    cell = Cell()
    world.have(settings=Settings(**CONFIGURATION), apply_assets=cell.apply)
    return cell
