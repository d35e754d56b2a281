"""Which read of a source is next, when its channels have several poll intervals."""

from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass

from adapters.drivers.modbus.mapping import UnitMap
from adapters.protocol import Clock
from adapters.samples import Batch

IDLE_US = 1_000_000  # where nothing is read

Steps = AsyncGenerator[Batch | None]


@dataclass(slots=True)
class Round:
    """All that is read at one interval, and how far that has come.

    ``steps``: its requests, while it is under way; ``turn``: number of the turn in which it was
    last let go on.
    """

    interval_us: int
    parts: dict[int, UnitMap]
    due_us: int = 0
    steps: Steps | None = None
    turn: int = 0

    @property
    def has_plans(self) -> bool:
        """Whether planned profiles are read in it."""
        return any(part.plans for part in self.parts.values())

    async def end(self) -> None:
        """Forget the requests that are under way."""
        steps, self.steps = self.steps, None
        if steps is not None:
            await steps.aclose()


class Rounds:
    """The rounds of a source; says whose request goes out next.

    The shortest interval goes first. One that cannot be kept (the device takes longer than it
    lasts) makes way for one request of the others between two of its rounds, so that these come
    to an end, too.

    - ``skipped``: rounds left out because they came too late.
    """

    def __init__(self, clock: Clock, maps: Sequence[UnitMap]) -> None:
        by_interval: dict[int, Round] = {}
        for one in maps:
            interval_us = round(one.interval_s * 1e6)
            by_interval.setdefault(interval_us, Round(interval_us, {})).parts[one.unit] = one
        self._clock = clock
        self._rounds = [by_interval[interval_us] for interval_us in sorted(by_interval)]
        self._turn = 0
        self.skipped = 0

    def begin(self) -> None:
        """Let all be due now."""
        now_us = self._clock.now_us()
        for one in self._rounds:
            one.due_us = now_us

    async def end(self) -> None:
        """Forget all that is under way."""
        for one in self._rounds:
            await one.end()

    def hurry(self, part: UnitMap) -> None:
        """Let the other rounds of a unit be due now, as it is back after a loss."""
        now_us = self._clock.now_us()
        for one in self._rounds:
            other = one.parts.get(part.unit)
            if other is not None and other is not part:
                one.due_us = min(one.due_us, now_us)

    async def next(self) -> Round:
        """Wait for the round whose next request is to go out; it may have to begin."""
        while True:
            now_us = self._clock.now_us()
            ready = [one for one in self._rounds if self._is_ready(one, now_us)]
            if ready:
                break
            due_us = min((one.due_us for one in self._rounds), default=now_us + IDLE_US)
            await self._clock.sleep((due_us - now_us) / 1e6)
        chosen, *others = ready
        if others and chosen.steps is None and now_us - chosen.due_us >= chosen.interval_us:
            longest = min(others, key=lambda one: one.turn)
            chosen = longest if longest.turn < chosen.turn else chosen
        if chosen.steps is None:
            late = (now_us - chosen.due_us) // chosen.interval_us
            self.skipped += late
            chosen.due_us += (late + 1) * chosen.interval_us
        self._turn += 1
        chosen.turn = self._turn
        return chosen

    def _is_ready(self, one: Round, now_us: int) -> bool:
        if one.steps is not None:
            return True
        if one.due_us - now_us > one.interval_us:  # the clock was set back
            one.due_us = now_us
        return one.due_us <= now_us
