"""The whole service in this process: its end does not depend on anybody's manners."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from types import TracebackType
from typing import Self

from adapters.drivers import SourceHealth
from adapters.samples import Batch
from service.app import Service, bind
from service.clock import ProcessClock
from service.settings import ServiceSection, Settings
from service.store import Store
from service.wiring import wire


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
    tmp_path: Path,
) -> None:
    settings = Settings(service=ServiceSection(data_dir=tmp_path))
    with Store.open("", tmp_path) as store, bind("127.0.0.1", 0) as listener:
        service = Service(settings, wire(settings), store, ProcessClock())
        driver = AbsentMinded()
        service.drivers.append(driver)
        stop = asyncio.Event()
        running = asyncio.create_task(service.run(listener, stop))
        await asyncio.wait_for(driver.begun.wait(), 30)
        stop.set()
        await asyncio.wait_for(running, 30)
        assert driver.missed == 1
