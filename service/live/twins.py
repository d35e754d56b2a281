"""The running twins of a cell: one loop steps them, publishes what is new, and saves them."""

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from adapters.protocol import Clock
from service.live.asset import STEP_S, AssetRuntime
from service.live.estimate import step_together
from service.live.reference import advance_together
from service.pauses import Steps

#: Wall seconds between two looks for what is to be sent.
PUBLISH_PERIOD_WALL_S = 0.25
#: Wall seconds between two groups of twins that are stepped.
_GROUP_EVERY_WALL_S = 0.1
#: Wall seconds between two saves of a state, and how many parts of the twins take turns in them.
SAVE_EVERY_WALL_S, _SAVE_TURNS = 5.0, 5
#: Twins that are stepped, or published, in one go: a sample that comes meanwhile waits for them.
_AT_ONCE = 50


class Twins:
    """Steps every running twin once in a period, a group of them at a time.

    The groups follow each other evenly over the period, so that thousands of twins do not all
    work in the same moment.

    Parameters
    ----------
    clock : Clock
        Process time.
    after_round : callable
        Called when every twin has had its turn.
    """

    def __init__(self, clock: Clock, after_round: Callable[[], None] = lambda: None) -> None:
        self._clock = clock
        self._after_round = after_round
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
            tasks.create_task(self._publish())
            tasks.create_task(self._save())

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
                _estimate(portion, now_us, means)
                steps = Steps()
                for runtime, given in zip(portion, means, strict=True):
                    if runtime.documents.running:  # it may have ended in a pause
                        # The clock may be set in a pause.
                        runtime.judge(self._clock.now_us(), given)
                    await steps.pause()
                await asyncio.sleep(0)
            if self._turn == 0:
                self._after_round()

    async def _publish(self) -> None:
        wall_s = asyncio.get_running_loop().time
        while True:
            for portion in _portions(self._all()):
                now_us, now_wall_s = self._clock.now_us(), wall_s()
                for runtime in portion:
                    runtime.publish(now_us, now_wall_s)
                await asyncio.sleep(0)
            await asyncio.sleep(PUBLISH_PERIOD_WALL_S)

    async def _save(self) -> None:
        """Save the states from time to time, however long the store takes for them.

        A part of them at a time: each is a transaction, and the next one waits for it.
        """
        while True:
            for turn in range(_SAVE_TURNS):
                await asyncio.sleep(SAVE_EVERY_WALL_S / _SAVE_TURNS)
                saved: list[tuple[AssetRuntime, asyncio.Future[None]]] = []
                for portion in _portions(self._all()[turn::_SAVE_TURNS]):
                    saved += [(one, done) for one in portion if (done := one.saving.begin())]
                    await asyncio.sleep(0)
                if saved:
                    await asyncio.wait({done for _, done in saved})
                for one, done in saved:
                    one.saving.ended(None if done.cancelled() else done.exception())

    def _all(self) -> list[AssetRuntime]:
        return [runtime for group in self._groups for runtime in group]


def _estimate(
    runtimes: Sequence[AssetRuntime], now_us: int, means: Sequence[Mapping[str, float]]
) -> None:
    """Advance the estimates of those that have what they are computed with."""
    due = [
        (one, one.used(now_us, given))
        for one, given in zip(runtimes, means, strict=True)
        if one.estimates
    ]
    failures = step_together([one.estimate for one, _ in due], now_us, [given for _, given in due])
    advance_together(
        [one.stepped(now_us, failure) for (one, _), failure in zip(due, failures, strict=True)]
    )


def _portions(runtimes: Sequence[AssetRuntime]) -> Iterator[Sequence[AssetRuntime]]:
    """Give the twins of now in portions; some may end while others have their turn."""
    runtimes = tuple(runtimes)
    for begin in range(0, len(runtimes), _AT_ONCE):
        yield [one for one in runtimes[begin : begin + _AT_ONCE] if one.documents.running]
