"""Two cells, two web processes, PostgreSQL and NATS: whoever dies or hangs, nothing is lost.

What is asserted all the time, by a watcher, a reader of the stream and a trigger in the database
(`fleet_demo` of the laboratory): no answer is a 404, nor safe without fresh inputs; the alarms are
those of before, with their states; no state of a twin is written by who does not own it.
"""

import asyncio
import os
import random
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from programs import missing

from bearing_twin_laboratory.fleet_demo.stand import Stand, running_stand
from bearing_twin_laboratory.fleet_demo.story import Account, Story
from service.demo.processes import DemoError

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900), pytest.mark.endurance]

#: A longer run, at random: ``BEARING_TWIN_KILLS=100 pytest -s tests/faults/test_cells.py``.
KILLS = int(os.environ.get("BEARING_TWIN_KILLS", "0"))
PATIENCE_S = 60.0
BENCHES, PUSHED = 8, 4


def report(line: str) -> None:
    print(line)  # noqa: T201


@asynccontextmanager
async def running() -> AsyncIterator[Stand]:
    # A short path: PostgreSQL has its socket there.
    with tempfile.TemporaryDirectory(prefix="bt-", ignore_cleanup_errors=True) as folder:
        try:
            async with running_stand(
                Path(folder), benches=BENCHES, pushed=PUSHED, nights=0, ports=(0, 0), report=report
            ) as stand:
                yield stand
        except DemoError as error:
            if "is missing" in str(error):
                missing("pip install 'bearing-twin[fleet,servers]'")
            raise


async def test_whoever_dies_or_hangs_nothing_is_lost_and_no_one_writes_but_the_owner() -> None:
    async with running() as stand:
        story = Story(stand, report)
        await story.begin()
        if KILLS:
            await _at_random(story, KILLS)
        else:
            await _once(story)
        account = await story.account()
        states = await stand.witness.states_written()
    _require_clean(account)
    if not KILLS:  # no web process was killed: nothing else refuses a push
        assert account.pushes_repeated == 0
    assert states > 0, "the trigger has seen nothing"
    for act in account.acts:
        assert act.owned_s is None or act.owned_s < PATIENCE_S, act
    assert account.answers["fresh"] > 0
    assert account.stream["longest_silence_s"] < PATIENCE_S


async def _once(story: Story) -> None:
    """Each of what concerns cells; the rest is killed in `make demo-fleet` and other tests."""
    stand = story.stand
    messages, connections = _heard(stand)
    await story.kill_cell()
    await _until_heard(stand, messages)
    assert stand.reader.followed.connections > connections, "no one was told of a gap"
    run = stand.run_of(stand.cells[1])
    await story.pause_cell(1)
    last = await stand.witness.last_written_by(run)
    await story.kill_nats()
    messages, _ = _heard(stand)
    await _until_heard(stand, messages)
    await story.restart_database()
    assert await stand.witness.last_written_by(run) == last, "the woken cell has written"


async def _at_random(story: Story, kills: int) -> None:
    faults = (
        lambda: story.kill_cell(random.randrange(2)),
        lambda: story.pause_cell(random.randrange(2)),
        lambda: story.kill_web(random.randrange(2)),
        story.kill_nats,
        story.restart_database,
    )
    for number in range(kills):
        report(f"{number + 1} of {kills}")
        await random.choice(faults)()
        await asyncio.sleep(random.uniform(0.0, 3.0))
        assert await story.stand.witness.stale_writes() == 0
        assert story.stand.watcher.seen.wrong == []


def _heard(stand: Stand) -> tuple[int, int]:
    followed = stand.reader.followed
    return followed.messages, followed.connections


async def _until_heard(stand: Stand, messages: int) -> None:
    """The stream goes on."""
    began_s = time.monotonic()
    while stand.reader.followed.messages <= messages:
        assert time.monotonic() - began_s < PATIENCE_S, "the stream has stopped"
        await asyncio.sleep(0.1)


def _require_clean(account: Account) -> None:
    count = account.count
    assert count.acknowledged > 0
    assert (count.missing, count.stored_twice, count.out_of_order) == (0, 0, 0), count
    assert account.rejected == 0
    assert account.stale_writes_accepted == 0
    assert account.alarms_raised_again == 0
    assert account.alarms_disagree == []
    assert account.wrong_answers == []
    assert account.wrong_messages == []
    assert account.is_clean
