"""Copies of what the cell knows, of assets that come and go."""

import time

from service.bus.commands import Document
from service.bus.memory import MemoryBus
from service.bus.replica import AssetReplica


async def test_a_copy_of_what_the_cell_has_no_more_gets_old() -> None:
    """It must not be called right again and again: a page would show it as of now."""
    replica = AssetReplica("axle-1", MemoryBus())
    asked_s = time.monotonic() - 60.0
    assert not replica.is_known("summary")
    replica.take("summary", Document(b"tag", b"{}"), asked_s)
    assert replica.is_known("summary")
    replica.take("summary", Document(b"tag", None), asked_s + 20.0)
    assert 39.0 < replica.age_s("summary") < 60.0, "still right"
    replica.take("summary", Document(b"", None), asked_s + 50.0)
    assert replica.age_s("summary") > 39.0, "the cell has none"
