"""One run of the fleet's demo, from its first process to the ledger."""

import asyncio
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from bearing_twin_laboratory.fleet_demo.stand import Report, running_stand
from bearing_twin_laboratory.fleet_demo.story import Account, Story
from service.demo.processes import DemoError, folder_of

PUSHED: Final = 8
NIGHTS: Final = 6
#: Kept in the folder of a demo that fails: what was acknowledged, number by number.
LEDGER_FILE: Final = "ledger.json"
#: Wall seconds for the comparison with the store where the demo fails.
_LEDGER_S: Final = 30.0


async def run(
    benches: int,
    ports: Sequence[int],
    stop: asyncio.Event,
    report: Report,
    so_far: Callable[[Account], None],
) -> Account | None:
    """Run the demo; None where it is stopped before its end.

    Data, logs and the ledger (``ledger.json``) are kept where it fails.

    - ``benches``: virtual bearings that are polled.
    - ``ports``: of the two web processes; 0 takes a free one.
    - ``stop``: set when the demo is to stop.
    - ``report``: takes one line for the person who watches.
    - ``so_far``: takes the account as it is where the demo fails.

    Raises `DemoError` if a part does not start, something does not come back, or the ledger is not
    clean.
    """
    with folder_of("bt-") as folder:
        work = asyncio.create_task(_whole(folder, benches, ports, report, so_far))
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({work, stopped}, return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        if not work.done():
            work.cancel()
            await asyncio.wait({work})
            return None
        return work.result()


async def _whole(
    folder: Path,
    benches: int,
    ports: Sequence[int],
    report: Report,
    so_far: Callable[[Account], None],
) -> Account:
    async with running_stand(
        folder, benches=benches, pushed=PUSHED, nights=NIGHTS, ports=ports, report=report
    ) as stand:
        story = Story(stand, report)
        try:
            await story.begin()
            await story.kill_cell()
            await story.pause_cell(1)
            await story.kill_web()
            await story.identify_at_night()
            await story.kill_nats()
            await story.restart_database()
            account = await story.account()
        except Exception:
            await _keep(story, folder, report, so_far)
            raise
        if not account.is_clean:
            _write(story, account, folder)
            so_far(account)
            raise DemoError("the ledger is not clean")
        return account


async def _keep(
    story: Story, folder: Path, report: Report, so_far: Callable[[Account], None]
) -> None:
    """Keep the ledger of a story that fails, as far as it can be had."""
    try:
        async with asyncio.timeout(_LEDGER_S):
            account = await story.account_so_far()
    except Exception as error:
        # What failed is more than this: the numbers that were acknowledged are kept alone.
        report(f"The store cannot be compared with the ledger: {error}")
        _write(story, None, folder)
    else:
        _write(story, account, folder)
        so_far(account)


def _write(story: Story, account: Account | None, folder: Path) -> None:
    document = {
        "account": None if account is None else account.document(),
        "acts": [asdict(act) for act in story.acts],
        "acknowledged": story.stand.pusher.acknowledged,
    }
    (folder / LEDGER_FILE).write_text(json.dumps(document))
