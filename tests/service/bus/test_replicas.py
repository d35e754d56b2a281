"""Copies of what the cell knows, of assets that come and go."""

import asyncio
import time
from typing import Any

from service.bus.calls import command_type
from service.bus.commands import Assets, PackedDocument
from service.bus.memory import MemoryBus
from service.bus.replica import AssetReplica
from service.bus.replicas import Replicas


async def test_a_copy_of_what_the_cell_has_no_more_gets_old() -> None:
    """It must not be called right again and again: a page would show it as of now."""
    replica = AssetReplica("axle-1", MemoryBus())
    asked_s = time.monotonic() - 60.0
    assert not replica.is_known("summary")
    replica.take("summary", PackedDocument(b"tag", b"{}"), asked_s)
    assert replica.is_known("summary")
    replica.take("summary", PackedDocument(b"tag", None), asked_s + 20.0)
    assert 39.0 < replica.age_s("summary") < 60.0, "still right"
    replica.take("summary", PackedDocument(b"", None), asked_s + 50.0)
    assert replica.age_s("summary") > 39.0, "the cell has none"


async def test_an_asset_whose_documents_came_too_late_is_learned_all_the_same() -> None:
    """Callers were told that there is no such asset while its cell was busy, and ever after."""
    bus = MemoryBus()
    asked = 0

    async def names(_: Any) -> dict[str, int]:
        return {"axle-1": 1}

    async def documents(command: Any) -> list[PackedDocument]:
        nonlocal asked
        asked += 1
        # What `service.bus.fleet_cells.Fleet` gives for a cell that does not answer, at first.
        one = PackedDocument(b"", None) if asked == 1 else PackedDocument(b"tag", b"{}")
        return [one for _ in command.wanted]

    replicas = Replicas(bus)
    tasks = [
        asyncio.create_task(
            bus.serve(
                {command_type(Assets.names): names, command_type(Assets.documents): documents}
            )
        )
    ]
    try:
        await asyncio.sleep(0)
        await replicas.load()
        assert not replicas.assets
        assert [*replicas.names] == ["axle-1"], "there is one"
        tasks.append(asyncio.create_task(replicas.follow()))
        for _ in range(3000):
            if "axle-1" in replicas.assets:
                break
            await asyncio.sleep(0.02)
        assert "axle-1" in replicas.assets
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
