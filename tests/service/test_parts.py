"""One life cycle for all parts of a process."""

import asyncio

from patience import within
from structlog.testing import capture_logs

from service.tasks import Part, Working


class Counting(Part):
    name = "counting"

    def __init__(self) -> None:
        self.count = 0
        self.has_ended = False

    async def run(self) -> None:
        try:
            while True:
                self.count += 1
                await asyncio.sleep(0)
        finally:
            await asyncio.sleep(0.01)  # the end of the work takes its time
            self.has_ended = True


async def test_a_part_can_be_stopped_before_it_starts_and_twice() -> None:
    part, stop = Counting(), asyncio.Event()
    await part.stop()
    await part.start(stop)
    await asyncio.sleep(0.01)
    await part.stop()
    await part.stop()
    assert part.count > 0
    assert not stop.is_set(), "a stop is no failure"


async def test_nothing_works_after_the_stop_and_it_can_begin_again() -> None:
    part, stop = Counting(), asyncio.Event()
    await part.start(stop)
    await asyncio.sleep(0)
    await part.stop()
    assert part.has_ended, "the stop waits for the end of the work"
    before = part.count
    await asyncio.sleep(0.01)
    assert part.count == before
    await part.start(stop)
    await asyncio.sleep(0)
    await part.stop()
    assert part.count > before


async def test_work_that_fails_ends_the_process_and_is_logged() -> None:
    async def fail() -> None:
        raise ZeroDivisionError

    part, stop = Working("dividing", fail), asyncio.Event()
    with capture_logs() as logs:
        await part.start(stop)
        async with within(10):
            await stop.wait()
        assert [(one["event"], one["task"]) for one in logs] == [("task_ended", "dividing")]
    try:
        await part.stop()
    except ZeroDivisionError:
        pass
    else:
        raise AssertionError("the error is not lost")
