"""Answers that are computed for a caller: in worker processes of the web side."""

import asyncio
import math
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, Final, TypeVar

from anyio import to_thread
from pydantic_core import to_json

from service.bus.questions import how_answered
from service.documents.machine import PresentMachine
from service.domain.errors import NotReadyError
from service.site.settings import Settings
from service.store import Store
from service.web import worker
from service.web.what_if_worker import WhatIfWorker
from service.worker_pools import make_pool

#: A worker for studies that has had nothing to do for so many wall seconds ends: it holds some
#: hundred megabytes.
IDLE_S: Final = 120.0
#: And one for what-ifs, after the last question and the last client of the live messages.
WHAT_IFS_IDLE_S: Final = 900.0
_POLL_S: Final = 1.0
#: A worker that could not be started is tried again after so many.
_AGAIN_S: Final = 60.0

Result = TypeVar("Result")


class WorkerQuestions:
    """Computes what callers ask; see `service.bus.questions.Questions`."""

    def __init__(self, settings: Settings, store: Store) -> None:
        self._store = store

        make_executor = partial(make_pool, worker.prepare, (settings,))
        self._what_ifs = WhatIfWorker(make_executor)
        self._studies = WhatIfWorker(make_executor)
        self._asked_s = self._studied_s = time.monotonic()
        self._studying = 0
        self._models: dict[str, worker.WorkerModel] = {}

    async def run(self, is_watched: Callable[[], bool]) -> None:
        """Have the worker of what-ifs ready while a client follows the machines; until cancelled.

        ``is_watched``: says whether one does: it may ask at any moment, and the worker takes two
        seconds to start.
        """
        again_s = -math.inf
        try:
            while True:
                await asyncio.sleep(_POLL_S)
                now_s = time.monotonic()
                if is_watched():
                    self._asked_s = now_s
                    if not self._what_ifs.is_running and now_s >= again_s:
                        try:
                            await self._compute(self._what_ifs, worker.warm_up)
                        except NotReadyError:
                            again_s = now_s + _AGAIN_S
                elif now_s - self._asked_s > WHAT_IFS_IDLE_S:
                    self._what_ifs.shutdown()
                if not self._studying and now_s - self._studied_s > IDLE_S:
                    self._studies.shutdown()
        finally:
            for executor in (self._what_ifs, self._studies):
                executor.shutdown(wait=False, cancel_futures=True)

    async def answer(
        self,
        question: Callable[..., Result],
        asset: str,
        machine: PresentMachine | None,
        *arguments: Any,
    ) -> Result:
        """See `service.bus.questions.Questions.answer`."""
        model = None if machine is None else await self._model(asset, machine.version)
        asked = worker.Asked(asset, model, machine)
        if how_answered(question).at_once:
            self._asked_s = time.monotonic()
            return await self._compute(self._what_ifs, question, asked, *arguments)
        self._studying += 1
        try:
            return await self._compute(self._studies, question, asked, *arguments)
        finally:
            self._studying -= 1
            self._studied_s = time.monotonic()

    async def _model(self, asset: str, version: int) -> worker.WorkerModel:
        known = self._models.get(asset)
        if known is None or known.version != version:
            found = await to_thread.run_sync(self._store.models.version, asset, version)
            if found is None:
                raise NotReadyError(f"model version {version} is not in the store")
            posterior = to_json(found.document["posterior"])
            naive = to_json(found.document.get("naive_models"))
            known = worker.WorkerModel(asset, version, posterior, found.created_at_us, naive)
            self._models[asset] = known
        return known

    async def _compute(
        self, executor: WhatIfWorker, work: Callable[..., Result], *arguments: Any
    ) -> Result:
        try:
            return await asyncio.wrap_future(executor.submit(work, *arguments))
        except BrokenProcessPool as error:
            raise NotReadyError("the worker that computes forecasts has died") from error
