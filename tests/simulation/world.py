"""A world for simulations: its clock stands while anything works, and all chance has one seed.

Actors take their turns in the order of their times. An act arms a *trap* at a place that the
product passes (a statement, a commit, a write on the disk), so that a process is killed, cut off or
paused there and nowhere else. The same seed gives the same run, to the last step.
"""

import random
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

_TRACE = 60


class Killed(BaseException):
    """A process has ended where it was."""


class BrokenError(AssertionError):
    """An invariant does not hold; the text has the seed and the last steps."""


class Actor(Protocol):
    name: str
    next_s: float

    def step(self) -> None:
        """Take a turn; sets `next_s`."""


class World:
    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.chance = random.Random(seed)
        self.now_s = 10_000.0
        self.actors: list[Actor] = []
        self.trace: deque[str] = deque(maxlen=_TRACE)
        self.counts: Counter[str] = Counter()
        # By actor: passes until it springs, and what it does then.
        self.traps: dict[str, tuple[int, Callable[[str], None]]] = {}
        self.full_until_s: dict[str, float] = {}
        self._resting: list[Actor] = []
        self.broken = ""

    # ------------------------------------------------------------------ time
    def run_for(self, seconds: float) -> None:
        """Let all actors but those that are in the middle of a turn take theirs."""
        until_s = self.now_s + seconds
        while True:
            ready = [one for one in self.actors if one not in self._resting]
            actor = min(ready, key=lambda one: one.next_s, default=None)
            if actor is None or actor.next_s > until_s:
                break
            self.now_s = max(self.now_s, actor.next_s)
            self._resting.append(actor)
            try:
                actor.step()
            finally:
                self._resting.remove(actor)
            if self.broken:
                raise BrokenError(self.broken)
        self.now_s = max(self.now_s, until_s)

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return 1.7e9 + self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def now_us(self) -> int:
        return round(self.time() * 1e6)

    # ------------------------------------------------------------------ faults
    def arm(self, actor: str, passes: int, spring: Callable[[str], None]) -> None:
        self.traps[actor] = passes, spring

    def reach(self, actor: str, place: str) -> None:
        """Say that the work of an actor has come to a place."""
        trap = self.traps.get(actor)
        if trap is None:
            return
        passes, spring = trap
        if passes:
            self.traps[actor] = passes - 1, spring
            return
        del self.traps[actor]
        self.note(f"{actor}: {spring.__name__} at {place}")
        self.counts[f"{spring.__name__} at {place}"] += 1
        spring(place)

    # ------------------------------------------------------------------ what is seen
    def note(self, line: str) -> None:
        self.trace.append(f"{self.now_s:10.2f} {line}")

    def require(self, holds: bool, what: str) -> None:
        """Record an invariant; the product may catch what is raised in the middle of it."""
        if not holds:
            steps = "\n".join(self.trace)
            self.broken = self.broken or f"seed {self.seed}: {what}\n{steps}"
            raise BrokenError(self.broken)


@contextmanager
def replaced(*places: tuple[object, str, object]) -> Iterator[None]:
    """Put something else in place of attributes, until the end of the context."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in places]
    for owner, name, value in places:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in reversed(before):
            setattr(owner, name, value)
