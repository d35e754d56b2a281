"""The longest step of everything that callers make the cell do, on a site of 1,000 assets."""

import asyncio
import time
from collections import defaultdict
from collections.abc import Coroutine
from contextvars import ContextVar
from typing import Any, Final

import msgspec

from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.handlers_site import ASSETS, largest_commands, site
from service.bus.dispatch import Dispatcher
from service.bus.messages import Answer, Command, Request, encode
from service.cell.cell import Cell
from service.pauses import MeasuredCoroutine

#: Each command is given so many times, and the quietest time counts: a machine does other things.
ROUNDS: Final = 5
_PATIENCE_S: Final = 300.0
_AFTER_S: Final = 0.3
_UNANSWERED: Final = ("CellUnavailableError", "CellFaultError", "RoleRefusedError")

_asked: ContextVar[str] = ContextVar("asked", default="")


def handlers(progress: Progress, *, assets: int = ASSETS, rounds: int = ROUNDS) -> Measurement:
    """Processor seconds of the longest step of any handler of the cell, between two pauses."""
    longest_s = asyncio.run(longest_steps_s(progress, assets, rounds))
    name = max(longest_s, key=lambda one: longest_s[one])
    return Measurement(
        longest_s[name],
        "s",
        min(_reference_s() for _ in range(20)),
        "45,000 multiplications of Python, 2 ms of the machine that the aim is set for",
        extra={"name": name, "assets": assets, "longest_step_s": longest_s},
    )


def _reference_s() -> float:
    begun_s, total = time.thread_time(), 0
    for number in range(45_000):
        total += number * number % 7
    return time.thread_time() - begun_s


async def longest_steps_s(progress: Progress, assets: int, rounds: int) -> dict[str, float]:
    """Processor seconds of the longest step of every handler, each with its largest command."""
    progress(0.0, f"{assets} assets")
    async with site(assets) as cell:
        asked, longest_s = Asked(cell), {}
        commands = largest_commands(cell)
        try:
            for number, (name, make) in enumerate(commands.items()):
                progress(0.4 + 0.6 * number / len(commands), name)
                longest_s[name] = min([await asked.step_s(make()) for _ in range(rounds)])
        finally:
            await asked.close()
    return longest_s


class Asked:
    """Gives a cell commands as the bus does, and measures what they make its loop do."""

    def __init__(self, cell: Cell) -> None:
        self._dispatcher = Dispatcher(cell.handlers)
        self._steps_s: defaultdict[str, list[float]] = defaultdict(list)
        self._begun: set[asyncio.Task[Any]] = set()
        asyncio.get_running_loop().set_task_factory(self._task)

    async def close(self) -> None:
        """Measure no more."""
        asyncio.get_running_loop().set_task_factory(None)
        await self._dispatcher.close()

    async def step_s(self, command: Command[Any]) -> float:
        """Processor seconds of the longest step that a command brings about."""
        answered: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        kind = type(command).__name__
        deadline_s, body = time.monotonic() + _PATIENCE_S, msgspec.Raw(encode(command))
        request = Request(1, deadline_s, kind, body, "admin")
        self._steps_s.clear()
        token = _asked.set(kind)
        try:
            self._dispatcher.take(b"", encode(request), answered.set_result)
        finally:
            _asked.reset(token)
        answer = msgspec.msgpack.decode(await answered, type=Answer)
        if answer.error in _UNANSWERED:
            raise BenchmarkError(f"{kind}: {answer.error} {bytes(answer.body)!r}")
        if self._begun:  # what it began goes on behind the answer, a twin without end
            await asyncio.wait(self._begun, timeout=_AFTER_S)
        return max(self._steps_s[kind])

    def _task(
        self, loop: asyncio.AbstractEventLoop, work: Any, **options: Any
    ) -> "asyncio.Task[Any]":
        kind = _asked.get()
        if not kind:
            return asyncio.Task(work, loop=loop, **options)
        measured: Coroutine[Any, Any, Any] = MeasuredCoroutine(work, self._steps_s[kind].append)
        task = asyncio.Task(measured, loop=loop, **options)
        self._begun.add(task)
        task.add_done_callback(self._begun.discard)
        return task
