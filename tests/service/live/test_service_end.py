"""The whole service in this process: its end does not depend on anybody's manners."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, Self

import pytest
from patience import wait_for

from adapters.protocol import SourceHealth
from adapters.samples import Batch
from service.app.one_process import serve_in_one_process
from service.site.settings import ServiceSection, Settings
from service.site.wiring import wire

pytestmark = pytest.mark.wires


class AbsentMinded:
    """A driver that misses a cancellation, as one built on `asyncio.wait_for` can."""

    name = "absent-minded"

    def __init__(self) -> None:
        self.missed = 0
        self.begun = asyncio.Event()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...

    async def batches(self) -> AsyncIterator[Batch]:
        self.begun.set()
        while not self.missed:
            try:
                await asyncio.sleep(0.01)
            except asyncio.CancelledError:
                self.missed += 1
            yield Batch()
        await asyncio.Event().wait()

    def health(self) -> SourceHealth:
        return SourceHealth(self.name, "test", up=True)


async def test_a_driver_that_misses_its_cancellation_does_not_hold_up_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(service=ServiceSection(data_dir=tmp_path, port=0))
    driver = AbsentMinded()
    source: Any = SimpleNamespace(name=driver.name, create=lambda clock: driver)
    monkeypatch.setattr(
        "service.cell.start.wire", lambda settings: replace(wire(settings), sources=[source])
    )
    stop, ready = asyncio.Event(), asyncio.Event()
    running = asyncio.create_task(
        serve_in_one_process(settings, announce=lambda _: ready.set(), stop=stop)
    )
    await wait_for(driver.begun.wait(), 30)
    await wait_for(ready.wait(), 60)
    stop.set()
    await wait_for(running, 30)
    assert driver.missed == 1
