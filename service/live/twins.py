"""The running twins of a cell: stepped together, and what is new of each told, by one loop."""

import asyncio
import contextlib
import math
from collections.abc import Iterator, Sequence

from adapters.protocol import Clock
from service.live.asset import STEP_S, AssetRuntime
from service.live.estimate import step_together

#: Wall seconds between two looks for what is to be sent.
TELL_EVERY_WALL_S = 0.25
#: Wall seconds between two groups of twins that are stepped.
_GROUP_EVERY_WALL_S = 0.1
#: Twins that are stepped, or told of, in one go: a sample that comes meanwhile waits for them.
_AT_ONCE = 50


class Twins:
    """Steps every running twin once in a period, a group of them at a time.

    The groups follow each other evenly over the period, so that thousands of twins do not all
    work in the same moment.

    Parameters
    ----------
    clock : Clock
        Process time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        period_wall_s = max(STEP_S / clock.rate, _GROUP_EVERY_WALL_S)
        self._groups: list[list[AssetRuntime]] = [
            [] for _ in range(math.floor(period_wall_s / _GROUP_EVERY_WALL_S))
        ]
        self._between_wall_s = period_wall_s / len(self._groups)
        self._turn = 0

    @contextlib.contextmanager
    def stepping(self, runtime: AssetRuntime) -> Iterator[None]:
        """Step a twin as long as a ``with`` block lasts."""
        # Of the smallest groups the one whose turn is last: its first step is over a whole period.
        count = len(self._groups)
        group = min(
            (self._groups[(self._turn - 1 - back) % count] for back in range(count)), key=len
        )
        group.append(runtime)
        try:
            yield
        finally:
            group.remove(runtime)

    async def run(self) -> None:
        """Work until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._step())
            tasks.create_task(self._tell())

    async def _step(self) -> None:
        wall_s = asyncio.get_running_loop().time
        due_wall_s = wall_s()
        while True:
            # Who is late does not make up for it: one step over all the time is as good.
            due_wall_s = max(due_wall_s + self._between_wall_s, wall_s())
            await asyncio.sleep(due_wall_s - wall_s())
            group = self._groups[self._turn]
            self._turn = (self._turn + 1) % len(self._groups)
            for portion in _portions(group):
                now_us = self._clock.now_us()
                means = [runtime.readings.take_means() for runtime in portion]
                failures = step_together([one.estimate for one in portion], now_us, means)
                for runtime, given, failure in zip(portion, means, failures, strict=True):
                    runtime.stepped(now_us, given, failure)
                await asyncio.sleep(0)

    async def _tell(self) -> None:
        while True:
            runtimes = [runtime for group in self._groups for runtime in group]
            for portion in _portions(runtimes):
                now_us = self._clock.now_us()
                for runtime in portion:
                    runtime.tell(now_us)
                await asyncio.sleep(0)
            await asyncio.sleep(TELL_EVERY_WALL_S)


def _portions(runtimes: Sequence[AssetRuntime]) -> Iterator[Sequence[AssetRuntime]]:
    """Give the twins of now in portions; some may end while others have their turn."""
    runtimes = tuple(runtimes)
    for begin in range(0, len(runtimes), _AT_ONCE):
        yield [one for one in runtimes[begin : begin + _AT_ONCE] if one.documents.running]
