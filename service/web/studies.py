"""Studies for callers: those who ask for the same get one answer, and none is made for no one.

A study is an envelope, advice, the search for windows or a report: seconds of work, for which there
is one worker process.
"""

import asyncio
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass
from typing import Any, TypeVar

from service.web.shares import BusyError, Shares

Result = TypeVar("Result")


@dataclass(slots=True, eq=False)
class _Study:
    answer: "asyncio.Future[Any]"
    callers: int = 0


class Studies:
    """The studies that are under way; used in one event loop.

    ``turns``: turns of callers at the worker. A study takes a turn of the caller who asked first.
    """

    def __init__(self, turns: Shares) -> None:
        self._turns = turns
        self._under_way: dict[Hashable, _Study] = {}

    async def answer(
        self, caller: str, key: Hashable, begin: Callable[[], Awaitable[Result]]
    ) -> Result:
        """Wait for a study, which is begun unless one of this key is under way.

        Cancelled, it leaves the study to the other callers; without one, a study that waits for its
        turn never begins. One that the worker has begun runs to its end and keeps its turn. Raises
        `BusyError` if the caller may not wait for any more.
        """
        while True:
            study = self._under_way.get(key)
            is_own = study is None
            if study is None:
                answer = asyncio.ensure_future(self._turns.hold(caller, begin))
                study = self._under_way[key] = _Study(answer)
            study.callers += 1
            try:
                result: Result = await asyncio.shield(study.answer)
                return result
            except BusyError:
                if is_own:
                    raise
                # It was the share of the first caller that was full.
            finally:
                study.callers -= 1
                if not study.callers:
                    study.answer.cancel()
                if (not study.callers or study.answer.done()) and (
                    self._under_way.get(key) is study
                ):
                    del self._under_way[key]
