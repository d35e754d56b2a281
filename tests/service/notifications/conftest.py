"""Telling without its wall seconds of waiting, and real receivers."""

import pytest
from receivers import hook, mailbox

from service.notifications import channel, notifier

__all__ = ["hook", "mailbox"]


@pytest.fixture
def prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wall seconds of gathering and retrying are short."""
    monkeypatch.setattr(channel, "GATHER_S", 0.2)
    monkeypatch.setattr(channel, "RETRY_FIRST_S", 0.1)
    monkeypatch.setattr(notifier, "TICK_S", 0.02)
    monkeypatch.setattr(notifier, "LOOK_S", 0.1)
    monkeypatch.setattr(notifier, "SILENCES_S", 0.1)
