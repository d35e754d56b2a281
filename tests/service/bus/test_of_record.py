"""Whom a web process believes: the database, also when that has gone back in time."""

import asyncio

from service.bus.of_record import OwnersOfRecord


async def test_after_a_failover_to_an_older_copy_the_present_owner_is_believed() -> None:
    """Found by `tests/simulation/web.py`: epochs began again, and no cell was believed any more."""
    rows = {0: (50, "bearing-twin host aaaa")}

    async def read() -> dict[int, tuple[int, str]]:
        return dict(rows)

    owners = OwnersOfRecord(read)
    running = asyncio.create_task(owners.run(lambda: None))
    try:
        owners.take_claim("aaaa", {0: 50})
        await asyncio.sleep(1.0)
        assert owners.has("aaaa", 0, 50)
        rows[0] = 41, "bearing-twin host bbbb"
        for _ in range(20):  # a cell reports four times a second
            owners.take_claim("bbbb", {0: 41})
            await asyncio.sleep(0.25)
        assert owners.has("bbbb", 0, 41)
        assert not owners.has("aaaa", 0, 50)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
