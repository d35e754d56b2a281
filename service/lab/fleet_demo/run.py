"""One run of the fleet's demo, from its first process to the ledger."""

import asyncio
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from service.lab.fleet_demo.stand import Tell, running_stand
from service.lab.fleet_demo.story import Account, Story

PUSHED: Final = 8
NIGHTS: Final = 6


async def run(
    benches: int, ports: Sequence[int], stop: asyncio.Event, tell: Tell
) -> Account | None:
    """Run the demo; None where it is stopped before its end.

    Parameters
    ----------
    benches : int
        Virtual bearings that are polled.
    ports : sequence of int
        Of the two web processes; 0 takes a free one.
    stop : asyncio.Event
        Set when the demo is to stop.
    tell : callable
        Takes one line for the person who watches.

    Raises
    ------
    DemoError
        If a part does not start, or something does not come back.
    """
    with tempfile.TemporaryDirectory(prefix="bt-", ignore_cleanup_errors=True) as folder:
        work = asyncio.create_task(_whole(Path(folder), benches, ports, tell))
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({work, stopped}, return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        if not work.done():
            work.cancel()
            await asyncio.wait({work})
            return None
        return work.result()


async def _whole(folder: Path, benches: int, ports: Sequence[int], tell: Tell) -> Account:
    async with running_stand(
        folder, benches=benches, pushed=PUSHED, nights=NIGHTS, ports=ports, tell=tell
    ) as stand:
        story = Story(stand, tell)
        await story.begin()
        await story.kill_cell()
        await story.pause_cell(1)
        await story.kill_web()
        await story.identify_at_night()
        await story.kill_nats()
        await story.restart_database()
        return await story.account()
