"""The supervisor's judgement of a process that works, waits for a busy machine, hangs or spins.

Its loop, `Side` and `Silence` are the product's; a fake stands for the process and for /proc.
"""

import asyncio
import contextlib
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import structlog
from jumping import JumpingLoop
from simulation.world import BrokenError, replaced

from service.app import supervisor
from service.app.hanging import HUNG_S, Look
from service.app.supervisor import SILENT_S, Side

ACTS_A_DAY = 24
_REPORT_S = 0.25
#: A hang is seen with the next look, and a look costs half a second.
_SEEN_WITHIN_S = HUNG_S + 1.5


class Process:
    """What the kernel shows of a process, and what it reports."""

    def __init__(self, seed: int, side: Side, loop: JumpingLoop) -> None:
        self.chance = random.Random(seed)
        self.loop, self.side = loop, side
        self.state = "works"
        self.since_s = loop.time()
        self.processor_s = 0.0
        self.kills: list[tuple[str, float]] = []
        self.asleep_s = 0.0
        self.pid = 1

    def look(self, _: int) -> Look:
        self.loop.passed_s += self.asleep_s  # the machine was suspended, supervisor and all
        self.since_s += self.asleep_s
        self.asleep_s = 0.0
        if self.state == "spins":
            self.processor_s += 0.5
        return Look(self.state in ("waits", "spins"), self.processor_s)

    def kill(self) -> None:
        self.kills.append((self.state, self.loop.time() - self.since_s))
        self.become("works")

    def become(self, state: str) -> None:
        self.state, self.since_s = state, self.loop.time()

    async def report(self) -> None:
        while True:
            await asyncio.sleep(_REPORT_S * self.chance.uniform(0.8, 1.2))
            if self.state == "works":
                self.side.listen_from_now()


async def _simulate(seed: int, days: float, loop: JumpingLoop) -> Process:
    side = Side("cell", cast(Any, None), Path())
    process = Process(seed, side, loop)
    side._process = cast(Any, process)
    side._gone.clear()
    side.is_ready.set()
    with replaced((supervisor, "look_at", process.look)):
        tasks = [
            asyncio.create_task(process.report()),
            asyncio.create_task(supervisor._watch([side])),
        ]
        for _ in range(max(round(days * ACTS_A_DAY), 1)):
            await asyncio.sleep(process.chance.uniform(1.0, 10.0))
            state = process.chance.choice(["waits", "hangs", "spins", "sleeps"])
            lasts_s = process.chance.uniform(0.5, SILENT_S - 1.0)
            process.kills.clear()
            if state == "sleeps":
                process.asleep_s = lasts_s
                await asyncio.sleep(2.0)
                _require(seed, not process.kills, f"killed after a sleep of {lasts_s:.0f} s")
                continue
            process.become(state)
            await asyncio.sleep(lasts_s)
            process.become("works") if process.state == state else None
            kills = process.kills
            if state == "waits":
                _require(seed, not kills, f"killed while it waited for the machine: {kills}")
            elif lasts_s > _SEEN_WITHIN_S:
                seen = [one for one, after_s in kills if after_s <= _SEEN_WITHIN_S]
                _require(seed, seen == [state], f"{state} for {lasts_s:.1f} s: killed {kills}")
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return process


def _require(seed: int, holds: bool, what: str) -> None:
    if not holds:
        raise BrokenError(f"seed {seed}: {what}")


def simulate_judgement(seed: int, days: float) -> None:
    """Simulate so many service-days; raises `BrokenError` where an invariant does not hold."""
    loop = JumpingLoop()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    with (
        contextlib.closing(loop),
        replaced((supervisor, "time", SimpleNamespace(monotonic=loop.time))),
    ):
        try:
            loop.run_until_complete(_simulate(seed, days, loop))
        finally:
            structlog.reset_defaults()
