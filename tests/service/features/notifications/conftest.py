"""Notifications without wall seconds of waiting, and real receivers."""

import pytest
from receivers import hook, mailbox

from service.features.notifications import notification_queue, part, refusals
from service.features.silences import part as silences
from tests.service.cli.conftest import cli, commands, refused
from tests.service.web.api.conftest import empty_store, patient, settings, world

from .notified import bench

__all__ = [
    "bench",
    "cli",
    "commands",
    "empty_store",
    "hook",
    "mailbox",
    "patient",
    "refused",
    "settings",
    "world",
]


@pytest.fixture
def prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wall seconds of gathering and retrying are short."""
    monkeypatch.setattr(notification_queue, "GATHER_S", 0.1)
    monkeypatch.setattr(notification_queue, "RETRY_FIRST_S", 0.05)
    monkeypatch.setattr(refusals, "LAST_S", 0.2)
    monkeypatch.setattr(part, "TICK_S", 0.02)
    monkeypatch.setattr(part, "LOOK_S", 0.1)
    monkeypatch.setattr(silences, "READ_S", 0.1)
