"""Answers that are computed for a caller: in worker processes of the web side."""

import asyncio
import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Final, TypeVar

from anyio import to_thread
from pydantic_core import to_json

from service.documents.advice import AdviceDocument
from service.documents.envelope import EnvelopeDocument
from service.documents.forecasts import WhatIf
from service.documents.identification import WindowDocument
from service.documents.machine import PresentMachine
from service.domain.errors import NotReadyError
from service.domain.requests import ProfileStep
from service.reports.files import ReportFormat
from service.site.settings import Settings
from service.store import Run, Store
from service.store.forecast_records import IssuedForecast
from service.web import worker
from service.web.what_if_worker import WhatIfWorker

#: A worker for studies that has had nothing to do for so many wall seconds ends: it holds some
#: hundred megabytes.
IDLE_S: Final = 120.0
#: Wall seconds after the start after which the worker of what-ifs gets ready.
WARM_UP_AFTER_S: Final = 5.0

Result = TypeVar("Result")


class WorkerQuestions:
    """Computes what callers ask; see `service.bus.replica.Questions`.

    Parameters
    ----------
    settings : Settings
        The configuration.
    store : Store
        Where the model versions are.
    """

    def __init__(self, settings: Settings, store: Store) -> None:
        self._store = store

        def make_executor() -> Executor:
            # For the worker, which loads its libraries again: many small matrices, where threads
            # only wait for each other.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
            return ProcessPoolExecutor(
                max_workers=1,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=worker.prepare,
                initargs=(settings,),
            )

        self._what_ifs = WhatIfWorker(make_executor)
        self._studies = WhatIfWorker(make_executor)
        self._studied_s = time.monotonic()
        self._studying = 0
        self._models: dict[str, worker.Model] = {}

    async def run(self) -> None:
        """Have the worker of what-ifs ready before the first question; until cancelled."""
        try:
            await asyncio.sleep(WARM_UP_AFTER_S)
            with contextlib.suppress(NotReadyError):
                await self._compute(self._what_ifs, worker.warm_up)
            while True:
                await asyncio.sleep(IDLE_S / 4)
                if not self._studying and time.monotonic() - self._studied_s > IDLE_S:
                    self._studies.shutdown()
        finally:
            for executor in (self._what_ifs, self._studies):
                executor.shutdown(wait=False, cancel_futures=True)

    async def what_if(
        self,
        asset: str,
        machine: PresentMachine,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> WhatIf:
        """Forecast a profile from the state of a machine."""
        model = await self._model(asset, machine.version)
        steps, wanted = list(profile), list(nodes) if nodes else None
        return await self._compute(
            self._what_ifs, worker.what_if, model, machine, steps, step_s, wanted
        )

    async def what_if_to_keep(
        self,
        asset: str,
        machine: PresentMachine,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> tuple[WhatIf, IssuedForecast | None]:
        """Forecast a profile, and give what is kept of the forecast."""
        model = await self._model(asset, machine.version)
        steps, wanted = list(profile), list(nodes) if nodes else None
        return await self._compute(
            self._what_ifs, worker.what_if_to_keep, model, machine, steps, step_s, wanted
        )

    async def envelope(self, asset: str, machine: PresentMachine) -> EnvelopeDocument:
        """Give the safe operating envelope."""
        model = await self._model(asset, machine.version)
        return await self._study(worker.envelope, model, machine)

    async def advice(
        self, asset: str, machine: PresentMachine, target: tuple[float, float, float]
    ) -> AdviceDocument:
        """Rank low-risk steps by what they teach about a point."""
        model = await self._model(asset, machine.version)
        return await self._study(worker.advice, model, machine, target)

    async def windows(self, asset: str) -> Sequence[WindowDocument]:
        """Find the low-risk windows in the store."""
        return await self._study(worker.windows, asset)

    async def report(self, asset: str, run: Run, format: ReportFormat, now_us: int) -> bytes:
        """Make the report of a run."""
        return await self._study(worker.report, asset, run, format, now_us)

    async def _model(self, asset: str, version: int) -> worker.Model:
        known = self._models.get(asset)
        if known is None or known.version != version:
            found = await to_thread.run_sync(self._store.models.version, asset, version)
            if found is None:
                raise NotReadyError(f"model version {version} is not in the store")
            posterior = to_json(found.document["posterior"])
            naive = to_json(found.document.get("naive_models"))
            known = worker.Model(asset, version, posterior, found.created_at_us, naive)
            self._models[asset] = known
        return known

    async def _study(self, work: Callable[..., Result], *arguments: Any) -> Result:
        self._studying += 1
        try:
            return await self._compute(self._studies, work, *arguments)
        finally:
            self._studying -= 1
            self._studied_s = time.monotonic()

    async def _compute(
        self, executor: WhatIfWorker, work: Callable[..., Result], *arguments: Any
    ) -> Result:
        try:
            return await asyncio.wrap_future(executor.submit(work, *arguments))
        except BrokenProcessPool as error:
            raise NotReadyError("the worker that computes forecasts has died") from error
